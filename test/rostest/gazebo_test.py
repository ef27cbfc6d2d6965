#!/usr/bin/env python3
"""Clients in the manner of Gazebo's find its services, topics and habits; beacons come and go."""

import math
import tempfile
import threading
from pathlib import Path

import numpy as np
import rosgraph
import rospy
from bridge_testing import (
    ROBOT,
    BridgeCase,
    advance,
    at,
    call,
    names,
    place_of,
    spawn,
    step,
)
from bullet_lab.srv import SaveWorld
from gazebo_msgs.msg import ModelState, PerformanceMetrics
from gazebo_msgs.srv import DeleteModel, SetModelState
from geometry_msgs.msg import Point, PointStamped, Twist
from lab_testing import (
    PACKAGE,
    PATIENCE,
    QUARTER_TURN,
    advertised,
    run_tests,
    transform,
    wait_for,
)
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan, Range
from std_msgs.msg import String
from std_srvs.srv import Empty
from visualization_msgs.msg import Marker, MarkerArray

from bullet_lab.core.pose import Pose as PlacedAt
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.sdf import read_world_file
from bullet_lab.simulation.world.urdf import read_urdf

BLOCK = (PACKAGE / "urdf" / "block_robot.urdf").read_text()
BEACONS = "package://bullet_lab/worlds/beacons.world"
BEACON = '<sdf version="1.6"><include><uri>model://beacon</uri></include></sdf>'

BALL = """<sdf version="1.6"><model name="ball"><pose>0 0 0.5 0 0 0</pose><link name="link">
  <inertial><mass>2</mass><inertia><ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz></inertia></inertial>
  <collision name="skin"><geometry><sphere><radius>0.1</radius></sphere></geometry></collision>
  <visual name="look"><geometry><sphere><radius>0.1</radius></sphere></geometry></visual>
</link></model></sdf>"""


def click(x, y, frame="world"):
    """A point that was clicked; its height does not matter."""
    message = PointStamped(point=Point(x, y, 0.4))
    message.header.stamp, message.header.frame_id = rospy.Time.now(), frame
    return message


class GazeboCase(BridgeCase):
    """What tests of one bridge or the other share."""

    def assert_near(self, expected, found, tolerance=1e-6):
        self.assertLess(math.dist(expected, found), tolerance, f"{found}, expected {expected}")


class GazeboTest(GazeboCase):
    """The services and topics, on the block robot's world."""

    files = tempfile.TemporaryDirectory()
    folder_to_save_in = Path(files.name) / "saved"
    parameters = {"robot": ROBOT, "states_rate": 50, "save_folder": folder_to_save_in}

    # Models come and go

    def test_robot_in_a_namespace_falls_silent(self):
        spawn("second", BLOCK, at(0.0, 3.0, 0.0), "left", service="spawn_urdf_model")
        first, second = self.topic("odom", Odometry), self.topic("left/odom", Odometry)
        step(1000)
        second.wait(19)
        self.assertTrue(call("/gazebo/delete_model", DeleteModel, "second").success)
        published = dict(rosgraph.Master("/test").getPublishedTopics(""))
        self.assertNotIn("/left/odom", published)
        step(1000)
        first.wait(39)
        self.assertEqual(19, len(second.messages))

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
        self.assertIn("/gazebo/set_model_state: refused: model [nix]", self.bridge.err)

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

    # What lights, joints and links are like, and how fast it goes

    def test_performance_is_told_while_it_runs(self):
        told = self.topic("/gazebo/performance_metrics", PerformanceMetrics)
        call("/gazebo/unpause_physics", Empty)
        last = told.wait(3)[-1]
        self.assertGreater(last.real_time_factor, 0.0)
        (laser,) = last.sensors
        # The link that is left of those on fixed joints.
        self.assertEqual("default::block_robot::base_footprint::laser", laser.name)
        self.assertEqual((10.0, -1.0), (laser.sim_update_rate, laser.fps))

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
        refused = call("/bullet_lab/save_world", SaveWorld, "../new", False)
        self.assertIn("is not in", refused.status_message)
        self.assertFalse(refused.success)
        self.assertEqual([path], list(path.parent.iterdir()))
        text = call("/bullet_lab/save_world", SaveWorld, "/nix/nix.world", True).text
        self.assertEqual(path.read_text().count("beacon_7"), text.count("beacon_7"))

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
        node = self.node(script)
        return node.wait(), node.err


