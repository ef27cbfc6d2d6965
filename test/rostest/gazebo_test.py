#!/usr/bin/env python3
"""Clients in the manner of Gazebo's find its services and topics, types and habits."""

import copy
import importlib
import math
import subprocess
import sys
import tempfile
import threading
import time
import unittest
from pathlib import Path

import rosgraph
import rospy
import rostest
from bullet_lab.srv import Advance, SaveWorld, SetRtf, Step
from gazebo_msgs.msg import (
    LinkState,
    LinkStates,
    ModelState,
    ModelStates,
    ODEJointProperties,
    ODEPhysics,
    PerformanceMetrics,
)
from gazebo_msgs.srv import (
    ApplyBodyWrench,
    ApplyJointEffort,
    BodyRequest,
    DeleteLight,
    DeleteModel,
    GetJointProperties,
    GetLightProperties,
    GetLinkProperties,
    GetLinkState,
    GetModelProperties,
    GetModelState,
    GetPhysicsProperties,
    GetWorldProperties,
    JointRequest,
    SetJointProperties,
    SetLightProperties,
    SetLightPropertiesRequest,
    SetLinkProperties,
    SetLinkPropertiesRequest,
    SetLinkState,
    SetModelConfiguration,
    SetModelState,
    SetPhysicsProperties,
    SpawnModel,
)
from geometry_msgs.msg import Point, Pose, Quaternion, Twist, Vector3, Wrench
from lab_testing import PACKAGE, Node, Topic, publisher, wait_for
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from std_msgs.msg import ColorRGBA
from std_srvs.srv import Empty
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.simulation.world.sdf import read_world_file

ROBOT = "package://bullet_lab/urdf/block_robot.urdf"
BLOCK = (PACKAGE / "urdf" / "block_robot.urdf").read_text()
BEACON = '<sdf version="1.6"><include><uri>model://beacon</uri></include></sdf>'
START = Pose(Point(0.0, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))

BALL = """<sdf version="1.6"><model name="ball"><pose>0 0 0.5 0 0 0</pose><link name="link">
  <inertial><mass>2</mass><inertia><ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz></inertia></inertial>
  <collision name="skin"><geometry><sphere><radius>0.1</radius></sphere></geometry></collision>
  <visual name="look"><geometry><sphere><radius>0.1</radius></sphere></geometry></visual>
</link></model></sdf>"""

PENDULUM = """<robot name="pendulum">
  <link name="foot"><inertial><mass value="500"/>
    <inertia ixx="99" iyy="99" izz="99" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><box size="2 2 0.2"/></geometry></collision></link>
  <link name="rod"><inertial><mass value="1"/>
    <inertia ixx="0.5" iyy="0.5" izz="0.5" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="continuous"><origin xyz="0 0 1"/>
    <parent link="foot"/><child link="rod"/><axis xyz="0 0 1"/></joint>
</robot>"""

LAMP = """<sdf version="1.6"><light name="bulb" type="point"><pose>0 0 3 0 0 0</pose>
  <diffuse>1 0.5 0.25 1</diffuse><attenuation><range>20</range><constant>0.5</constant>
  <linear>0.1</linear><quadratic>0.02</quadratic></attenuation></light></sdf>"""

# As the course's scripts do it: positional arguments, the model's file from the package.
SPAWN_CLIENT = """
import sys
import rospy
from gazebo_msgs.srv import DeleteModel, SpawnModel
from geometry_msgs.msg import Point, Pose, Quaternion

rospy.init_node("spawner")
rospy.wait_for_service("gazebo/spawn_sdf_model")
spawn = rospy.ServiceProxy("gazebo/spawn_sdf_model", SpawnModel)
with open(sys.argv[1]) as file:
    text = file.read()
for number in range(3):
    pose = Pose(Point(number, 2, 0), Quaternion(0, 0, 0, 1))
    print(spawn("thing_%d" % number, text, "", pose, "world").status_message)
rospy.ServiceProxy("gazebo/delete_model", DeleteModel)("thing_1")
"""


def call(service, kind, *arguments):
    """Call a service once it is there."""
    rospy.wait_for_service(service, 60)
    return rospy.ServiceProxy(service, kind)(*arguments)


def at(x, y, z, yaw=0.0):
    """A pose."""
    return Pose(Point(x, y, z), Quaternion(0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)))


