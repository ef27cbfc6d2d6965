"""What is sent to the page when something is placed, moved and removed, and visuals as glTF."""

from io import BytesIO

import numpy as np
import pytest
import trimesh
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.ros.view.scene import PIECE, Nodes, Solids, floor_point, glb_of
from bullet_lab.simulation.world.description import Visual
from bullet_lab.simulation.world.resources import package_share
from bullet_lab.simulation.world.shapes import Box, Mesh, Sphere

WALL = package_share() / "models" / "docking_station" / "meshes" / "back_wall.obj"
RED, GLASS = (1.0, 0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.5)
SIZE = (1.0, 2.0, 3.0)


@pytest.fixture
def put(scene):
    """A function that puts solids at places along x and y, and has them sent."""
    solids = Solids(scene, "/s")

    def put(*places, colour=RED, first=0):
        for key, place in enumerate(places, first):
            solids.put_solid(key, "box", Pose((*place, 0.0)), SIZE, colour)
        solids.flush()
        return solids

    return put


def test_solids_of_a_kind_are_one_node_that_is_sent_once_they_move(scene, put):
    put(*((number, 0.0) for number in range(20)))
    node = scene.nodes["/s/box"]
    assert node.batched_positions[:, 0].tolist() == list(range(20))
    for y, sent in ((0.0, 0), (7.0, 1)):
        put((3.0, y), first=3)
        assert (node.sent, node.batched_positions[3].tolist()) == (sent, [3.0, y, 0.0])
    assert list(scene.nodes.values()) == [node]


def test_a_solid_that_comes_goes_or_turns_to_glass_makes_nodes_anew(scene, put):
    put((0.0, 0.0), (0.0, 0.0))
    solids = put((0.0, 0.0), colour=GLASS, first=1)
    assert len(scene.nodes["/s/box"].batched_positions) == 1
    assert scene.nodes["/s/box_see_through"].batched_opacities.tolist() == [0.5]
    for key in (0, 1):
        solids.drop(key)
    solids.flush()
    assert not scene.nodes


def test_of_a_line_that_grows_only_the_end_is_sent(scene):
    nodes = Nodes(scene)
    points = np.zeros((int(2.5 * PIECE), 3))
    points[:, 0] = range(len(points))
    for count in (*range(2, len(points), 7), len(points)):
        nodes.put_line("/l", points[:count], RED)
    pieces = [scene.nodes[f"/l/{number}"] for number in range(3)]
    segments = np.concatenate([piece.points for piece in pieces])
    assert segments == pytest.approx(np.stack((points[:-1], points[1:]), axis=1))
    sent = np.array([piece.sent for piece in pieces])
    nodes.put_line("/l", np.concatenate((points, points[-1:] + 1.0)), RED)
    assert ([piece.sent for piece in pieces] - sent).tolist() == [0, 0, 1]
    nodes.put_line("/l", points[:1], RED)
    assert not scene.nodes


def test_nothing_to_show_is_no_node(scene):
    nodes = Nodes(scene)
    for count in (0, 3, 5, 0, 0, 2):
        nodes.put_points("/p", {"colors": RED}, points=np.zeros((count, 3)))
        assert len(scene.nodes) == bool(count)


def test_a_node_of_another_look_is_made_anew(scene):
    nodes, ends = Nodes(scene), np.zeros((1, 2, 3))
    for colour, made in ((RED, 1), (RED, 1), (GLASS, 2)):
        nodes.put_segments("/s", ends, colour)
        assert (scene.nodes["/s"].colors, scene.made) == (colour, made)
    nodes.put_line("/l", np.zeros((3, 3)), RED)
    nodes.clear()
    assert not scene.nodes


def test_labels_follow_and_go(scene):
    nodes = Nodes(scene)
    for text in ("one", "two"):
        nodes.put_label(text, text, (0.0, 0.0, 0.0))
    nodes.drop("one")
    nodes.put_label("two", "more", (1.0, 0.0, 0.0))
    (node,) = scene.nodes.values()
    assert (node.text, node.position) == ("more", (1.0, 0.0, 0.0))


@cases("side: [1.0, -1.0]")
def test_a_ray_that_does_not_meet_the_floor_meets_nothing(side):
    assert floor_point((0.0, 0.0, side), (1.0, 0.0, 0.1 * side)) is None


def read(glb):
    return trimesh.load(BytesIO(glb), file_type="glb")


def test_shapes_are_where_they_are_and_as_large_as_they_are():
    visuals = [
        Visual(Box(SIZE), Pose((10.0, 0.0, 0.0)), (1.0, 0.5, 0.0, 1.0)),
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


def test_what_cannot_be_read_is_reported_and_left_out():
    reports = []
    missing = Visual(Mesh(WALL.with_name("none.obj"), "none"))
    assert len(read(glb_of([missing, Visual(Box(SIZE))], reports.append)).geometry) == 1
    assert len(reports) == 1
    assert glb_of([missing]) == b""
