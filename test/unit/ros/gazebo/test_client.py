import math

import pytest
from message_fields import message
from visualization_msgs.msg import MarkerArray

from bullet_lab.ros.gazebo.client import StandingModels
from bullet_lab.ros.nodes.spawn import free_name


def cube(name, x, size="x: 1.0, y: 1.0, z: 1.0", z=0.5, turn="w: 1.0"):
    """Return the marker of a cube (type 1) at a place."""
    pose = f"{{position: {{x: {x}, z: {z}}}, orientation: {{{turn}}}}}"
    return f"{{ns: {name}, type: 1, scale: {{{size}}}, pose: {pose}}}"


def models(*texts, known=None):
    """Return models of which markers tell."""
    found = known or StandingModels()
    found.take(message(MarkerArray, f"markers: [{', '.join(texts)}]"))
    return found


def test_boxes_are_as_large_as_they_are():
    along_y = "z: 0.7071067811865476, w: 0.7071067811865476"
    found = models(cube("box", 2.0, "x: 1.0, y: 2.0, z: 1.0", turn=along_y))
    assert found.nearest(2.0, 0.0) == ("box", 0.0)
    assert found.nearest(0.5, 0.0)[1] == pytest.approx(0.5)
    assert found.origin("box") == (2.0, 0.0, 0.5)
    assert found.origin("ball") is None


def test_meshes_are_as_large_as_their_file_says():
    text = """{ns: beacon_0, type: 10, scale: {x: 1.0, y: 1.0, z: 1.0},
        pose: {position: {x: 1.0, y: 1.0}, orientation: {w: 1.0}},
        mesh_resource: "package://bullet_lab/meshes/beacon.dae"}"""
    name, distance = models(text).nearest(2.0, 1.0)
    assert name == "beacon_0"
    assert distance == pytest.approx(0.75, abs=1e-3)


def test_floors_are_in_nobodys_way():
    found = models(cube("floor", 0.0, "x: 20.0, y: 20.0, z: 0.01", z=-0.01))
    assert found.names() == ("floor",)
    assert found.nearest(0.0, 0.0) == ("", math.inf)


def test_models_come_move_and_go():
    found = StandingModels()
    assert not found.is_known()
    models(cube("a", 0.0), cube("b", 5.0), known=found)
    assert found.is_known()
    models(cube("a", 3.0), known=found)
    assert found.nearest(0.0, 0.0)[1] == pytest.approx(2.5)
    models("{ns: a, action: 2}", known=found)
    assert found.names() == ("b",)
    models("{action: 3}", known=found)
    assert found.names() == ()


def test_the_first_free_name():
    assert free_name("beacon", []) == "beacon_0"
    assert free_name("beacon", ["beacon_0", "beacon_2", "floor"]) == "beacon_1"
