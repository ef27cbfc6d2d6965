"""How a robot comes up, which model it is, and which topics are its own."""

from types import SimpleNamespace

import pytest
from bullet_lab.msg import ModelDescription, PluginDescription

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
    found = topics_of(CART, [ROVER], now.published)
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


class Clock:
    """Wall time that goes on by what is slept."""

    def __init__(self):
        self.now = 0.0

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds


@pytest.fixture
def found(monkeypatch):
    """What is found where these models come at these times (s), and when."""

    def find(name, path="some.launch", **coming):
        clock = Clock()
        robots = {m: (at, of_world) for m, (at, of_world) in coming.items()}

        def models():
            return [
                ModelDescription(
                    name=name,
                    of_world_file=of_world,
                    plugins=[PluginDescription(inputs=[f"/{name}/go"])],
                )
                for name, (at, of_world) in robots.items()
                if clock.now >= at
            ]

        def subscribed():
            return {f"/{model.name}/go": VELOCITIES for model in models()}

        monkeypatch.setattr(robot_parts, "time", clock)
        monkeypatch.setattr(
            robot_parts,
            "Master",
            lambda: SimpleNamespace(services={SERVICE}, subscribed=subscribed()),
        )
        monkeypatch.setattr(robot_parts, "described", lambda: SimpleNamespace(models=models()))
        monkeypatch.setattr(robot_parts.rospy, "ServiceProxy", lambda *_: lambda: None)
        launched = SimpleNamespace(path=path, check=lambda: None)
        monkeypatch.setattr(robot_parts.rospy, "is_shutdown", lambda: False)
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
process[spawn-2]: started with pid [7]
[spawn-2] process has finished cleanly
\x1b[31m[gripper-4] process has died [pid 10, exit code -11, cmd /x/gripper __name:=gripper].
log file: /tmp/gripper-4*.log\x1b[0m
"""


def test_nodes_that_could_not_start_or_died(monkeypatch):
    packages = {"nodelet": "libnodeletlib-tools"}
    monkeypatch.setattr(robot_parts, "debian_package", lambda name: packages.get(name, ""))
    assert failures_in(LOG) == [
        "map_server/map_server: there is no ROS package 'map_server'; "
        "Debian has none that is known",
        "nodelet/nodelet: there is no ROS package 'nodelet'; Debian has it: libnodeletlib-tools "
        "(2 times)",
        "mine/run.py: Cannot locate node of type [run.py] in package",
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
    debian_package.cache_clear()
    assert debian_package(package) == found
    debian_package.cache_clear()
    # What is installed already does not help.
    (tmp_path / f"{found}:amd64.list").touch()
    assert debian_package(package) == ""
    debian_package.cache_clear()


def test_a_machine_without_apt(monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    debian_package.cache_clear()
    assert debian_package("amcl") == ""
    debian_package.cache_clear()


def test_no_launch_file():
    launched = Launched("", "")
    launched.check()
    assert launched.failures() == []
    launched.close()
