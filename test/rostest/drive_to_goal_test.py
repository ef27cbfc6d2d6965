#!/usr/bin/env python3
"""The robot drives to goals in any frame, and stands still whatever goes wrong."""

import math
import signal
import sys
import time
import unittest

import rospy
import rostest
import tf2_ros
from actionlib import SimpleActionClient
from actionlib_msgs.msg import GoalID, GoalStatus
from geometry_msgs.msg import PoseStamped, TransformStamped, Twist
from lab_testing import Node, Topic, odometry, publisher, wait_for
from move_base_msgs.msg import MoveBaseAction, MoveBaseActionGoal, MoveBaseGoal
from nav_msgs.msg import Odometry, Path
from std_msgs.msg import Float64, Time
from std_srvs.srv import Empty
from visualization_msgs.msg import MarkerArray

from bullet_lab.core.se2 import quaternion_from_yaw
from bullet_lab.ros.node.odometry import planar_pose

PERIOD = 0.02
TOLERANCE = 0.05


class FakeRobot:
    """Follows the commands, and publishes its pose 50 times a second of wall time."""

    def __init__(self, topic="odom"):
        self.pose = (0.0, 0.0, 0.0)
        self.speaks = True
        self.says = odometry
        self._command = (0.0, 0.0)
        self._last = rospy.get_time()
        self._publisher = rospy.Publisher(topic, Odometry, queue_size=10, tcp_nodelay=True)
        self._subscriber = rospy.Subscriber("cmd_vel", Twist, self._take)
        self._timer = rospy.Timer(rospy.Duration(PERIOD), self._move)

    def end(self):
        self._timer.shutdown()
        self._timer.join()
        self._publisher.unregister()
        self._subscriber.unregister()

    def _take(self, message):
        self._command = (message.linear.x, message.angular.z)

    def _move(self, _event):
        now = rospy.get_time()
        seconds, self._last = now - self._last, now
        (x, y, yaw), (v, w) = self.pose, self._command
        middle = yaw + 0.5 * seconds * w
        self.pose = (
            x + seconds * v * math.cos(middle),
            y + seconds * v * math.sin(middle),
            yaw + seconds * w,
        )
        if self.speaks:
            self._publisher.publish(self.says(now, *self.pose))


def goal(x, y, yaw=0.0, frame="odom"):
    message = PoseStamped()
    message.header.stamp = rospy.Time.now()
    message.header.frame_id = frame
    message.pose.position.x, message.pose.position.y = x, y
    turn = message.pose.orientation
    turn.x, turn.y, turn.z, turn.w = quaternion_from_yaw(yaw)
    return message


def transform(parent, child, x, y, yaw):
    message = TransformStamped()
    message.header.frame_id, message.child_frame_id = parent, child
    message.transform.translation.x, message.transform.translation.y = x, y
    turn = message.transform.rotation
    turn.x, turn.y, turn.z, turn.w = quaternion_from_yaw(yaw)
    return message


