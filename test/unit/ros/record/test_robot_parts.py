"""How a robot comes up, which model it is, and which topics are its own."""

from types import SimpleNamespace

import pytest
from bullet_lab.msg import ModelDescription
from message_fields import message, messages

from bullet_lab.ros.node.node import NodeError
from bullet_lab.ros.record import robot_parts
from bullet_lab.ros.record.robot_parts import (
    SERVICE,
    VELOCITIES,
    Launched,
    assignments,
    candidates,
    choose,
    debian_package,
    failures_in,
    find_robot,
    reason_in,
    robot_of,
    topics_of,
    why_it_stands,
)

TWIST, ODOMETRY = "geometry_msgs/Twist", "nav_msgs/Odometry"


def master(subscribed=(), published=()):
    return SimpleNamespace(
        subscribed=dict(subscribed), published=dict(published), services=set()
    )


CART, ROVER, LAMP, BOX, WALL, DOOR, MOVER, STATUE = messages(
    ModelDescription,
    """
    - {name: cart, plugins: [{inputs: [/go], outputs: [/odom]}]}
    - {name: rover, plugins: [{inputs: [/rover/go], outputs: [/rover/odom]}]}
    - {name: lamp, plugins: [{outputs: [/light]}]}
    - {name: box}
    - {name: wall, of_world_file: true}
    - {name: a_door, of_world_file: true, plugins: [{}]}
    - {name: mover, of_world_file: true, plugins: [{inputs: [/go]}]}
    - {name: a_statue, of_world_file: true, plugins: [{inputs: [/go]}], is_static: true}
    """,
)


@pytest.mark.parametrize(
    ("models", "name", "found"),
    [
        ([WALL, BOX, LAMP, CART], "", CART),
        ([WALL, BOX, LAMP], "", LAMP),
        ([WALL, BOX], "", BOX),
        ([CART, ROVER], "rover", ROVER),
        ([CART, WALL], "wall", WALL),
        ([WALL], "", None),
        ([CART], "rover", None),
    ],
)
def test_the_robot_is_one_that_can_be_driven(models, name, found):
    assert choose(models, name, ["/go", "/rover/go"]) is found


def test_topics_of_another_robot_are_not_its_own():
    now = master(
        {"/go": TWIST, "/rover/go": TWIST},
        {"/odom": ODOMETRY, "/rover/odom": ODOMETRY, "/joint_states": "sensor_msgs/JointState"},
    )
    robot = robot_of(ROVER, [CART], [], now)
    assert (robot.drive, robot.odometry) == ("/rover/go", "/rover/odom")
    assert set(topics_of(CART, [ROVER], now.published)) == {"/odom", "/joint_states"}


def test_a_controller_drives_where_no_plugin_names_a_topic():
    husky = message(ModelDescription, "{name: husky, plugins: [{}, {outputs: [/truth]}]}")
    now = master(
        {"/base/cmd_vel": TWIST, "/light": "std_msgs/Bool"},
        {"/odom": ODOMETRY, "/truth": ODOMETRY, "/base/other": "std_msgs/Bool"},
    )
    robot = robot_of(husky, [], [], now)
    assert (robot.drive, robot.odometry) == ("/base/cmd_vel", "/odom")


def test_the_odometry_is_that_of_the_plugin_that_drives():
    text = "plugins: [{outputs: [/cmd/odom]}, {inputs: [/cmd/vel], outputs: [/driven]}]"
    now = master({"/cmd/vel": TWIST}, {"/cmd/odom": ODOMETRY, "/driven": ODOMETRY})
    assert robot_of(message(ModelDescription, text), [], [], now).odometry == "/driven"


def test_warnings_of_the_world_are_left_out():
    warnings = ["model 'wall': crooked", "model 'cart': odd", "model_xml of 'cart': odder"]
    robot = robot_of(CART, [WALL], warnings, master())
    assert robot.said == ("model 'cart': odd", "model_xml of 'cart': odder")
    assert (robot.drive, robot.odometry) == ("", "")


def test_of_several_robots_the_first_by_name_is_driven():
    text = "[{name: tb_2, plugins: [{inputs: [/2]}]}, {name: tb_0, plugins: [{inputs: [/0]}]}]"
    two, zero = messages(ModelDescription, text)
    assert choose([LAMP, two, zero], "", ["/0", "/2"]) is zero
    now = master({"/0": TWIST, "/2": TWIST})
    assert robot_of(zero, [LAMP, two], [], now).choice == ("tb_0", "tb_2")


def test_a_robot_of_the_world_file_is_taken_where_nothing_else_came():
    world = [WALL, STATUE, DOOR, MOVER]
    assert choose(world, "", ["/go"]) is None
    assert choose(world, "", ["/go"], True) is MOVER
    assert choose([*world, BOX], "", ["/go"], True) is BOX
    # A controller may drive it, whose topic no plugin names.
    assert choose([WALL, STATUE, DOOR], "", ["/base/go"], True) is DOOR
    assert choose(world, "", [], True) is None
    # Warnings about the robot are not those of the world.
    warnings = ["model 'mover': odd", "model 'wall': crooked"]
    assert robot_of(MOVER, world[:-1], warnings, master()).said == ("model 'mover': odd",)


def test_whom_model_may_name():
    assert candidates([STATUE]) == "no model in the world can move"
    assert candidates([BOX, STATUE, LAMP]) == "model:=NAME takes one of lamp, box"


