import math

import pytest
from geometry_msgs.msg import Vector3
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.ros.gazebo.client import StandingModels
from bullet_lab.ros.nodes.populate import free_name


def marker(name, kind, x=0.0, y=0.0, z=0.5, scale=(1.0, 1.0, 1.0), yaw=0.0, number=0):
    made = Marker(ns=name, id=number, type=kind, scale=Vector3(*scale))
    made.pose.position.x, made.pose.position.y, made.pose.position.z = x, y, z
    made.pose.orientation.z, made.pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
    return made


def models(*markers):
    found = StandingModels()
    found.take(MarkerArray(list(markers)))
    return found


def test_boxes_are_as_large_as_they_are():
    found = models(marker("box", Marker.CUBE, 2.0, 0.0, scale=(1.0, 2.0, 1.0), yaw=math.pi / 2))
    assert found.nearest(2.0, 0.0) == ("box", 0.0)
    name, distance = found.nearest(0.5, 0.0)
    assert distance == pytest.approx(0.5)
    assert found.origin("box") == (2.0, 0.0, 0.5)
    assert found.origin("ball") is None


def test_meshes_are_as_large_as_their_file_says():
    beacon = marker("beacon_0", Marker.MESH_RESOURCE, 1.0, 1.0, 0.0)
    beacon.mesh_resource = "package://bullet_lab/meshes/beacon.dae"
    name, distance = models(beacon).nearest(2.0, 1.0)
    assert name == "beacon_0"
    assert distance == pytest.approx(0.75, abs=1e-3)


def test_floors_are_in_nobodys_way():
    found = models(marker("floor", Marker.CUBE, z=-0.01, scale=(20.0, 20.0, 0.01)))
    assert found.names() == ("floor",)
    assert found.nearest(0.0, 0.0) == ("", math.inf)


def test_models_come_move_and_go():
    found = StandingModels()
    assert not found.is_known()
    found.take(MarkerArray([marker("a", Marker.CUBE), marker("b", Marker.SPHERE, 5.0)]))
    assert found.is_known()
    found.take(MarkerArray([marker("a", Marker.CUBE, 3.0)]))
    assert found.nearest(0.0, 0.0)[1] == pytest.approx(2.5)
    gone = marker("a", Marker.CUBE)
    gone.action = Marker.DELETE
    found.take(MarkerArray([gone]))
    assert found.names() == ("b",)
    found.take(MarkerArray([Marker(action=Marker.DELETEALL)]))
    assert found.names() == ()


def test_the_first_free_name():
    assert free_name("beacon", []) == "beacon_0"
    assert free_name("beacon", ["beacon_0", "beacon_2", "floor"]) == "beacon_1"