class DriveToGoalTest(unittest.TestCase):
    """Each test has a node of its own; faster than the defaults, so that it is soon there."""

    def start(self, robot_topic="odom", **parameters):
        self.robot = FakeRobot(robot_topic)
        self.addCleanup(self.robot.end)
        self.commands = self.topic("cmd_vel", Twist, False)
        fast = {"speed": 1.0, "turn_speed": 3.0, "acceleration": 4.0, "turn_acceleration": 20.0}
        gains = {"gain": 4.0, "turn_gain": 6.0, "rate": 50.0, "yaw_tolerance": 0.1}
        self.node = Node("drive_to_goal.py", **{**fast, **gains, **parameters})
        self.addCleanup(self.node.end)
        self.statuses = self.topic("drive_to_goal/status", GoalStatus)
        self.goals = publisher("move_base_simple/goal", PoseStamped)
        self.addCleanup(self.goals.unregister)
        self.cancels = publisher("move_base/cancel", GoalID)
        self.addCleanup(self.cancels.unregister)
        wait_for(self.commands.is_connected, "commands")

    def topic(self, name, kind, connected=True):
        topic = Topic(name, kind, connected)
        self.addCleanup(topic.close)
        return topic

    def wait_for_status(self, status, number=1):
        def found():
            return [m for m in self.statuses.messages if m.status == status][number - 1 :]

        wait_for(lambda: found() or not self.node.runs(), f"status {status}")
        self.assertTrue(self.node.runs(), self.node.err)
        return found()[0]

    def wait_until_driving(self):
        wait_for(lambda: self.velocity()[0] > 0.1, "the robot to drive")

    def velocity(self):
        if not self.commands.messages:
            return (0.0, 0.0)
        return self.commands.messages[-1].linear.x, self.commands.messages[-1].angular.z

    def assert_stands(self):
        wait_for(lambda: self.velocity() == (0.0, 0.0), "a stop")
        place = self.robot.pose
        time.sleep(0.3)
        self.assertEqual((0.0, 0.0), self.velocity())
        self.assertLess(math.dist(place, self.robot.pose), 0.06)

    def assert_at(self, x, y, yaw=None):
        self.assertLess(math.dist((x, y), self.robot.pose[:2]), TOLERANCE + 0.03)
        if yaw is not None:
            self.assertLess(abs(math.remainder(yaw - self.robot.pose[2], math.tau)), 0.2)

    def test_drives_to_a_goal_and_tells_everything(self):
        self.start()
        remaining = self.topic("drive_to_goal/remaining", Float64)
        markers = self.topic("drive_to_goal/markers", MarkerArray)
        path = self.topic("drive_to_goal/path", Path)
        current = self.topic("drive_to_goal/current_goal", PoseStamped)
        finished = self.topic("drive_to_goal/finished", Time)
        self.goals.publish(goal(1.0, 0.5, -2.0))
        done = self.wait_for_status(GoalStatus.SUCCEEDED)
        self.assertIn("from the goal", done.text)
        self.assert_stands()
        self.assert_at(1.0, 0.5, -2.0)
        (message,) = finished.wait(1)
        self.assertEqual("1", message._connection_header["latching"])
        self.assertEqual("1", done._connection_header["latching"])
        self.assertEqual(1.0, current.wait(1)[0].pose.position.x)
        left = [message.data for message in remaining.messages]
        self.assertAlmostEqual(math.hypot(1.0, 0.5), left[0], delta=0.1)
        self.assertLess(left[-1], TOLERANCE)
        labels = [m.text for array in markers.messages for m in array.markers if m.text]
        self.assertIn("1.1", labels[0])
        self.assertEqual("odom", markers.messages[-1].markers[0].header.frame_id)
        self.assertGreater(len(path.messages[-1].poses), 10)
        self.assertEqual(
            [GoalStatus.PENDING, GoalStatus.ACTIVE, GoalStatus.SUCCEEDED],
            [m.status for m in self.statuses.messages],
        )

    def test_goals_in_other_frames(self):
        self.start()
        broadcaster = tf2_ros.StaticTransformBroadcaster()
        self.addCleanup(broadcaster.pub_tf.unregister)
        # The odometry's origin is at (2, 1) on the map, turned by 90 degrees.
        broadcaster.sendTransform(transform("map", "odom", 2.0, 1.0, math.pi / 2))
        self.goals.publish(goal(2.0, 1.6, math.pi / 2, "/map"))
        self.wait_for_status(GoalStatus.SUCCEEDED)
        self.assert_at(0.6, 0.0, 0.0)

    def test_what_cannot_be_driven_to_is_refused_and_the_old_goal_goes_on(self):
        self.start()
        self.goals.publish(goal(1.5, 0.0))
        self.wait_until_driving()
        bad = {
            "no frame_id": goal(1.0, 0.0, frame=""),
            "no transform from 'mars' to 'odom'": goal(1.0, 0.0, frame="mars"),
            "not finite": goal(math.nan, 0.0),
            "no unit quaternion": goal(1.0, 0.0),
        }
        bad["no unit quaternion"].pose.orientation.w = 0.0
        for number, (why, message) in enumerate(bad.items(), 1):
            self.goals.publish(message)
            self.assertIn(why, self.wait_for_status(GoalStatus.REJECTED, number).text)
        self.wait_for_status(GoalStatus.SUCCEEDED)
        self.assert_at(1.5, 0.0)
        self.assertIn("move_base_simple/goal: refused:", self.node.err)
        self.assertNotIn("Traceback", self.node.err)

    def test_a_new_goal_replaces_the_old(self):
        self.start()
        self.goals.publish(goal(50.0, 0.0))
        self.wait_until_driving()
        self.goals.publish(goal(0.0, 0.5, 1.0))
        self.wait_for_status(GoalStatus.SUCCEEDED)
        self.assert_at(0.0, 0.5, 1.0)
        given_up = self.wait_for_status(GoalStatus.PREEMPTED)
        self.assertIn("another goal", given_up.text)

    def test_cancelling(self):
        self.start()
        for number, by_id in enumerate((False, True), 1):
            self.goals.publish(goal(50.0, 0.0))
            active = self.wait_for_status(GoalStatus.ACTIVE, number)
            self.wait_until_driving()
            # Not about this goal.
            self.cancels.publish(GoalID(id="another"))
            time.sleep(0.2)
            self.assertGreater(self.velocity()[0], 0.1)
            self.cancels.publish(GoalID(id=active.goal_id.id) if by_id else GoalID())
            self.assertIn("request", self.wait_for_status(GoalStatus.PREEMPTED, number).text)
            self.assert_stands()
        self.assertNotIn("uninitialized", self.node.err)

    def client(self):
        client = SimpleActionClient("move_base", MoveBaseAction)
        self.addCleanup(client.stop_tracking_goal)
        self.assertTrue(client.wait_for_server(rospy.Duration(20)), self.node.err)
        return client

    def assert_ends(self, client, status, words):
        self.assertTrue(client.wait_for_result(rospy.Duration(30)), self.node.err)
        self.assertEqual(status, client.get_state(), client.get_goal_status_text())
        self.assertIn(words, client.get_goal_status_text())
        self.assertNotIn("Traceback", self.node.err)

    def test_a_client_of_move_base_drives_the_robot(self):
        self.start()
        client, feedback = self.client(), []
        client.send_goal(MoveBaseGoal(goal(1.0, 0.5, 1.0)), feedback_cb=feedback.append)
        self.assert_ends(client, GoalStatus.SUCCEEDED, "from the goal")
        self.assert_at(1.0, 0.5, 1.0)
        self.assert_stands()
        base = feedback[-1].base_position
        self.assertEqual("odom", base.header.frame_id)
        self.assertLess(math.dist((1.0, 0.5), (base.pose.position.x, base.pose.position.y)), 0.05)
        self.wait_for_status(GoalStatus.SUCCEEDED)
        said = [message.status for message in self.statuses.messages]
        self.assertEqual([GoalStatus.PENDING, GoalStatus.ACTIVE, GoalStatus.SUCCEEDED], said)

    def test_a_client_of_move_base_cancels(self):
        self.start()
        client = self.client()
        client.send_goal(MoveBaseGoal(goal(50.0, 0.0)))
        self.wait_until_driving()
        client.cancel_goal()
        self.assert_ends(client, GoalStatus.PREEMPTED, "request")
        self.assert_stands()

    def test_goals_of_clients_and_of_rviz_take_each_others_places(self):
        self.start()
        first, second = self.client(), self.client()
        first.send_goal(MoveBaseGoal(goal(50.0, 0.0)))
        self.wait_until_driving()
        self.goals.publish(goal(0.0, 50.0))
        self.assert_ends(first, GoalStatus.PREEMPTED, "another goal")
        # Before it has begun, it would be recalled instead.
        self.wait_for_status(GoalStatus.ACTIVE, 2)
        second.send_goal(MoveBaseGoal(goal(0.3, 0.0)))
        self.assert_ends(second, GoalStatus.SUCCEEDED, "from the goal")
        self.assert_at(0.3, 0.0)
        self.assertEqual(2, len([m for m in self.statuses.messages if m.status == 2]))

    def test_a_client_whose_goal_cannot_be_reached_is_told_why(self):
        self.start()
        client = self.client()
        bad = {
            "no frame_id": goal(1.0, 0.0, frame=""),
            "not finite": goal(math.nan, 0.0),
            "no transform from 'mars' to 'odom'": goal(1.0, 0.0, frame="mars"),
        }
        for number, (why, message) in enumerate(bad.items(), 1):
            client.send_goal(MoveBaseGoal(message))
            self.assert_ends(client, GoalStatus.ABORTED, why)
            self.assertIn(why, self.wait_for_status(GoalStatus.REJECTED, number).text)
        self.assert_stands()
        # The robot stands still as well if it was on its way to another goal.
        self.goals.publish(goal(50.0, 0.0))
        self.wait_until_driving()
        client.send_goal(MoveBaseGoal(goal(1.0, 0.0, frame="mars")))
        self.assert_stands()
        self.assertEqual(GoalStatus.ACTIVE, client.get_state())
        client.cancel_goal()
        self.assert_ends(client, GoalStatus.PREEMPTED, "request")
        self.wait_for_status(GoalStatus.RECALLED)

    def test_a_client_without_odometry(self):
        self.start(odom="nowhere")
        client = self.client()
        client.send_goal(MoveBaseGoal(goal(1.0, 0.0)))
        self.assert_ends(client, GoalStatus.ABORTED, "no odometry on nowhere: no messages")

    def test_the_goal_that_comes_last_counts_whatever_its_stamp(self):
        self.start()
        goals = publisher("move_base/goal", MoveBaseActionGoal)
        self.addCleanup(goals.unregister)
        self.goals.publish(goal(50.0, 0.0))
        self.wait_until_driving()
        late = MoveBaseActionGoal(goal=MoveBaseGoal(goal(0.2, 0.0)))
        late.goal_id.id, late.goal_id.stamp = "late", rospy.Time(1)
        goals.publish(late)
        self.assertEqual("late", self.wait_for_status(GoalStatus.SUCCEEDED).goal_id.id)

    def test_without_heading_it_stays_as_it_came(self):
        self.start(heading=False)
        self.goals.publish(goal(0.6, 0.0, 3.0))
        self.wait_for_status(GoalStatus.SUCCEEDED)
        self.assert_at(0.6, 0.0, 0.0)

    def test_odometry_that_pauses_stops_the_robot_for_a_while(self):
        self.start()
        self.goals.publish(goal(1.5, 0.0))
        self.wait_until_driving()
        self.robot.speaks = False
        wait_for(lambda: "the robot is stopped" in self.node.err, "a warning")
        self.assert_stands()
        self.robot.speaks = True
        self.wait_for_status(GoalStatus.SUCCEEDED)
        self.assert_at(1.5, 0.0)

    def test_odometry_that_ends_is_the_end_of_the_goal(self):
        self.start(patience=1.0)
        self.goals.publish(goal(50.0, 0.0))
        self.wait_until_driving()
        self.robot.speaks = False
        lost = self.wait_for_status(GoalStatus.ABORTED)
        self.assertEqual("no odometry on odom for 1 s", lost.text)
        self.assert_stands()

    def test_odometry_of_nobody(self):
        self.start(odom="nowhere")
        self.goals.publish(goal(1.0, 0.0))
        why = self.wait_for_status(GoalStatus.REJECTED).text
        self.assertEqual("refused: no odometry on nowhere: no messages", why)

    def test_bad_odometry_is_refused(self):
        self.start()

        def nonsense(seconds, *_pose):
            return odometry(seconds, math.nan)

        self.goals.publish(goal(50.0, 0.0))
        self.wait_until_driving()
        self.robot.says = nonsense
        wait_for(lambda: "the robot is stopped" in self.node.err, "a warning")
        self.assertIn("odom: refused: a pose that is not finite", self.node.err)
        self.assert_stands()

    def test_noisy_odometry(self):
        self.start(robot_topic="noisy_odom", odom="noisy_odom")
        self.goals.publish(goal(0.5, 0.0))
        self.wait_for_status(GoalStatus.SUCCEEDED)
        self.assert_at(0.5, 0.0, 0.0)

    def test_signals_stop_the_robot(self):
        for number in (signal.SIGINT, signal.SIGTERM):
            self.start()
            self.goals.publish(goal(50.0, 0.0))
            self.wait_until_driving()
            self.node.signal(number)
            self.assertEqual(0, self.node.wait(), self.node.err)
            self.assert_stands()
            self.assertNotIn("Traceback", self.node.err)
            self.doCleanups()

    def test_bad_parameters(self):
        for name, value in (("tolerance", 0.001), ("speed", 0), ("patients", 1)):
            node = Node("drive_to_goal.py", **{name: value})
            self.addCleanup(node.end)
            self.assertEqual(2, node.wait(), node.err)
            self.assertEqual(1, len(node.err.splitlines()), node.err)

    def test_the_block_robot_in_lock_step(self):
        self.check_in_lock_step("block_robot")

    def test_the_camera_robot_in_lock_step(self):
        self.check_in_lock_step("camera_robot")

    def check_in_lock_step(self, robot):
        bridge = Node(
            "pybullet_bridge.py",
            robot=f"package://bullet_lab/urdf/{robot}.urdf",
            rtf=0,
            paused=True,
            publish_world_tf=True,
            lock_step="drive_to_goal",
        )
        self.addCleanup(bridge.end)
        odom = self.topic("odom", Odometry, False)
        wait_for(lambda: odom.is_connected() or not bridge.runs(), "the bridge")
        self.assertTrue(bridge.runs(), bridge.err)
        node = Node("drive_to_goal.py", lock_step=True)
        self.addCleanup(node.end)
        statuses = self.topic("drive_to_goal/status", GoalStatus)
        goals = publisher("move_base_simple/goal", PoseStamped)
        self.addCleanup(goals.unregister)
        rospy.ServiceProxy("/gazebo/unpause_physics", Empty)()
        odom.wait(1)
        goals.publish(goal(0.4, 0.3, 1.0, "world"))
        wait_for(lambda: len(statuses.messages) > 2, "the end of the drive")
        self.assertEqual(GoalStatus.SUCCEEDED, statuses.messages[-1].status, node.err)
        odom.wait(len(odom.messages) + 20)
        x, y, yaw = planar_pose(odom.messages[-1])
        self.assertLess(math.dist((0.4, 0.3), (x, y)), TOLERANCE)
        self.assertAlmostEqual(1.0, yaw, delta=0.06)


if __name__ == "__main__":
    rospy.init_node("drive_to_goal_test")
    rostest.rosrun("bullet_lab", "drive_to_goal_test", DriveToGoalTest, sys.argv)