def test_why_a_robot_stands(monkeypatch):
    rates = {"cart::left": [2.0], "cart::right": [0.0], "cart::ball": []}
    answers = {joint: SimpleNamespace(rate=rate) for joint, rate in rates.items()}
    monkeypatch.setattr(robot_parts.rospy, "ServiceProxy", lambda *_: answers.__getitem__)
    cart = message(ModelDescription, "name: cart")
    assert why_it_stands(cart, "/go", False) == ["nothing listens to /go"]
    assert why_it_stands(cart, "/go", True) == ["it stands on nothing"]
    cart.joints, cart.stands_on = ["left", "right", "ball"], ["base"]
    assert why_it_stands(cart, "/go", True) == ["left of its joints turn", "it stands on base"]
    rates["cart::left"][0] = 0.0
    assert why_it_stands(cart, "/go", True)[0] == "none of its joints turn"
    cart.is_static = True
    assert why_it_stands(cart, "/go", True) == ["the model is static"]


@pytest.fixture
def found(monkeypatch):
    """What is found where these models come at these times (s), and when; time takes no time."""

    def find(name, **coming):
        clock = SimpleNamespace(now=0.0, monotonic=lambda: clock.now)
        clock.sleep = lambda seconds: setattr(clock, "now", clock.now + seconds)

        def models():
            return [
                message(
                    ModelDescription,
                    f"{{name: {model}, of_world_file: {world}, plugins: [{{inputs: [/{model}]}}]}}",
                )
                for model, (at, world) in coming.items()
                if clock.now >= at
            ]

        def now():
            drives = {f"/{model.name}": VELOCITIES for model in models()}
            return SimpleNamespace(services={SERVICE}, subscribed=drives)

        monkeypatch.setattr(robot_parts, "time", clock)
        monkeypatch.setattr(robot_parts, "Master", now)
        monkeypatch.setattr(robot_parts, "described", lambda: SimpleNamespace(models=models()))
        monkeypatch.setattr(robot_parts.rospy, "ServiceProxy", lambda *_: lambda: None)
        monkeypatch.setattr(robot_parts.rospy, "is_shutdown", lambda: False)
        launched = SimpleNamespace(path="some.launch", check=lambda: None)
        return find_robot(name, launched).name, clock.now

    return find


def test_the_choice_waits_until_all_are_there(found):
    name, when = found("", tb3_1=(5.0, False), tb3_0=(6.0, False))
    assert (name, when < 12.0) == ("tb3_0", True)
    assert found("tb3_1", tb3_1=(5.0, False), tb3_0=(6.0, False))[0] == "tb3_1"


def test_a_robot_of_the_world_file_waits_for_others(found):
    assert found("", robot=(0.0, True))[0] == "robot"
    assert found("", robot=(0.0, True), spawned=(15.0, False))[0] == "spawned"


def test_nothing_comes(found):
    line = "no model 'cart' was spawned within 120 s; .* one of robot$"
    with pytest.raises(NodeError, match=line):
        found("cart", robot=(0.0, True))


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
    assert reason_in("") == "no output"


LOG = """started roslaunch server http://here:1/
\x1b[31mERROR: cannot launch node of type [map_server/map_server]: map_server
ROS path [0]=/usr/share\x1b[0m
ERROR: cannot launch node of type [nodelet/nodelet]: nodelet
ERROR: cannot launch node of type [nodelet/nodelet]: nodelet
ERROR: cannot launch node of type [mine/run.py]: Cannot locate node of type [run.py] in package
ERROR: cannot launch node of type [tf/tf_echo]: tf
process[spawn-2]: started with pid [7]
[spawn-2] process has finished cleanly
\x1b[31m[gripper-4] process has died [pid 10, exit code -11, cmd /x/gripper __name:=gripper].
log file: /tmp/gripper-4*.log\x1b[0m
"""


def test_nodes_that_could_not_start_or_died(monkeypatch):
    # The nodes of tf are there, and its package.xml is not.
    packages = {("nodelet",): "libnodeletlib-tools", ("tf", "lib{}-dev"): "libtf-dev"}
    monkeypatch.setattr(
        robot_parts, "debian_package", lambda name, forms=(): packages.get((name, *forms), "")
    )
    assert failures_in(LOG) == [
        "map_server/map_server: there is no ROS package 'map_server'; "
        "Debian has none that is known",
        "nodelet/nodelet: there is no ROS package 'nodelet'; Debian has it: libnodeletlib-tools "
        "(2 times)",
        "mine/run.py: Cannot locate node of type [run.py] in package",
        "tf/tf_echo: there is no ROS package 'tf'; Debian has it: libtf-dev",
        "gripper-4 has died (exit code -11)",
    ]
    assert failures_in("") == []


APT = """Package: tf
Description: text-based MUD client

Package: tf-tools
Description: Set of utilities to operate with the Robot OS tf lib

Package: tf2-tools
Homepage: https://wiki.ros.org/geometry2
"""


@pytest.mark.parametrize(
    ("package", "found"), [("tf", "tf-tools"), ("tf2_ros", "tf2-tools"), ("amcl", "")]
)
def test_the_debian_package_of_a_ros_package(monkeypatch, tmp_path, package, found):
    def run(command, **_):
        shown = [part for part in APT.split("\n\n") if part.split()[1] in command]
        return SimpleNamespace(stdout="\n\n".join(shown).encode())

    monkeypatch.setattr(robot_parts.subprocess, "run", run)
    monkeypatch.setattr(robot_parts, "INSTALLED", tmp_path)
    package_of = debian_package.__wrapped__
    assert package_of(package) == found
    # What is installed already does not help.
    (tmp_path / f"{found}:amd64.list").touch()
    assert package_of(package) == ""


def test_a_machine_without_apt(monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    assert debian_package.__wrapped__("amcl") == ""


def test_no_launch_file():
    launched = Launched("", "")
    launched.check()
    assert launched.failures() == []
    launched.close()