def spawn(name, xml, pose=START, namespace="", frame="", service="spawn_sdf_model"):
    """Spawn a model; return the answer."""
    return call(f"/gazebo/{service}", SpawnModel, name, xml, namespace, pose, frame)


def state_of(name, frame=""):
    """A model's state."""
    return call("/gazebo/get_model_state", GetModelState, name, frame)


def place_of(name, frame=""):
    """Where a model is."""
    position = state_of(name, frame).pose.position
    return position.x, position.y, position.z


def names():
    """All models."""
    return call("/gazebo/get_world_properties", GetWorldProperties).model_names


def step(steps):
    """Advance by so many steps."""
    return call("/bullet_lab/step", Step, steps)


class GazeboCase(unittest.TestCase):
    """Starts a bridge, paused and at full speed if not said otherwise."""

    def start(self, **parameters):
        bridge = Node("pybullet_bridge.py", **{"paused": True, "rtf": 0, **parameters})
        self.addCleanup(bridge.end)
        wait_for(lambda: self.is_ready(bridge), "the bridge's services")
        return bridge

    def is_ready(self, bridge):
        self.assertTrue(bridge.runs(), bridge.err)
        try:
            rospy.wait_for_service("/bullet_lab/advance", 0.05)
        except rospy.ROSException:
            return False
        return True

    def topic(self, name, kind):
        topic = Topic(name, kind)
        self.addCleanup(topic.close)
        return topic

    def folder(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        return Path(folder.name)

    def assert_near(self, expected, found, tolerance=1e-6):
        self.assertLess(math.dist(expected, found), tolerance, f"{found}, expected {expected}")

    def assert_refused(self, said, answer):
        self.assertFalse(answer.success)
        self.assertRegex(answer.status_message, said)


class SpawnTest(GazeboCase):
    """Models come and go."""

    def test_script_in_the_manner_of_the_course(self):
        self.start()
        path = PACKAGE / "models" / "beacon" / "model.sdf"
        command = [sys.executable, "-c", SPAWN_CLIENT, str(path)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
        self.assertEqual(
            3 * ["SpawnModel: Successfully spawned entity"], done.stdout.splitlines(), done.stderr
        )
        self.assertEqual(["ground_plane", "thing_0", "thing_2"], names())
        self.assert_near((2.0, 2.0, 0.0), place_of("thing_2"))

    def test_initial_pose_is_composed_with_the_models_own_in_a_frame(self):
        self.start()
        self.assertTrue(spawn("first", BALL, at(1.0, 2.0, 0.0, math.pi / 2)).success)
        self.assert_near((1.0, 2.0, 0.5), place_of("first"))
        self.assertTrue(spawn("second", BALL, at(3.0, 0.0, 0.0), frame="first").success)
        self.assert_near((1.0, 5.0, 1.0), place_of("second"))
        self.assertTrue(spawn("third", BALL, at(0.0, 0.0, 1.0), frame="second::link").success)
        self.assert_near((1.0, 5.0, 2.5), place_of("third"))
        self.assert_near((3.0, 0.0, 0.5), place_of("second", "first"))
        refused = spawn("fourth", BALL, frame="nix::link")
        self.assert_refused("entity .nix::link. not found.*scope the link", refused)
        # What messages start with is no rotation, as in Gazebo.
        self.assertTrue(spawn("fifth", BALL, Pose()).success)

    def test_robot_in_a_namespace_speaks_and_falls_silent(self):
        self.start(robot=ROBOT)
        rospy.set_param("/left/tf_prefix", "second")
        self.addCleanup(rospy.delete_param, "/left/tf_prefix")
        answer = spawn("second", BLOCK, at(0.0, 3.0, 0.0), "left", service="spawn_urdf_model")
        self.assertTrue(answer.success, answer)
        first, second = self.topic("odom", Odometry), self.topic("left/odom", Odometry)
        commands = publisher("left/cmd_vel", Twist)
        self.addCleanup(commands.unregister)
        commands.publish(Twist(linear=Vector3(0.5, 0.0, 0.0)))
        end_of_time = rospy.Time(2**31 - 1)
        sent = (["/left/cmd_vel"], ["/pybullet_bridge"], [1])
        call("/bullet_lab/advance", Advance, rospy.get_name(), 0, end_of_time, *sent)
        step(1000)
        self.assertGreater(second.wait(20)[-1].pose.pose.position.x, 0.4)
        self.assertEqual("second/odom", second.messages[-1].header.frame_id)
        self.assert_near((0.0,), (first.wait(20)[-1].pose.pose.position.x,), 1e-3)
        self.assertTrue(call("/gazebo/delete_model", DeleteModel, "second").success)
        published = dict(rosgraph.Master("/test").getPublishedTopics(""))
        self.assertNotIn("/left/odom", published)
        step(1000)
        first.wait(40)
        self.assertEqual(20, len(second.messages))

    def test_name_twice_and_unknown_names(self):
        self.start()
        self.assertTrue(spawn("one", BALL).success)
        twice = spawn("one", BEACON)
        self.assertEqual("SpawnModel: Failure - entity already exists.", twice.status_message)
        self.assertFalse(twice.success)
        nix = call("/gazebo/delete_model", DeleteModel, "nix")
        self.assert_refused(r"DeleteModel: model \[nix\] does not exist", nix)
        self.assert_refused(r"GetModelState: model \[nix\] does not exist", state_of("nix"))
        self.assert_refused("entity .nix. not found", state_of("one", "nix"))
        properties = call("/gazebo/get_model_properties", GetModelProperties, "nix")
        self.assert_refused("nix", properties)

    def test_bad_models_are_refused_while_a_robot_drives_on(self):
        bridge = self.start(robot=ROBOT, paused=False, rtf=1)
        clock = self.topic("/clock", Clock)
        commands = publisher("cmd_vel", Twist)
        self.addCleanup(commands.unregister)
        commands.publish(Twist(linear=Vector3(0.5, 0.0, 0.0)))
        bad = {
            "not well-formed": "<sdf",
            "neither <sdf> nor <robot>": "<html/>",
            "document types": "<!DOCTYPE a><sdf/>",
            "leaves its folder": BEACON.replace("model://beacon", "package://bullet_lab/../x"),
            "in none of the model folders": BEACON.replace("beacon", "nix"),
            "loop of joints at foot, rod": PENDULUM.replace(
                "</robot>",
                '<joint name="back" type="fixed"><parent link="rod"/><child link="foot"/></joint>'
                "</robot>",
            ),
            "child link 'rod' appears twice": PENDULUM.replace(
                "</robot>",
                '<joint name="twice" type="fixed"><parent link="foot"/><child link="rod"/></joint>'
                "</robot>",
            ),
            "a <link> without a name": PENDULUM.replace('<link name="rod">', "<link>"),
        }
        for said, xml in bad.items():
            self.assert_refused(f"SpawnModel: Failure - .*{said}", spawn("bad", xml))
        nowhere = spawn("bad", BALL, at(math.nan, 0.0, 0.0))
        self.assert_refused("position is not finite", nowhere)
        self.assert_refused(r"exceeds 1e\+06 m", spawn("bad", BALL, at(1e9, 0.0, 0.0)))
        self.assert_refused("cannot be printed", spawn("new\nline", BALL))
        self.assert_refused("entity already exists", spawn("block_robot", BALL))
        crooked = at(0.0, 0.0, 1.0)
        crooked.orientation.w = math.inf
        self.assert_refused("not finite", spawn("bad", BALL, crooked))
        self.assertEqual(["ground_plane", "block_robot"], names())
        # What is wrong with a plugin is said, and the rest is there.
        for tag, told in (("Topic>odom", "Topic>no good name!"), ("Rate>20.0", "Rate>far")):
            spawn("odd", BLOCK.replace(f"<odometry{tag}<", f"<odometry{told}<"), at(0.0, 3.0, 0.0))
            call("/gazebo/delete_model", DeleteModel, "odd")
        self.assertIn("'no good name!' is not a valid topic name", bridge.err)
        self.assertIn("'far' is not a finite number", bridge.err)
        clock.wait(len(clock.messages) + 20)
        self.assertTrue(bridge.runs())
        self.assertNotIn("Traceback", bridge.err)
        x, y, _ = place_of("block_robot")
        self.assertGreater(x, 0.1)
        self.assert_near((0.0,), (y,), 1e-3)

    def test_what_a_model_is_made_of(self):
        self.start(robot=ROBOT)
        spawn("swing", PENDULUM)
        found = call("/gazebo/get_model_properties", GetModelProperties, "swing")
        self.assertEqual(("foot", ["foot", "rod"]), (found.canonical_body_name, found.body_names))
        self.assertEqual((["hinge"], False), (found.joint_names, found.is_static))
        floor = call("/gazebo/get_model_properties", GetModelProperties, "ground_plane")
        self.assertTrue(floor.is_static)
        rod = call("/gazebo/get_link_properties", GetLinkProperties, "swing::rod")
        self.assertEqual((1.0, 0.5, 0.0), (rod.mass, rod.izz, rod.ixy))


class TimeTest(GazeboCase):
    """Pause, speed, gravity."""

    def test_nothing_comes_while_paused_and_models_do(self):
        self.start(robot=ROBOT)
        clock, odom = self.topic("/clock", Clock), self.topic("odom", Odometry)
        # As spawn_model -wait and -unpause do it.
        states = self.topic("/gazebo/model_states", ModelStates)
        self.assertEqual(["ground_plane", "block_robot"], states.wait(1)[-1].name)
        self.assertTrue(spawn("ball", BALL).success)
        wait_for(lambda: "ball" in states.messages[-1].name, "the model on model_states")
        time.sleep(0.3)
        self.assertEqual(([], []), (clock.messages, odom.messages))
        call("/gazebo/unpause_physics", Empty)
        clock.wait(10)
        call("/gazebo/pause_physics", Empty)
        self.assertTrue(call("/gazebo/get_physics_properties", GetPhysicsProperties).pause)

    def test_gravity_and_speed_can_be_changed(self):
        self.start(paused=False, rtf=1)
        spawn("ball", BALL, at(0.0, 0.0, 1000.0))
        call("/gazebo/pause_physics", Empty)
        found = call("/gazebo/get_physics_properties", GetPhysicsProperties)
        self.assertEqual((0.001, 1000.0), (found.time_step, found.max_update_rate))
        moon = Vector3(0.0, 0.0, -1.6)
        set_physics = rospy.ServiceProxy("/gazebo/set_physics_properties", SetPhysicsProperties)
        self.assert_refused("0.002 s; only 0.001 s", set_physics(0.002, 500.0, moon, ODEPhysics()))
        self.assert_refused("max_update_rate", set_physics(0.001, -1.0, moon, ODEPhysics()))
        nan = Vector3(0.0, math.nan, 0.0)
        self.assert_refused("gravity is not finite", set_physics(0.001, 500.0, nan, ODEPhysics()))
        self.assertEqual(found, call("/gazebo/get_physics_properties", GetPhysicsProperties))
        self.assertTrue(set_physics(0.001, 0.0, moon, found.ode_config).success)
        before, fall = place_of("ball")[2], state_of("ball").twist.linear.z
        step(1000)
        self.assert_near((before + fall - 0.8,), (place_of("ball")[2],), 5e-3)
        # As fast as it goes now.
        clock = self.topic("/clock", Clock)
        call("/gazebo/unpause_physics", Empty)
        wait_for(lambda: clock.messages and clock.messages[-1].clock.to_sec() > 100, "100 s", 30)
        self.assertFalse(call("/bullet_lab/set_rtf", SetRtf, -1.0).success)
        self.assertTrue(call("/bullet_lab/set_rtf", SetRtf, 0.5).success)
        found = call("/gazebo/get_physics_properties", GetPhysicsProperties)
        self.assertEqual((500.0, -1.6), (found.max_update_rate, found.gravity.z))

    def test_reset_world_takes_spawned_models_back_too(self):
        self.start()
        spawn("ball", BALL, at(1.0, 0.0, 5.0))
        step(500)
        self.assertLess(place_of("ball")[2], 5.0)
        call("/gazebo/reset_world", Empty)
        self.assert_near((1.0, 0.0, 5.5), place_of("ball"))
        self.assertEqual(0.5, call("/gazebo/get_world_properties", GetWorldProperties).sim_time)
        call("/gazebo/reset_simulation", Empty)
        self.assertEqual(0.0, call("/gazebo/get_world_properties", GetWorldProperties).sim_time)


class StatesTest(GazeboCase):
    """Where things are, and putting them elsewhere."""

    def test_states_can_be_set_and_asked_for(self):
        self.start()
        spawn("ball", BALL)
        spawn("frame", BEACON, at(5.0, 0.0, 0.0, math.pi / 2))
        wanted = ModelState("ball", at(1.0, 0.0, 2.0), Twist(), "frame")
        wanted.pose.orientation = Quaternion(0.0, 0.0, 0.0, 0.0)
        wanted.twist.linear.x = 2.0
        self.assertTrue(call("/gazebo/set_model_state", SetModelState, wanted).success)
        found = state_of("ball")
        self.assert_near((5.0, 1.0, 2.0), place_of("ball"))
        self.assert_near((0.0, 2.0), (found.twist.linear.x, found.twist.linear.y))
        self.assertEqual("world", found.header.frame_id)
        inside = state_of("ball", "frame")
        self.assert_near((2.0, 0.0), (inside.twist.linear.x, inside.twist.linear.y))
        link = call("/gazebo/get_link_state", GetLinkState, "ball::link", "frame").link_state
        self.assert_near((1.0, 0.0, 2.0), (link.pose.position.x, link.pose.position.y, 2.0))
        for bad in ("nix", "nix::link"):
            answer = call("/gazebo/set_link_state", SetLinkState, LinkState(link_name=bad))
            self.assert_refused("does not exist", answer)
        moved = LinkState("ball::link", at(7.0, 7.0, 7.0), Twist(), "world")
        self.assertTrue(call("/gazebo/set_link_state", SetLinkState, moved).success)
        self.assert_near((7.0, 7.0, 7.0), place_of("ball"))

    def test_states_can_be_set_by_topic(self):
        bridge = self.start()
        spawn("ball", BALL)
        models = publisher("/gazebo/set_model_state", ModelState)
        links = publisher("/gazebo/set_link_state", LinkState)
        for sender in (models, links):
            self.addCleanup(sender.unregister)
        models.publish(ModelState("ball", at(1.0, 2.0, 3.0), Twist(), ""))
        wait_for(lambda: place_of("ball")[2] == 3.0, "the ball to move")
        links.publish(LinkState("ball::link", at(1.0, 2.0, 4.0), Twist(), ""))
        wait_for(lambda: place_of("ball")[2] == 4.0, "the ball to move")
        models.publish(ModelState("nix", START, Twist(), ""))
        wait_for(lambda: "/gazebo/set_model_state: refused: model [nix]" in bridge.err, "a warning")

    def test_messages_of_the_lock_step_are_awaited_on_gazebos_topics(self):
        self.start()
        spawn("ball", BALL)
        models = publisher("/gazebo/set_model_state", ModelState)
        self.addCleanup(models.unregister)
        end_of_time = rospy.Time(2**31 - 1)
        sent = (["/gazebo/set_model_state"], ["/pybullet_bridge"], [2])
        words = ("/bullet_lab/advance", Advance, rospy.get_name(), 0, end_of_time, *sent)
        waiting = threading.Thread(target=call, args=words, daemon=True)
        models.publish(ModelState("ball", at(0.0, 0.0, 3.0), Twist(), ""))
        waiting.start()
        time.sleep(0.5)
        self.assertTrue(waiting.is_alive())
        models.publish(ModelState("ball", at(0.0, 0.0, 4.0), Twist(), ""))
        waiting.join(60)
        self.assertEqual(4.0, place_of("ball")[2])

    def test_topics_follow_with_gazebos_types_at_their_rate(self):
        self.start(robot=ROBOT, states_rate=50)
        types = dict(rosgraph.Master("/test").getTopicTypes())
        self.assertEqual("gazebo_msgs/ModelStates", types["/gazebo/model_states"])
        states = self.topic("/gazebo/model_states", ModelStates)
        links = self.topic("/gazebo/link_states", LinkStates)
        states.wait(1), links.wait(1)
        spawn("ball", BALL, at(0.0, 0.0, 9.0))
        states.wait(2), links.wait(2)
        step(1000)
        last = states.wait(52)[-1]
        self.assertEqual(["ground_plane", "block_robot", "ball"], last.name)
        self.assert_near((-9.8,), (last.twist[2].linear.z,), 0.02)
        self.assertAlmostEqual(9.5 - 4.9, last.pose[2].position.z, 1)
        self.assertEqual("ball::link", links.wait(52)[-1].name[2])
        time.sleep(0.2)
        self.assertEqual((52, 52), (len(states.messages), len(links.messages)))

    def test_markers_follow_models(self):
        self.start()
        spawn("ball", BALL, at(0.0, 0.0, 9.0))
        world = self.topic("/bullet_lab/world", MarkerArray)
        self.assertEqual({"ground_plane", "ball"}, {m.ns for m in world.wait(1)[0].markers})
        call("/gazebo/set_model_state", SetModelState, ModelState("ball", at(3, 0, 9), Twist(), ""))
        (marker,) = world.wait(2)[1].markers
        self.assertEqual(("ball", 3.0), (marker.ns, marker.pose.position.x))
        time.sleep(0.2)
        step(500)
        fallen = wait_for(lambda: world.messages[2:], "the ball to fall")[0].markers[0]
        self.assertEqual("ball", fallen.ns)
        self.assertLess(fallen.pose.position.z, 9.0)
        call("/gazebo/delete_model", DeleteModel, "ball")
        gone = wait_for(
            lambda: [m for array in world.messages for m in array.markers if m.action], "DELETE"
        )
        self.assertEqual((Marker.DELETE, "ball", 0), (gone[0].action, gone[0].ns, gone[0].id))


class ForcesTest(GazeboCase):
    """Wrenches and efforts."""

    def test_wrenches_act_for_their_time(self):
        self.start()
        spawn("ball", BALL, at(0.0, 0.0, 50.0))
        apply = rospy.ServiceProxy("/gazebo/apply_body_wrench", ApplyBodyWrench)
        push = Wrench(Vector3(4.0, 0.0, 0.0), Vector3())
        none, now = rospy.Duration(0), rospy.Time(0)
        for name, frame in (("nix::link", ""), ("ball::link", "nix")):
            answer = apply(name, frame, Point(), push, now, none)
            self.assert_refused("ApplyBodyWrench: .*nix", answer)
        start, duration = rospy.Time(0, 100_000_000), rospy.Duration(0, 250_000_000)
        # In the world's axes, at the body, which is far from the world's origin.
        self.assertTrue(apply("ball::link", "world", Point(), push, start, duration).success)
        step(1000)
        self.assert_near((0.5,), (state_of("ball").twist.linear.x,), 1e-3)
        self.assert_near((0.0,), (state_of("ball").twist.angular.y,), 1e-3)
        # In its own frame and for ever, until it is cleared.
        own = Wrench(Vector3(0.0, 2.0, 0.0), Vector3())
        apply("ball::link", "ball::link", Point(), own, now, rospy.Duration(-1))
        step(500)
        call("/gazebo/clear_body_wrenches", BodyRequest, "ball::link")
        step(500)
        self.assert_near((0.5,), (state_of("ball").twist.linear.y,), 1e-3)

    def test_joints_can_be_turned(self):
        self.start()
        spawn("swing", PENDULUM, at(0.0, 0.0, 0.1))
        apply = rospy.ServiceProxy("/gazebo/apply_joint_effort", ApplyJointEffort)
        look = rospy.ServiceProxy("/gazebo/get_joint_properties", GetJointProperties)
        self.assert_refused("joint .nix. not found", look("nix"))
        refused = apply("nix", 1.0, rospy.Time(0), rospy.Duration(1))
        self.assert_refused("joint .nix. not found", refused)
        self.assertTrue(apply("hinge", 0.25, rospy.Time(0), rospy.Duration(-1)).success)
        step(1000)
        call("/gazebo/clear_joint_forces", JointRequest, "hinge")
        step(1000)
        found = look("hinge")
        self.assertEqual(GetJointProperties._response_class.CONTINUOUS, found.type)
        self.assert_near((0.5,), found.rate, 5e-3)
        configure = rospy.ServiceProxy("/gazebo/set_model_configuration", SetModelConfiguration)
        self.assertTrue(configure("swing", "", ["hinge"], [1.5]).success)
        self.assertEqual((1.5, 0.0), (look("hinge").position[0], look("hinge").rate[0]))
        self.assert_refused("different lengths", configure("swing", "", ["hinge"], []))


class PropertiesTest(GazeboCase):
    """What lights, joints and links are like, and how fast it goes."""

    def test_lights_come_change_and_go(self):
        self.start()
        look = rospy.ServiceProxy("/gazebo/get_light_properties", GetLightProperties)
        self.assert_refused("lamp.*not found", look("lamp"))
        self.assertTrue(spawn("lamp", LAMP).success)
        self.assert_refused("entity already exists", spawn("lamp", LAMP))
        self.assertEqual(["ground_plane"], names())
        found = look("lamp")
        self.assert_near((1.0, 0.5, 0.25, 1.0), rgba(found.diffuse))
        self.assert_near((0.5, 0.1, 0.02), fading(found))
        change = rospy.ServiceProxy("/gazebo/set_light_properties", SetLightProperties)
        told = SetLightPropertiesRequest(light_name="lamp", attenuation_linear=0.3)
        told.diffuse = ColorRGBA(0.0, 0.0, 1.0, 1.0)
        answer = change(told)
        self.assertEqual((True, ""), (answer.success, answer.status_message))
        self.assert_near((0.0, 0.0, 1.0, 1.0), rgba(look("lamp").diffuse))
        self.assert_near((0.0, 0.3, 0.0), fading(look("lamp")))
        told.diffuse.r = -1.0
        self.assert_refused("SetLightProperties: .*negative", change(told))
        gone = call("/gazebo/delete_light", DeleteLight, "lamp")
        self.assertEqual("DeleteLight: lamp successfully deleted", gone.status_message)
        self.assert_refused("lamp.*not found", call("/gazebo/delete_light", DeleteLight, "lamp"))

    def test_joints_and_links_can_be_changed(self):
        self.start()
        spawn("swing", PENDULUM, at(0.0, 0.0, 0.1))
        joint = rospy.ServiceProxy("/gazebo/set_joint_properties", SetJointProperties)
        self.assert_refused("joint .nix. not found", joint("nix", ODEJointProperties()))
        # ODE's motor turns it up to a stop.
        config = ODEJointProperties(hiStop=[0.5], loStop=[-0.5], vel=[2.0], fmax=[5.0], cfm=[0.1])
        answer = joint("hinge", config)
        self.assertTrue(answer.success, answer.status_message)
        self.assertIn("cfm do nothing", answer.status_message)
        step(1000)
        look = rospy.ServiceProxy("/gazebo/get_joint_properties", GetJointProperties)
        self.assert_near((0.5,), look("hinge").position, 0.02)
        self.assertEqual(GetJointProperties._response_class.REVOLUTE, look("hinge").type)
        joint("hinge", ODEJointProperties(damping=[0.7]))
        self.assertEqual([0.7], list(look("hinge").damping))
        change = rospy.ServiceProxy("/gazebo/set_link_properties", SetLinkProperties)
        told = SetLinkPropertiesRequest(link_name="swing::rod", gravity_mode=True, mass=3.0)
        told.ixx = told.iyy = told.izz = 1.5
        self.assertTrue(change(told).success)
        rod = call("/gazebo/get_link_properties", GetLinkProperties, "swing::rod")
        self.assertEqual((3.0, 1.5, True), (rod.mass, rod.izz, rod.gravity_mode))
        told.gravity_mode = False
        self.assertTrue(change(told).success)
        rod = call("/gazebo/get_link_properties", GetLinkProperties, "swing::rod")
        self.assertFalse(rod.gravity_mode)
        for field, value, said in (
            ("mass", -1.0, "must be positive"),
            ("link_name", "nix", "link .nix. does not exist"),
            ("link_name", "ground_plane::link", "never moves"),
        ):
            odd = copy.deepcopy(told)
            setattr(odd, field, value)
            self.assert_refused(f"SetLinkProperties: .*{said}", change(odd))
        told.com.position.x = 0.1
        self.assert_refused("centre of mass", change(told))

    def test_performance_is_told_while_it_runs(self):
        self.start(robot=ROBOT, paused=False, rtf=2)
        told = self.topic("/gazebo/performance_metrics", PerformanceMetrics)
        last = told.wait(3)[-1]
        self.assertAlmostEqual(2.0, last.real_time_factor, delta=0.5)
        (laser,) = last.sensors
        # The link that is left of those on fixed joints.
        self.assertEqual("default::block_robot::base_footprint::laser", laser.name)
        self.assertEqual((10.0, -1.0), (laser.sim_update_rate, laser.fps))

    def test_physics_can_be_reconfigured(self):
        self.start()
        try:
            client = importlib.import_module("dynamic_reconfigure.client").Client
        except ImportError:
            self.skipTest("dynamic_reconfigure is not installed")
        gazebo = client("/gazebo", timeout=30.0)
        self.assertEqual(-9.8, gazebo.get_configuration()["gravity_z"])
        gazebo.update_configuration({"gravity_z": -1.6})
        found = call("/gazebo/get_physics_properties", GetPhysicsProperties)
        self.assertEqual((-1.6, 0.0), (found.gravity.z, found.max_update_rate))


def rgba(colour):
    return colour.r, colour.g, colour.b, colour.a


def fading(light):
    keys = ("constant", "linear", "quadratic")
    return tuple(getattr(light, f"attenuation_{key}") for key in keys)


class SaveTest(GazeboCase):
    """The running world as a file."""

    def test_world_is_saved_while_it_runs(self):
        folder = self.folder()
        self.start(robot=ROBOT, paused=False, rtf=1, save_folder=folder)
        spawn("beacon_7", BEACON, at(3.0, 1.0, 0.0, 0.4))
        clock = self.topic("/clock", Clock)
        path = folder / "saved.world"
        path.write_text("what was there before")
        saved = call("/bullet_lab/save_world", SaveWorld, str(path), False)
        self.assertTrue(saved.success, saved.status_message)
        self.assertEqual((3, str(path)), (saved.models, saved.path))
        clock.wait(len(clock.messages) + 10)
        world = {model.name: model for model in read_world_file(path).models}
        self.assertEqual({"ground_plane", "block_robot", "beacon_7"}, set(world))
        self.assert_near((3.0, 1.0, 0.0), world["beacon_7"].pose.position)
        self.assertAlmostEqual(0.4, world["beacon_7"].pose.yaw, 9)
        self.assertEqual([path], list(path.parent.iterdir()))
        text = call("/bullet_lab/save_world", SaveWorld, "/nix/nix.world", True).text
        self.assertEqual(path.read_text().count("beacon_7"), text.count("beacon_7"))
        self.assert_no_other_file_is_written(folder)

    def assert_no_other_file_is_written(self, folder):
        elsewhere = self.folder()
        (folder / "way_out").symlink_to(elsewhere)
        (folder / "file_out").symlink_to(elsewhere / "new")
        bad = {
            "": "no file",
            "nix/nix.world": "no folder",
            str(folder): "is a folder",
            "/": "is not in",
            "../new": "is not in",
            f"{folder}/../new": "is not in",
            str(elsewhere / "new"): "is not in",
            "way_out/new": "is not in",
            "file_out": "is not in",
            5000 * "x": "too long",
            "~nobody/new": "no folder",
        }
        for name, said in bad.items():
            refused = call("/bullet_lab/save_world", SaveWorld, name, False)
            self.assert_refused(said, refused)
        self.assertEqual([], list(elsewhere.iterdir()))
        self.assertFalse((folder.parent / "new").exists())

    def test_a_bridge_on_a_saved_world_goes_on(self):
        path = self.folder() / "saved.world"
        first = self.start(robot=ROBOT, robot_pose="1 2 0 0 0 0.5")
        step(100)
        node = Node("save_world.py")
        self.addCleanup(node.end)
        self.assertEqual(1, node.wait())
        self.assertIn("usage: save_world.py FILE", node.err)
        done = subprocess.run(
            [sys.executable, str(PACKAGE / "scripts" / "save_world.py"), path.name],
            cwd=path.parent, timeout=60, capture_output=True, text=True, check=True,
        )  # fmt: skip
        self.assertIn(f"2 models at 0.1 s saved to {path}", done.stdout)
        first.end()
        self.start(world=path)
        odom = self.topic("odom", Odometry)
        step(50)
        position = odom.wait(1)[0].pose.pose.position
        self.assert_near((1.0, 2.0), (position.x, position.y), 1e-5)


class PopulateTest(GazeboCase):
    """populate.py and depopulate.py."""

    def run_node(self, script, **parameters):
        node = Node(script, **parameters)
        self.addCleanup(node.end)
        return node.wait(), node.err

    def test_beacons_are_placed_and_taken_away(self):
        self.start()
        self.assertEqual((0, ""), self.run_node("populate.py"))
        self.assertEqual(["ground_plane", "beacon_0", "beacon_1", "beacon_2"], names())
        self.assert_near((-5.0, 1.0, 0.0), place_of("beacon_2"))
        status, line = self.run_node("populate.py")
        self.assertEqual(1, status)
        self.assertIn("entity already exists", line)
        circle = {"prefix": "post", "pattern": "circle", "count": 4, "origin": "0 0 1"}
        self.assertEqual((0, ""), self.run_node("populate.py", **circle))
        self.assert_near((0.0, 3.0, 1.0), place_of("post_1"))
        self.assertEqual((0, ""), self.run_node("depopulate.py"))
        self.assertEqual(["ground_plane", *(f"post_{n}" for n in range(4))], names())
        status, line = self.run_node("populate.py", model="/nix.sdf")
        self.assertEqual((1, True), (status, "no such file" in line))
        self.assertEqual(2, self.run_node("populate.py", count=0)[0])


def setUpModule():
    rospy.init_node("gazebo_test")


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "gazebo_test", "__main__")
