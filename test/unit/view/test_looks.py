"""What links look like, read back from binary glTF."""

from io import BytesIO

import numpy as np
import pytest
import trimesh

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.world.description import Visual
from bullet_lab.simulation.world.resources import package_share
from bullet_lab.simulation.world.shapes import Box, Mesh, Sphere
from bullet_lab.view.looks import glb_of

WALL = package_share() / "models" / "docking_station" / "meshes" / "back_wall.obj"


def read(glb):
    return trimesh.load(BytesIO(glb), file_type="glb")


def test_shapes_are_where_they_are_and_as_large_as_they_are():
    visuals = [
        Visual(Box((1.0, 2.0, 3.0)), Pose((10.0, 0.0, 0.0)), (1.0, 0.5, 0.0, 1.0)),
        Visual(Sphere(0.5), colour=(0.0, 0.0, 1.0, 0.25)),
    ]
    scene = read(glb_of(visuals))
    assert scene.bounds == pytest.approx(np.array([[-0.5, -1.0, -1.5], [10.5, 1.0, 1.5]]), abs=0.02)
    opaque, clear = (mesh.visual.material for mesh in scene.geometry.values())
    assert opaque.baseColorFactor[:3] == pytest.approx([255, round(255 * 0.5**2.2), 0], abs=1)
    assert (opaque.alphaMode, clear.alphaMode) == ("OPAQUE", "BLEND")


def test_a_mesh_brings_its_picture():
    scene = read(glb_of([Visual(Mesh(WALL, str(WALL)))]))
    assert any(m.visual.material.baseColorTexture is not None for m in scene.geometry.values())


def test_what_cannot_be_read_is_said_and_left_out():
    said = []
    visuals = [Visual(Mesh(WALL.with_name("none.obj"), "none")), Visual(Box((1.0, 1.0, 1.0)))]
    assert len(read(glb_of(visuals, said.append)).geometry) == 1
    assert len(said) == 1
    assert glb_of(visuals[:1], said.append) == b""
