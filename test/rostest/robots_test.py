#!/usr/bin/env python3
"""Robots in one world have topics and frames of their own, and touch each other."""

import json
import unittest

import rosnode
import rospkg
import rospy
import tf2_ros
import yaml
from actionlib import SimpleActionClient
from bridge_testing import Sender, at, call, spawn, twist
from bullet_lab.msg import DockAction, DockGoal, TouchedModels
from bullet_lab.srv import SetNoise
from lab_testing import PACKAGE, NodeTest, run_tests, wait_for
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rosgraph_msgs.msg import Log

from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.ros.node.lock_step import publishers_know_this_node

KNOWS_PREFIX = rospkg.RosPack().get_manifest("robot_state_publisher").version != "1.15.1"
WHY_SKIPPED = "Debian 11's robot_state_publisher has no tf_prefix: docs/platforms.md"
BLOCK = (PACKAGE / "urdf" / "block_robot.urdf").read_text()


class RobotsTest(NodeTest):
    """The robots left and right, each in a namespace with a tf_prefix."""

    def drive(self, robot, speed):
        commands = Sender(f"{robot}/cmd_vel")
        self.addCleanup(commands.close)
        self.addCleanup(commands.send, twist())
        commands.send(twist(speed))

    @unittest.skipUnless(KNOWS_PREFIX, WHY_SKIPPED)
    def test_no_topic_and_no_frame_is_shared(self):
        buffer = tf2_ros.Buffer()
        listener = tf2_ros.TransformListener(buffer)
        self.addCleanup(listener.unregister)
        leaves = ("left/laser_link", "right/camera_optical_frame", "right/left_wheel")
        for leaf in leaves:
            wait_for(lambda leaf=leaf: buffer.can_transform("world", leaf, rospy.Time(0)), leaf)
        frames = yaml.safe_load(buffer.all_frames_as_yaml())
        self.assertEqual({"left", "right"}, {name.split("/")[0] for name in frames})
        self.assertEqual("world", frames["left/odom"]["parent"])
        place = buffer.lookup_transform("world", "left/laser_link", rospy.Time(0))
        self.assertAlmostEqual(0.075, place.transform.translation.z, delta=0.002)
        shared = ("/odom", "/cmd_vel", "/scan", "/joint_states", "/noisy_odom")
        names = [name for name, _ in rospy.get_published_topics()]
        self.assertEqual(set(), set(shared) & set(names))

    def test_a_command_moves_one_robot(self):
        left, right = self.topic("left/odom", Odometry), self.topic("right/odom", Odometry)
        starts = [topic.wait(1)[-1].pose.pose.position for topic in (left, right)]
        self.drive("left", -0.5)
        wait_for(lambda: left.position().x < starts[0].x - 0.2, "left to move")
        moved = right.position()
        self.assertAlmostEqual(starts[1].x, moved.x, delta=0.002)

    def test_each_says_what_it_touches(self):
        touched = {
            robot: self.topic(f"/{robot}/bullet_lab/touched", TouchedModels)
            for robot in ("left", "right")
        }
        self.drive("left", 0.5)
        for robot, other in (("left", "right"), ("right", "left")):
            topic = touched[robot]
            wait_for(lambda topic=topic: topic.messages and topic.messages[-1].models, robot)
            self.assertEqual(
                (robot, [other]), (topic.messages[-1].robot, topic.messages[-1].models)
            )

    def test_nodes_run_in_a_namespace(self):
        out, space = self.new_folder(), {"__ns": "right"}
        noise = self.node("noisy_odom.py", remap=space)
        about, until = "{std: 0.1, job: squares}", "drive_squares/finished"
        plot = self.node("plot_noise.py", remap=space, out=out, until=until, about=about)
        pairs = out / "paths.csv"
        wait_for(lambda: pairs.is_file() and len(pairs.read_text().splitlines()) > 1, "a recording")
        noisy = self.topic("right/noisy_odom", Odometry).wait(1)[0]
        # Late, and so what is latched.
        paths = [
            self.topic(f"right/{path}", PathMessage).wait(1)[0]
            for path in ("odom_path", "noisy_odom_path")
        ]
        self.assertTrue(all(path.poses for path in paths))
        self.assertEqual({"right/odom"}, {one.header.frame_id for one in (noisy, *paths)})
        changed = call("/right/noisy_odom_node/set_noise", SetNoise, "report", 0.2, [])
        self.assertTrue(changed.success, changed.status_message)
        square = {"mode": "closed_loop", "side": 0.1, "sides": 1, "turn_speed": 2.0}
        drive = self.node("drive_squares.py", remap=space, **square)
        self.assert_ends_well(drive, plot)
        noise.signal()
        self.assert_ends_well(noise)
        files = {"odom.tum", "noisy_odom.tum", "paths.csv", "paths.png", "summary.json"}
        self.assertEqual(files, {path.name for path in out.iterdir()})
        summary = json.loads((out / "summary.json").read_text())
        said = {key: summary[key] for key in ("std", "job", "finished")}
        self.assertEqual({"std": 0.1, "job": "squares", "finished": True}, said)
        # Not in lock step: on a busy machine it drives on for a while.
        self.assertGreater(summary["path_length_m"], 0.08)

    @unittest.skipUnless(KNOWS_PREFIX, WHY_SKIPPED)
    def test_docking_finds_the_frames_with_the_prefix(self):
        client = SimpleActionClient("right/dock", DockAction)
        wait_for(lambda: client.wait_for_server(rospy.Duration(1)), "the action")
        client.send_goal(DockGoal(dock_id="dock", search=False))
        self.assertTrue(client.wait_for_result(rospy.Duration(60)))
        # The camera was found in the robot's frame, the dock's place in that of the odometry.
        self.assertEqual("the marker is not in sight", client.get_result().message)
        # Or each picture is drawn and looked at for it until all tests are over.
        rosnode.kill_nodes(["/right/dock"])

    def test_robots_that_share_a_frame_are_warned_about(self):
        log = self.topic("/rosout", Log)
        for number, name in enumerate(("one", "two")):
            self.addCleanup(call, "/gazebo/delete_model", srv.DeleteModel, name)
            place = at(0.0, 5.0 + number, 0.0)
            self.assertTrue(spawn(name, BLOCK, place, name).success)
        said = "the frame 'odom' belongs to 'one' and 'two': give each robot a tf_prefix"
        wait_for(lambda: any(said in message.msg for message in log.messages), said)

    def test_a_subscriber_knows_when_it_will_be_sent_to(self):
        self.topic("left/odom", Odometry).wait(1)
        self.assertTrue(publishers_know_this_node())


if __name__ == "__main__":
    run_tests()
