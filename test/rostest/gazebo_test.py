#!/usr/bin/env python3
"""Clients in the manner of Gazebo's find its services and topics, types and habits."""

import math
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import rosgraph
import rospy
import rostest
from bridge_testing import ROBOT, BridgeCase, advance, call, spawn, step, twist, world
from bullet_lab.srv import SaveWorld, SetRtf
from gazebo_msgs.msg import (
    LinkStates,
    ModelState,
    ModelStates,
    ODEJointProperties,
    ODEPhysics,
    PerformanceMetrics,
)
from gazebo_msgs.srv import (
    DeleteLight,
    DeleteModel,
    GetJointProperties,
    GetModelState,
    GetPhysicsProperties,
    SetJointProperties,
    SetLightProperties,
    SetLightPropertiesRequest,
    SetLinkProperties,
    SetLinkPropertiesRequest,
    SetModelState,
    SetPhysicsProperties,
)
from geometry_msgs.msg import Point, Pose, Quaternion, Twist, Vector3
from lab_testing import PACKAGE, PATIENCE, Node, wait_for
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from std_msgs.msg import ColorRGBA
from std_srvs.srv import Empty
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.simulation.world.sdf import read_world_file

BLOCK = (PACKAGE / "urdf" / "block_robot.urdf").read_text()
BEACON = '<sdf version="1.6"><include><uri>model://beacon</uri></include></sdf>'

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


def at(x, y, z, yaw=0.0):
    """A pose."""
    return Pose(Point(x, y, z), Quaternion(0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)))


def state_of(name, frame=""):
    """A model's state."""
    return call("/gazebo/get_model_state", GetModelState, name, frame)


def place_of(name, frame=""):
    """Where a model is."""
    position = state_of(name, frame).pose.position
    return position.x, position.y, position.z


def names():
    """All models."""
    return world().model_names