class WorldTest(GazeboCase):
    """The report's beacons, and a robot of the parameter server in a namespace."""

    pose = (1.0, 2.0, 0.0), (0.0, 0.0, math.pi / 2)
    parameters = {
        "robot_namespace": "left",
        "robot_pose": f"1 2 0 0 0 {math.pi / 2}",
        "world": BEACONS,
        "clock_rate": 30,
        "seed": 1,
        "publish_world_tf": True,
    }

    def setUp(self):
        rospy.set_param("robot_description", BLOCK)
        self.addCleanup(rospy.delete_param, "robot_description")
        super().setUp()

    def test_robot_pose(self):
        odom = self.topic("left/odom", Odometry)
        step(51)
        pose = odom.wait(1)[0].pose.pose
        found = (pose.position.x, pose.position.y, pose.orientation.z)
        self.assert_near((1.0, 2.0, math.sqrt(0.5)), found)

    def test_the_noise_is_that_of_the_seed(self):
        scans = self.topic("left/scan", LaserScan)
        step(200)
        first, second = scans.wait(2)
        self.assertEqual(("laser_link", 360), (first.header.frame_id, len(first.ranges)))
        self.assertGreater(sum(map(math.isfinite, first.ranges)), 3)
        self.assertNotEqual(first.ranges, second.ranges)
        self.assertEqual(first.ranges, self.simulated(1))
        self.assertNotEqual(first.ranges, self.simulated(2))

    def simulated(self, seed):
        """The robot's first scan without ROS."""
        scans = []
        with Simulation.of(BEACONS, seed) as simulation:
            pose = PlacedAt.from_rpy(*self.pose)
            robot = simulation.add(read_urdf(BLOCK, "robot"), pose=pose)
            robot.listen("scan", scans.append)
            simulation.run_until(100)
        return tuple(np.float32(scans[0].ranges).tolist())

    # place_beacon.py

    def start_placing(self):
        self.placer = self.node("place_beacon.py")
        self.placed = self.topic("place_beacon/placed", String)
        self.clicks = self.publisher("/clicked_point", PointStamped)

    def place(self, *point):
        """Click, and return the name of the beacon that was placed."""
        number = len(self.placed.messages) + 1
        self.clicks.publish(click(*point))
        return self.placed.wait(number)[-1].data

    def refuse(self, why, *point):
        """Click until the warning comes: one a second is written."""

        def is_refused():
            self.clicks.publish(click(*point))
            rospy.rostime.wallsleep(0.1)
            return why in self.placer.err

        wait_for(is_refused, f"'{why}' in the warnings")

    def test_a_beacon_for_each_click(self):
        self.start_placing()
        self.assertEqual("beacon_3", self.place(2.0, 3.0))
        self.assertEqual("beacon_4", self.place(-2.0, 3.0))
        call("/gazebo/delete_model", DeleteModel, "beacon_3")
        # In another frame, with the first free name.
        self.broadcast(transform("world", "map", (1.0, 0.0, 0.0), QUARTER_TURN))
        self.assertEqual("beacon_3", self.place(3.0, 0.5, "map"))
        self.assert_near((0.5, 3.0, 0.0), place_of("beacon_3"))
        self.assert_near((-2.0, 3.0, 0.0), place_of("beacon_4"))
        before = names()
        for why, point in {
            "too near to beacon_0": (1.45, 1.0),
            "too near to block_robot": (1.3, 2.3),
            "too near to beacon_4": (-2.0, 3.1),
            "the point is not finite": (math.nan, 0.0),
            "no frame_id": (3.0, 3.0, ""),
            "no transform from 'mars' to 'world'": (3.0, 3.0, "mars"),
        }.items():
            self.refuse(why, *point)
        self.assertEqual(before, names())
        self.assertNotIn("Traceback", self.placer.err)

    def test_a_robot_is_tracked_from_beacons_that_come_and_go(self):
        self.start_placing()
        self.node("track_robot.py", watch=True, remap={"odom": "left/odom"})
        known = self.topic("beacon_2", String)
        labels = self.topic("beacon_markers", MarkerArray)
        self.assertEqual("beacon_3", self.place(4.0, -2.0))
        ranges, line = self.topic("beacon_3/range", Range), self.topic("beacon_3", String)
        step(200)
        self.assertIn("position: x:-5 y:1,", known.wait(1)[0].data)
        self.assertAlmostEqual(5.0, ranges.wait(2)[-1].range, 2)
        said = "source: beacon_3, position: x:4.0 y:-2.0,"
        self.assertTrue(line.wait(1)[0].data.startswith(said))
        call("/gazebo/delete_model", DeleteModel, "beacon_3")
        wait_for(lambda: not advertised("/beacon_3/range"), "the beacon's topic to go")
        # The configured ones stay, whatever becomes of them.
        call("/gazebo/delete_model", DeleteModel, "beacon_2")
        self.addCleanup(spawn, "beacon_2", BEACON, at(-5.0, 1.0, 0.0))
        count, drawn = len(known.messages), len(labels.messages)
        step(600)
        known.wait(count + 10)
        texts = [m.text for m in labels.wait(drawn + 2)[-1].markers if m.text]
        self.assertEqual(3, len(texts))


if __name__ == "__main__":
    run_tests()
