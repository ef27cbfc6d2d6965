"""Which model is the robot, and which topics are its own."""

from types import SimpleNamespace

import pytest
from bullet_lab.msg import ModelDescription, PluginDescription

from bullet_lab.ros.record.robot_parts import choose, robot_of, topics_of
from bullet_lab.ros.record.launch_file import assignments, reason_in

TWIST, ODOMETRY = "geometry_msgs/Twist", "nav_msgs/Odometry"


def model(name, *plugins, of_world_file=False):
    return ModelDescription(name=name, plugins=plugins, of_world_file=of_world_file)


def plugin(inputs=(), outputs=()):
    return PluginDescription(filename="lib.so", inputs=list(inputs), outputs=list(outputs))


def master(heard=(), spoken=()):
    return SimpleNamespace(heard=dict(heard), spoken=dict(spoken), services=set())


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


def answer(*models, said=()):
    return SimpleNamespace(models=models, said=list(said))


def test_topics_of_another_robot_are_not_its_own():
    now = master(
        {"/go": TWIST, "/rover/go": TWIST},
        {"/odom": ODOMETRY, "/rover/odom": ODOMETRY, "/joint_states": "sensor_msgs/JointState"},
    )
    robot = robot_of(ROVER, answer(CART, ROVER), now)
    assert (robot.drive, robot.odometry) == ("/rover/go", "/rover/odom")
    found = topics_of(CART, [CART, ROVER], now)
    assert set(found) == {"/odom", "/joint_states"}


def test_a_controller_drives_where_no_plugin_names_a_topic():
    husky = model("husky", plugin(), plugin([], ["/truth"]))
    now = master(
        {"/base/cmd_vel": TWIST, "/light": "std_msgs/Bool"},
        {"/odom": ODOMETRY, "/truth": ODOMETRY, "/base/other": "std_msgs/Bool"},
    )
    robot = robot_of(husky, answer(husky), now)
    assert (robot.drive, robot.odometry) == ("/base/cmd_vel", "/odom")


def test_the_odometry_is_that_of_the_plugin_that_drives():
    rover = model("rover", plugin([], ["/cmd/odom"]), plugin(["/cmd/vel"], ["/driven"]))
    now = master({"/cmd/vel": TWIST}, {"/cmd/odom": ODOMETRY, "/driven": ODOMETRY})
    assert robot_of(rover, answer(rover), now).odometry == "/driven"


def test_what_was_said_of_the_world_is_left_out():
    said = ["model 'wall': crooked", "model 'cart': odd", "model_xml of 'cart': odder"]
    robot = robot_of(CART, answer(WALL, CART, said=said), master())
    assert robot.said == ("model 'cart': odd", "model_xml of 'cart': odder")
    assert (robot.drive, robot.odometry) == ("", "")


def test_arguments_of_a_launch_file():
    assert assignments("") == []
    assert assignments("a:=1 b=2") == ["a:=1", "b:=2"]
    assert assignments("world:='a b=c'") == ["world:=a b=c"]


def test_why_a_launch_file_has_ended():
    log = "logging to x\n\x1b[31mResource not found: lidar\nROS path [0]=/x\x1b[0m\nThe traceback\n"
    assert reason_in(log) == "Resource not found: lidar"
    assert reason_in("start\nRLException: while processing a.launch:\nno b\nd") == (
        "RLException: while processing a.launch: no b"
    )
    assert reason_in("Error:\n") == "Error:"
    assert reason_in("done\n") == "done"
    assert reason_in("") == "without a word"