class GazeboTest(BridgeCase):
    """The services and topics, on the block robot's world."""

    files = tempfile.TemporaryDirectory()
    folder_to_save_in = Path(files.name) / "saved"
    parameters = {"robot": ROBOT, "states_rate": 50, "save_folder": folder_to_save_in}

    def assert_near(self, expected, found, tolerance=1e-6):
        self.assertLess(math.dist(expected, found), tolerance, f"{found}, expected {expected}")

    def assert_refused(self, said, answer):
        self.assertFalse(answer.success)
        self.assertRegex(answer.status_message, said)

    # Models come and go

    def test_robot_in_a_namespace_speaks_and_falls_silent(self):
        rospy.set_param("/left/tf_prefix", "second")
        self.addCleanup(rospy.delete_param, "/left/tf_prefix")
        answer = spawn("second", BLOCK, at(0.0, 3.0, 0.0), "left", service="spawn_urdf_model")
        self.assertTrue(answer.success, answer)
        first, second = self.topic("odom", Odometry), self.topic("left/odom", Odometry)
        self.sender("left/cmd_vel").send(twist(vx=0.5))
        step(1000)
        self.assertGreater(second.wait(19)[-1].pose.pose.position.x, 0.4)
        self.assertEqual("second/odom", second.messages[-1].header.frame_id)
        self.assert_near((0.0,), (first.wait(19)[-1].pose.pose.position.x,), 1e-3)
        self.assertTrue(call("/gazebo/delete_model", DeleteModel, "second").success)
        published = dict(rosgraph.Master("/test").getPublishedTopics(""))
        self.assertNotIn("/left/odom", published)
        step(1000)
        first.wait(39)
        self.assertEqual(19, len(second.messages))

    def test_bad_models_are_refused_while_a_robot_drives_on(self):
        self.sender().send(twist(vx=0.5))
        call("/gazebo/unpause_physics", Empty)
        bad = {
            "not well-formed": "<sdf",
            "neither <sdf> nor <robot>": "<html/>",
            "in none of the model folders": BEACON.replace("beacon", "nix"),
            "a <link> without a name": PENDULUM.replace('<link name="rod">', "<link>"),
        }
        for said, xml in bad.items():
            self.assert_refused(f"SpawnModel: Failure - .*{said}", spawn("bad", xml))
        nowhere = spawn("bad", BALL, at(math.nan, 0.0, 0.0))
        self.assert_refused("position is not finite", nowhere)
        self.assert_refused(r"exceeds 1e\+06 m", spawn("bad", BALL, at(1e9, 0.0, 0.0)))
        self.assert_refused("cannot be printed", spawn("new\nline", BALL))
        self.assert_refused("entity already exists", spawn("block_robot", BALL))
        self.assertEqual(["ground_plane", "block_robot"], names())
        # What is wrong with a plugin is said, and the rest is there.
        for tag, told in (("Topic>odom", "Topic>no good name!"), ("Rate>20.0", "Rate>far")):
            spawn("odd", BLOCK.replace(f"<odometry{tag}<", f"<odometry{told}<"), at(0.0, 3.0, 0.0))
            call("/gazebo/delete_model", DeleteModel, "odd")
        self.assertIn("'no good name!' is not a valid topic name", self.node.err)
        self.assertIn("'far' is not a finite number", self.node.err)
        self.assertNotIn("Traceback", self.node.err)
        x, y, _ = place_of("block_robot")
        self.assert_near((0.0,), (y,), 1e-3)
        wait_for(lambda: place_of("block_robot")[0] > x + 0.1, "the robot to drive on")

    # Gravity and speed

    def test_gravity_and_speed_can_be_changed(self):
        spawn("ball", BALL, at(0.0, 0.0, 1000.0))
        found = call("/gazebo/get_physics_properties", GetPhysicsProperties)
        self.assertEqual((0.001, 0.0), (found.time_step, found.max_update_rate))
        moon = Vector3(0.0, 0.0, -1.6)
        set_physics = rospy.ServiceProxy("/gazebo/set_physics_properties", SetPhysicsProperties)
        self.assert_refused("0.002 s; only 0.001 s", set_physics(0.002, 500.0, moon, ODEPhysics()))
        self.assert_refused("max_update_rate", set_physics(0.001, -1.0, moon, ODEPhysics()))
        nan = Vector3(0.0, math.nan, 0.0)
        self.assert_refused("gravity is not finite", set_physics(0.001, 500.0, nan, ODEPhysics()))
        self.assertEqual(found, call("/gazebo/get_physics_properties", GetPhysicsProperties))
        self.assertFalse(call("/bullet_lab/set_rtf", SetRtf, -1.0).success)
        self.assertTrue(call("/bullet_lab/set_rtf", SetRtf, 0.5).success)
        changed = call("/gazebo/get_physics_properties", GetPhysicsProperties)
        self.assertEqual(500.0, changed.max_update_rate)

    # Where things are, and putting them elsewhere

    def test_messages_of_the_lock_step_are_awaited_on_gazebos_topics(self):
        spawn("ball", BALL)
        models = self.sender("/gazebo/set_model_state", ModelState)
        found = []

        def wait_for_both():
            advance(sent=models.sent(2))
            found.append(place_of("ball")[2])

        waiting = threading.Thread(target=wait_for_both, daemon=True)
        waiting.start()
        for height in (3.0, 4.0):
            models.publish(ModelState("ball", at(0.0, 0.0, height), Twist(), ""))
            wait_for(lambda height=height: place_of("ball")[2] == height, "the ball to move")
        waiting.join(PATIENCE)
        self.assertEqual([4.0], found)
        models.send(ModelState(model_name="nix"))
        self.assertIn("/gazebo/set_model_state: refused: model [nix]", self.node.err)

    def test_topics_follow_with_gazebos_types_at_their_rate(self):
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
        call("/gazebo/delete_model", DeleteModel, "ball")
        for topic in (states, links):
            self.assertEqual(2, len(topic.wait(53)[52].name))

    def test_markers_follow_models(self):
        spawn("ball", BALL, at(0.0, 0.0, 9.0))
        markers = self.topic("/bullet_lab/world", MarkerArray)
        self.assertEqual({"ground_plane", "ball"}, {m.ns for m in markers.wait(1)[0].markers})
        call("/gazebo/set_model_state", SetModelState, ModelState("ball", at(3, 0, 9), Twist(), ""))
        (marker,) = markers.wait(2)[1].markers
        self.assertEqual(("ball", 3.0), (marker.ns, marker.pose.position.x))
        # No more than ten times a second of the wall clock.
        arrays = wait_for(lambda: step(100) and markers.messages[2:], "the ball to fall")
        fallen = arrays[0].markers[0]
        self.assertEqual("ball", fallen.ns)
        self.assertLess(fallen.pose.position.z, 9.0)
        call("/gazebo/delete_model", DeleteModel, "ball")
        gone = wait_for(
            lambda: [m for array in markers.messages for m in array.markers if m.action], "DELETE"
        )
        self.assertEqual((Marker.DELETE, "ball", 0), (gone[0].action, gone[0].ns, gone[0].id))

    # Wrenches and efforts

    # What lights, joints and links are like, and how fast it goes

    def test_a_light_has_a_name_and_sound_colours(self):
        self.assertTrue(spawn("lamp", LAMP).success)
        self.addCleanup(call, "/gazebo/delete_light", DeleteLight, "lamp")
        self.assert_refused("entity already exists", spawn("lamp", LAMP))
        self.assertEqual(self.models, names())
        told = SetLightPropertiesRequest(light_name="lamp", diffuse=ColorRGBA(-1.0, 0.0, 1.0, 1.0))
        refused = call("/gazebo/set_light_properties", SetLightProperties, told)
        self.assert_refused("SetLightProperties: .*negative", refused)

    def test_joints_and_links_can_be_changed(self):
        spawn("swing", PENDULUM, at(5.0, 0.0, 0.1))
        # ODE's motor turns it up to a stop.
        config = ODEJointProperties(hiStop=[0.5], loStop=[-0.5], vel=[2.0], fmax=[5.0], cfm=[0.1])
        answer = call("/gazebo/set_joint_properties", SetJointProperties, "hinge", config)
        self.assertTrue(answer.success, answer.status_message)
        self.assertIn("cfm do nothing", answer.status_message)
        step(1000)
        look = rospy.ServiceProxy("/gazebo/get_joint_properties", GetJointProperties)
        self.assert_near((0.5,), look("hinge").position, 0.02)
        self.assertEqual(GetJointProperties._response_class.REVOLUTE, look("hinge").type)
        for link, mass, said in (
            ("swing::rod", -1.0, "must be positive"),
            ("ground_plane::link", 3.0, "never moves"),
        ):
            told = SetLinkPropertiesRequest(link_name=link, mass=mass, ixx=1.0, iyy=1.0, izz=1.0)
            refused = call("/gazebo/set_link_properties", SetLinkProperties, told)
            self.assert_refused(f"SetLinkProperties: .*{said}", refused)

    def test_performance_is_told_while_it_runs(self):
        told = self.topic("/gazebo/performance_metrics", PerformanceMetrics)
        call("/gazebo/unpause_physics", Empty)
        last = told.wait(3)[-1]
        self.assertGreater(last.real_time_factor, 0.0)
        (laser,) = last.sensors
        # The link that is left of those on fixed joints.
        self.assertEqual("default::block_robot::base_footprint::laser", laser.name)
        self.assertEqual((10.0, -1.0), (laser.sim_update_rate, laser.fps))

    def test_physics_can_be_reconfigured(self):
        gazebo = self.reconfigured("/gazebo")
        self.assertEqual(-9.8, gazebo.get_configuration()["gravity_z"])
        self.addCleanup(gazebo.update_configuration, {"gravity_z": -9.8})
        gazebo.update_configuration({"gravity_z": -1.6})
        found = call("/gazebo/get_physics_properties", GetPhysicsProperties)
        self.assertEqual((-1.6, 0.0), (found.gravity.z, found.max_update_rate))


    # The running world as a file

    def test_world_is_saved_while_it_runs(self):
        folder = self.folder_to_save_in
        folder.mkdir(exist_ok=True)
        call("/gazebo/unpause_physics", Empty)
        spawn("beacon_7", BEACON, at(3.0, 1.0, 0.0, 0.4))
        clock = self.topic("/clock", Clock)
        path = folder / "saved.world"
        path.write_text("what was there before")
        saved = call("/bullet_lab/save_world", SaveWorld, str(path), False)
        self.assertTrue(saved.success, saved.status_message)
        self.assertEqual((3, str(path)), (saved.models, saved.path))
        clock.wait(len(clock.messages) + 10)
        models = {model.name: model for model in read_world_file(path).models}
        self.assertEqual({"ground_plane", "block_robot", "beacon_7"}, set(models))
        self.assert_near((3.0, 1.0, 0.0), models["beacon_7"].pose.position)
        self.assertAlmostEqual(0.4, models["beacon_7"].pose.yaw, 9)
        self.assertEqual([path], list(path.parent.iterdir()))
        text = call("/bullet_lab/save_world", SaveWorld, "/nix/nix.world", True).text
        self.assertEqual(path.read_text().count("beacon_7"), text.count("beacon_7"))

    def test_no_file_is_written_outside_the_folder(self):
        folder, elsewhere = self.folder_to_save_in, self.folder()
        folder.mkdir(exist_ok=True)
        for link, target in (("way_out", elsewhere), ("file_out", elsewhere / "new")):
            (folder / link).symlink_to(target)
            self.addCleanup((folder / link).unlink)
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
        self.assertEqual([folder], list(folder.parent.iterdir()))

    # populate.py and depopulate.py

    def test_beacons_are_placed_and_taken_away(self):
        self.assertEqual((0, ""), self.run_node("populate.py"))
        self.assertEqual([*self.models, "beacon_0", "beacon_1", "beacon_2"], names())
        self.assert_near((-5.0, 1.0, 0.0), place_of("beacon_2"))
        status, line = self.run_node("populate.py")
        self.assertEqual(1, status)
        self.assertIn("entity already exists", line)
        self.assertEqual((0, ""), self.run_node("depopulate.py"))
        self.assertEqual(self.models, names())

    def run_node(self, script):
        node = Node(script)
        self.addCleanup(node.end)
        return node.wait(), node.err


class SavedWorldTest(BridgeCase):
    """A bridge that is started with what another has saved."""

    parameters = {"robot": ROBOT, "robot_pose": "1 2 0 0 0 0.5"}

    def test_a_bridge_on_a_saved_world_goes_on(self):
        path = self.folder() / "saved.world"
        step(100)
        node = Node("save_world.py")
        self.addCleanup(node.end)
        self.assertEqual(1, node.wait())
        self.assertIn("usage: save_world.py FILE", node.err)
        done = subprocess.run(
            [sys.executable, str(PACKAGE / "scripts" / "save_world.py"), path.name],
            cwd=path.parent, timeout=PATIENCE, capture_output=True, text=True, check=True,
        )  # fmt: skip
        self.assertIn(f"2 models at 0.1 s saved to {path}", done.stdout)
        self.start(world=path)
        odom = self.topic("odom", Odometry)
        step(51)
        position = odom.wait(1)[0].pose.pose.position
        self.assertAlmostEqual(1.0, position.x, 5)
        self.assertAlmostEqual(2.0, position.y, 5)


def setUpModule():
    rospy.init_node("gazebo_test")


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "gazebo_test", "__main__")
