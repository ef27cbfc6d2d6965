"""How a robot comes up, which model it is, and which topics are its own."""

from types import SimpleNamespace

import yaml
from bullet_lab.msg import ModelDescription
from message_fields import message, messages
from shared import cases, refuses

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


def master(subscribed=(), published=()):
    return SimpleNamespace(
        subscribed=dict(subscribed), published=dict(published), services=set()
    )


MODELS = messages(
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
    - {name: tb_2, plugins: [{inputs: [/2]}]}
    - {name: tb_0, plugins: [{inputs: [/0]}]}
    - {name: husky, plugins: [{}, {outputs: [/truth]}]}
    - {name: two, plugins: [{outputs: [/cmd/odom]}, {inputs: [/cmd/vel], outputs: [/driven]}]}
    """,
)


def named(names):
    """Return the models of these names."""
    return [model for name in names.split() for model in MODELS if model.name == name]


@cases("""
models, name, driven, of_world, chosen:
  # The models, the name that is asked for, what can be driven, whether the model may be of the
  # world file, and which is chosen.
  - [wall box lamp cart, "", /go, false, cart]
  - [wall box lamp, "", /go, false, lamp]
  - [wall box, "", /go, false, box]
  - [cart rover, rover, /go /rover/go, false, rover]
  - [cart wall, wall, /go, false, wall]
  - [wall, "", /go, false, null]
  - [cart, rover, /go, false, null]
  - [lamp tb_2 tb_0, "", /0 /2, false, tb_0]
  - [wall a_statue a_door mover, "", /go, false, null]
  - [wall a_statue a_door mover, "", /go, true, mover]
  - [wall a_statue a_door mover box, "", /go, true, box]
  # A controller may drive it, whose topic no plugin names.
  - [wall a_statue a_door, "", /base/go, true, a_door]
  - [wall a_statue a_door mover, "", "", true, null]
""")
def test_the_robot_is_one_that_can_be_driven(models, name, driven, of_world, chosen):
    found = choose(named(models), name, driven.split(), of_world)
    assert getattr(found, "name", None) == chosen


@cases("""
name, others, driven, told, drive, odometry:
  # The robot, the other models, topics of velocities and of odometry, and those of the robot.
  - [rover, cart, /go /rover/go, /odom /rover/odom, /rover/go, /rover/odom]
  # A controller drives where no plugin names a topic.
  - [husky, "", /base/cmd_vel, /odom /truth, /base/cmd_vel, /odom]
  # The odometry is that of the plugin that drives.
  - [two, "", /cmd/vel, /cmd/odom /driven, /cmd/vel, /driven]
  - [cart, wall, "", "", "", ""]
""")
def test_topics_of_the_robot(name, others, driven, told, drive, odometry):
    (model,) = named(name)
    now = master({"/light": "std_msgs/Bool"}, {"/base/other": "std_msgs/Bool"})
    now.subscribed.update(dict.fromkeys(driven.split(), "geometry_msgs/Twist"))
    now.published.update(dict.fromkeys(told.split(), "nav_msgs/Odometry"))
    robot = robot_of(model, named(others), [], now)
    assert (robot.drive, robot.odometry) == (drive, odometry)


def test_topics_of_another_robot_are_not_its_own():
    cart, rover = named("cart rover")
    published = dict.fromkeys(("/odom", "/rover/odom", "/joint_states"), "")
    assert set(topics_of(cart, [rover], published)) == {"/odom", "/joint_states"}


@cases("name: [cart, mover]")
def test_warnings_of_the_world_are_left_out(name):
    own = (f"model '{name}': odd", f"model_xml of '{name}': odder")
    (model,) = named(name)
    assert robot_of(model, named("wall"), ["model 'wall': crooked", *own], master()).said == own


def test_of_several_robots_the_choice_is_named():
    (zero,) = named("tb_0")
    now = master(dict.fromkeys(("/0", "/2"), "geometry_msgs/Twist"))
    assert robot_of(zero, named("lamp tb_2"), [], now).choice == ("tb_0", "tb_2")


def test_whom_model_may_name():
    assert candidates(named("a_statue")) == "no model in the world can move"
    assert candidates(named("box a_statue lamp")) == "model:=NAME takes one of lamp, box"


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


def find(monkeypatch, clock, name, coming):
    """Return what is found where models come at times (s), and when; time takes no time."""
    start = clock.now

    def models():
        names = [name for name, (at, _) in coming.items() if clock.now >= start + at]
        text = "{{name: {0}, of_world_file: {1}, plugins: [{{inputs: [/{0}]}}]}}"
        return [message(ModelDescription, text.format(name, coming[name][1])) for name in names]

    def now():
        drives = {f"/{model.name}": VELOCITIES for model in models()}
        return SimpleNamespace(services={SERVICE}, subscribed=drives)

    monkeypatch.setattr(robot_parts, "time", clock)
    monkeypatch.setattr(robot_parts, "Master", now)
    monkeypatch.setattr(robot_parts, "described", lambda: SimpleNamespace(models=models()))
    monkeypatch.setattr(robot_parts.rospy, "ServiceProxy", lambda *_: lambda: None)
    launched = SimpleNamespace(path="some.launch", check=lambda: None)
    return find_robot(name, launched).name, clock.now - start


@cases("""
name, coming, taken, within:
  # The name that is asked for, when models come, whether they are of the world file, which of them
  # is taken, and within what time (s).
  - ["", {tb3_1: [5, false], tb3_0: [6, false]}, tb3_0, 12]
  - [tb3_1, {tb3_1: [5, false], tb3_0: [6, false]}, tb3_1, 120]
  # A robot of the world file waits for others.
  - ["", {robot: [0, true]}, robot, 120]
  - ["", {robot: [0, true], spawned: [15, false]}, spawned, 120]
""")
def test_the_choice_waits_until_all_are_there(monkeypatch, clock, name, coming, taken, within):
    found, when = find(monkeypatch, clock, name, coming)
    assert (found, when < within) == (taken, True)


def test_nothing_comes(monkeypatch, clock):
    line = "no model 'cart' was spawned within 120 s; .* one of robot$"
    with refuses(line, NodeError):
        find(monkeypatch, clock, "cart", {"robot": (0, True)})


@cases("""
text, found:
  "": []
  "a:=1 b=2": ["a:=1", "b:=2"]
  "world:='a b=c'": ["world:=a b=c"]
""")
def test_arguments_of_a_launch_file(text, found):
    assert assignments(text) == found


@cases(r"""
log, reason:
  # Logs and the reason that they have.
  "logging to x\n\x1b[31mResource not found: lidar\nROS path [0]=/x\x1b[0m\nThe traceback\n":
    "Resource not found: lidar"
  "start\nRLException: while processing a.launch:\nno b\nd":
    "RLException: while processing a.launch: no b"
  "Error:\n": "Error:"
  "done\n": done
  "": no output
""")
def test_why_a_launch_file_has_ended(log, reason):
    assert reason_in(log) == reason


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
[ERROR] [17.2]: TypeError: only said
Traceback (most recent call last):
  File "/x/see.py", line 2, in <module>
    import keras
ModuleNotFoundError: No module named 'keras'
[see-5] process has died [pid 11, exit code 1, cmd /x/see.py __name:=see].
[quiet-6] process has died [pid 12, exit code 3, cmd /x/quiet __name:=quiet].
terminate called after throwing an instance of 'std::runtime_error'
  what():  no camera
[eye-7] process has died [pid 13, exit code -6, cmd /x/eye __name:=eye].
"""
FAILURES = """
- "map_server/map_server: there is no ROS package 'map_server'; Debian has none that is known"
- "nodelet/nodelet: there is no ROS package 'nodelet'; Debian has it: libnodeletlib-tools (2 times)"
- "mine/run.py: Cannot locate node of type [run.py] in package"
- "tf/tf_echo: there is no ROS package 'tf'; Debian has it: libtf-dev"
- gripper-4 has died (exit code -11, SIGSEGV)
- "see-5 has died (exit code 1): ModuleNotFoundError: No module named 'keras'"
- quiet-6 has died (exit code 3)
- "eye-7 has died (exit code -6, SIGABRT): no camera"
"""


def test_nodes_that_could_not_start_or_died(monkeypatch):
    # The nodes of tf are there, and its package.xml is not.
    packages = {("nodelet",): "libnodeletlib-tools", ("tf", "lib{}-dev"): "libtf-dev"}
    monkeypatch.setattr(
        robot_parts, "debian_package", lambda name, forms=(): packages.get((name, *forms), "")
    )
    assert failures_in(LOG) == yaml.safe_load(FAILURES)
    assert failures_in("") == []


APT = """Package: tf
Description: text-based MUD client

Package: tf-tools
Description: Set of utilities to operate with the Robot OS tf lib

Package: tf2-tools
Homepage: https://wiki.ros.org/geometry2
"""


@cases("""
package, found:
  - [tf, tf-tools]
  - [tf2_ros, tf2-tools]
  - [amcl, ""]
""")
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
