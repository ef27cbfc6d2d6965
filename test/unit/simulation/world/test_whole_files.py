"""All that can be said in worlds, URDFs and meshes, with some of what cannot, is read as before.

A change that means to read something otherwise renews the text: see `assert_as_before`.
"""

import re
from dataclasses import replace
from pathlib import Path

from alike import assert_as_before, lines_of, shown
from shared import PACKAGE, cases

from bullet_lab.simulation.world.description import Mesh, ModelState, PluginTag, Snapshot
from bullet_lab.simulation.world.mesh_parts import mesh_parts
from bullet_lab.simulation.world.sdf import read_world_file
from bullet_lab.simulation.world.sdf_writer import world_text
from bullet_lab.simulation.world.urdf import read_urdf_file

HERE = Path(__file__).parent


def parts_of(path):
    """What is seen of a mesh, mirrored; versions of trimesh order parts and corners otherwise."""
    parts = mesh_parts(Mesh(path, "", (1.0, 2.0, -3.0)))
    return dict(enumerate(sorted([(part.corners, *part[2:]) for part in parts], key=str)))


def saved(path):
    """A world as it is written again after 1.234 s."""
    world = read_world_file(path)
    made, state = PluginTag("libmade.so", "made", {"speed": "3"}), world.states.get
    models = [
        (replace(one, plugins=(*one.plugins, made)), state(one.name, ModelState(one.pose)))
        for one in world.models
    ]
    text, notes = world_text(Snapshot(world, 1234, models), HERE)
    text = re.sub(r"-?\d+\.\d+(e-\d+)?", lambda found: shown(float(found[0])), text)
    return dict(enumerate(text.split("\n") + notes))


READERS = {one.__name__: one for one in (read_world_file, read_urdf_file, saved, parts_of)}


@cases("""
file, reader:
  - [whole.world, read_world_file]
  - [whole.world, saved]
  - [whole.urdf, read_urdf_file]
  - [worlds/beacons.world, read_world_file]
  - [worlds/docking.world, read_world_file]
  - [worlds/docking_dots.world, read_world_file]
  - [worlds/docking_nested.world, read_world_file]
  - [worlds/docking_decoy.world, read_world_file]
  - [urdf/beacon.urdf, read_urdf_file]
  - [urdf/block_robot.urdf, read_urdf_file]
  - [urdf/camera_robot.urdf, read_urdf_file]
  - [whole.obj, parts_of]
  - [whole.dae, parts_of]
  - [corner.obj, parts_of]
""")
def test_whole_files_are_read_as_before(file, reader, caplog):
    path = (PACKAGE if "/" in file else HERE) / file
    told = [*lines_of(READERS[reader](path), path.name), *caplog.messages]
    assert_as_before(told, HERE / f"{path.name}.{reader}.txt")
