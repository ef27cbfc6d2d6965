"""Which model is the robot, which topics are its own, and where a camera sees the whole of it."""

import math
from itertools import product
from types import SimpleNamespace

import pytest
from bullet_lab.msg import ModelDescription, PluginDescription

from bullet_lab.ros.record import robot_parts
from bullet_lab.ros.record.robot_parts import (
    CLEARANCE,
    FIELD_OF_VIEW,
    camera_pose,
    candidates,
    choose,
    distance_to,
    plugins_of,
    robot_of,
    topics_of,
    why_it_stands,
)

TWIST, ODOMETRY = "geometry_msgs/Twist", "nav_msgs/Odometry"


def model(name, *plugins, of_world_file=False):
    return ModelDescription(name=name, plugins=plugins, of_world_file=of_world_file)


def plugin(inputs=(), outputs=()):
    return PluginDescription(filename="lib.so", inputs=list(inputs), outputs=list(outputs))


def master(subscribed=(), published=()):
    return SimpleNamespace(
        subscribed=dict(subscribed), published=dict(published), services=set()
    )


CART = model("cart", plugin(["/go"], ["/odom"]))
ROVER = model("rover", plugin(["/rover/go"], ["/rover/odom"]))
LAMP = model("lamp", plugin([], ["/light"]))
WALL = model("wall", of_world_file=True)
BOX = model("box")


@pytest.mark.parametrize(
    ("models", "name", "found"),
    [
        ([WALL, BOX, LAMP, CART], "", "cart"),
        ([WALL, BOX, LAMP], "", "lamp"),
        ([WALL, BOX], "", "box"),
        ([CART, ROVER], "rover", "rover"),
        ([CART, WALL], "wall", "wall"),
    ],
)
def test_the_robot_is_one_that_can_be_driven(models, name, found):
    assert choose(models, name, ["/go", "/rover/go"]).name == found


@pytest.mark.parametrize(("models", "name"), [([], ""), ([WALL], ""), ([CART], "rover")])
def test_no_robot_yet(models, name):
    assert choose(models, name, ["/go"]) is None


def test_topics_of_another_robot_are_not_its_own():
    now = master(
        {"/go": TWIST, "/rover/go": TWIST},
        {"/odom": ODOMETRY, "/rover/odom": ODOMETRY, "/joint_states": "sensor_msgs/JointState"},
    )
    robot = robot_of(ROVER, [CART], [], now)
    assert (robot.drive, robot.odometry) == ("/rover/go", "/rover/odom")
    found = topics_of(CART, [ROVER], now)
    assert set(found) == {"/odom", "/joint_states"}


def test_a_controller_drives_where_no_plugin_names_a_topic():
    husky = model("husky", plugin(), plugin([], ["/truth"]))
    now = master(
        {"/base/cmd_vel": TWIST, "/light": "std_msgs/Bool"},
        {"/odom": ODOMETRY, "/truth": ODOMETRY, "/base/other": "std_msgs/Bool"},
    )
    robot = robot_of(husky, [], [], now)
    assert (robot.drive, robot.odometry) == ("/base/cmd_vel", "/odom")


def test_the_odometry_is_that_of_the_plugin_that_drives():
    rover = model("rover", plugin([], ["/cmd/odom"]), plugin(["/cmd/vel"], ["/driven"]))
    now = master({"/cmd/vel": TWIST}, {"/cmd/odom": ODOMETRY, "/driven": ODOMETRY})
    assert robot_of(rover, [], [], now).odometry == "/driven"


def test_warnings_of_the_world_are_left_out():
    warnings = ["model 'wall': crooked", "model 'cart': odd", "model_xml of 'cart': odder"]
    robot = robot_of(CART, [WALL], warnings, master())
    assert robot.said == ("model 'cart': odd", "model_xml of 'cart': odder")
    assert (robot.drive, robot.odometry) == ("", "")


def test_of_several_robots_the_first_by_name_is_driven():
    tb = [model(f"tb3_{n}", plugin([f"/tb3_{n}/go"])) for n in (2, 0, 1)]
    drives = [f"/tb3_{n}/go" for n in range(3)]
    assert choose([LAMP, *tb], "", drives).name == "tb3_0"
    now = master(dict.fromkeys(drives, TWIST))
    assert robot_of(tb[1], [LAMP, tb[0], tb[2]], [], now).choice == ("tb3_0", "tb3_1", "tb3_2")


def test_a_robot_of_the_world_file_is_taken_where_nothing_else_came():
    robot = model("robot", plugin(["/go"]), of_world_file=True)
    statue = model("a_statue", plugin(["/go"]), of_world_file=True)
    statue.is_static = True
    door = model("a_door", plugin(), of_world_file=True)
    world = [WALL, statue, door, robot]
    assert choose(world, "", ["/go"]) is None
    assert choose(world, "", ["/go"], True).name == "robot"
    assert choose([*world, BOX], "", ["/go"], True).name == "box"
    # A controller may drive it, whose topic no plugin names.
    assert choose([WALL, statue, door], "", ["/base/go"], True).name == "a_door"
    assert choose(world, "", [], True) is None
    # Warnings about the robot are not those of the world.
    warnings = ["model 'robot': odd", "model 'wall': crooked"]
    assert robot_of(robot, world[:-1], warnings, master()).said == ("model 'robot': odd",)


def test_whom_model_may_name():
    wall = model("wall", of_world_file=True)
    wall.is_static = True
    assert candidates([wall]) == "no model in the world can move"
    assert candidates([BOX, wall, LAMP]) == "model:=NAME takes one of lamp, box"


def test_the_plugins_of_models():
    assert [row.outputs for row in plugins_of([CART, ROVER])] == [("/odom",), ("/rover/odom",)]


def test_why_a_robot_stands(monkeypatch):
    rates = {"cart::left": [2.0], "cart::right": [0.0], "cart::ball": []}
    answers = {joint: SimpleNamespace(rate=rate) for joint, rate in rates.items()}
    monkeypatch.setattr(robot_parts.rospy, "ServiceProxy", lambda *_: answers.__getitem__)
    cart = model("cart")
    assert why_it_stands(cart, "/go", False) == ["nothing listens to /go"]
    assert why_it_stands(cart, "/go", True) == ["it stands on nothing"]
    cart.joints, cart.stands_on = ["left", "right", "ball"], ["base"]
    assert why_it_stands(cart, "/go", True) == ["left of its joints turn", "it stands on base"]
    rates["cart::left"][0] = 0.0
    assert why_it_stands(cart, "/go", True)[0] == "none of its joints turn"
    cart.is_static = True
    assert why_it_stands(cart, "/go", True) == ["the model is static"]


BOXES = [
    ((-0.1, -0.1, 0.0), (0.1, 0.1, 0.2)),
    ((2.0, -5.0, 0.1), (4.0, -4.5, 0.4)),
    ((-0.1, -0.1, 0.0), (0.1, 0.1, 3.0)),
]


@pytest.mark.parametrize("box", BOXES)
def test_every_corner_is_in_the_picture(box):
    eye = camera_pose(*box).inverse()
    for corner in product(*zip(*box)):
        x, y, z = (eye * type(eye)(corner)).position
        assert x > CLEARANCE * distance_to(*box)
        assert math.atan2(abs(y), x) < 0.5 * FIELD_OF_VIEW
        # The picture is three quarters as high as wide.
        assert abs(z) / x < 0.75 * math.tan(0.5 * FIELD_OF_VIEW)


def test_a_point_is_looked_at_from_somewhere():
    assert distance_to((1.0, 1.0, 1.0), (1.0, 1.0, 1.0)) > 0.1
