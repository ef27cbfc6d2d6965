"""All that can be said in a world and in a URDF, with some of what cannot, is read as before.

A change that means to read something otherwise renews whole.world.txt or whole.urdf.txt.
"""

from dataclasses import is_dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, tostring

import numpy as np
import pytest
from shared import PACKAGE

from bullet_lab.simulation.world.sdf import read_world_file
from bullet_lab.simulation.world.urdf import read_urdf_file

HERE = Path(__file__).parent


def shown(value):
    return f"{round(value, 12) + 0.0:.9g}" if isinstance(value, float) else str(value)


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
    elif isinstance(value, (tuple, list)) and any(map(is_dataclass, value)):
        for number, inner in enumerate(value):
            yield from lines_of(inner, f"{name}.{number}")
    else:
        words = value if isinstance(value, (tuple, list)) else [value]
        yield f"{name}: {' '.join(map(shown, words))}"


@pytest.mark.parametrize(
    "file, read", [("whole.world", read_world_file), ("whole.urdf", read_urdf_file)]
)
def test_whole_files_are_read_as_before(file, read, caplog):
    told = [*lines_of(read(HERE / file), file), *caplog.messages]
    text = "\n".join(told).replace(str(PACKAGE), "")
    assert text == (HERE / f"{file}.txt").read_text()
