"""All that can be said in worlds, URDFs and meshes, with some of what cannot, is read as before.

A change that means to read something otherwise renews the text beside the file.
"""

import re
from dataclasses import is_dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, tostring

import numpy as np
import pytest
from shared import PACKAGE

from bullet_lab.simulation.world.description import Mesh, ModelState, Snapshot
from bullet_lab.simulation.world.mesh_parts import mesh_parts
from bullet_lab.simulation.world.sdf import read_world_file
from bullet_lab.simulation.world.sdf_writer import world_text
from bullet_lab.simulation.world.urdf import read_urdf_file

HERE = Path(__file__).parent


def shown(value):
    return f"{round(value, 12) + 0.0:.9g}" if isinstance(value, float) else str(value)


def is_made_of_parts(value):
    return is_dataclass(value) or isinstance(value, (tuple, np.ndarray))


def lines_of(value, name):
    """Yield a line for each value in data classes and what they hold, numbers to nine digits."""
    if is_dataclass(value):
        value = {"": type(value).__name__, **vars(value)}
    if isinstance(value, np.ndarray):
        value = value.ravel().tolist()
    if isinstance(value, Element):
        value = tostring(value, "unicode").split()
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from lines_of(inner, f"{name}.{key}")
    elif isinstance(value, (tuple, list)) and any(map(is_made_of_parts, value)):
        for number, inner in enumerate(value):
            yield from lines_of(inner, f"{name}.{number}")
    else:
        words = value if isinstance(value, (tuple, list)) else [value]
        yield f"{name}: {' '.join(map(shown, words))}"


def parts_of(path):
    """What is seen of a mesh, mirrored; versions of trimesh order parts and corners otherwise."""
    parts = mesh_parts(Mesh(path, "", (1.0, 2.0, -3.0)))
    return dict(enumerate(sorted([(part.corners, *part[2:]) for part in parts], key=str)))


def saved(path):
    """A world as it is written again after 1.234 s."""
    world = read_world_file(path)
    models = [(one, world.states.get(one.name, ModelState(one.pose))) for one in world.models]
    text, notes = world_text(Snapshot(world, 1234, models), HERE)
    text = re.sub(r"-?\d+\.\d+(e-\d+)?", lambda found: shown(float(found[0])), text)
    return dict(enumerate(text.split("\n") + notes))


@pytest.mark.parametrize(
    "file, read",
    [
        ("whole.world", read_world_file),
        ("whole.world", saved),
        ("whole.urdf", read_urdf_file),
        ("whole.obj", parts_of),
        ("whole.dae", parts_of),
    ],
)
def test_whole_files_are_read_as_before(file, read, caplog):
    told = [*lines_of(read(HERE / file), file), *caplog.messages]
    text = "\n".join(told).replace(str(PACKAGE), "")
    assert text == (HERE / f"{file}.{read.__name__}.txt").read_text()
