#!/usr/bin/env python3
"""The robot drives to goals in any frame, and stands still whatever goes wrong."""

import math

import rospy
from actionlib import SimpleActionClient
from actionlib_msgs.msg import GoalID, GoalStatus
from geometry_msgs.msg import PoseStamped, Twist
from lab_testing import (
    QUARTER_TURN,
    Node,
    NodeTest,
    Topic,
    odometry,
    publisher,
    run_tests,
    transform,
    wait_for,
)
from move_base_msgs.msg import (
    MoveBaseAction,
    MoveBaseActionGoal,
    MoveBaseActionResult,
    MoveBaseGoal,
)
from nav_msgs.msg import Path
from standin import RobotStandIn
from std_msgs.msg import Float64, Time
from visualization_msgs.msg import MarkerArray

from bullet_lab.ros.messages.poses import stamped_pose

TOLERANCE = 0.05
FAR = 50.0
ENDS = (GoalStatus.SUCCEEDED, GoalStatus.ABORTED, GoalStatus.PREEMPTED)


def goal(x, y, yaw=0.0, frame="odom"):
    return stamped_pose(rospy.Time.now(), frame, (x, y, yaw))


class Drive:
    """A robot, a node that drives it and whoever gives goals and hears how they stand.

    Args:
        does: what the robot does, see `RobotStandIn`.
        parameters: private ones of the node.
    """

    def __init__(self, does=("odom", "move"), **parameters):
        ends = [("move_base/result", MoveBaseActionResult)]
        self.robot = RobotStandIn(odom=parameters.get("odom", "odom"), ends=ends)
        self.robot.does = set(does)
        self.robot.start()
        self.commands = Topic("cmd_vel", Twist, connected=False)
        self.node = Node("drive_to_goal.py", **parameters)
        self.statuses = Topic("drive_to_goal/status", GoalStatus)
        self.goals = publisher("move_base_simple/goal", PoseStamped)
        self.cancels = publisher("move_base/cancel", GoalID)
        wait_for(self.commands.is_connected, "commands")

    def end(self):
        """End the node and the robot."""
        self.node.end()
        self.robot.end()
        for topic in (self.commands, self.statuses):
            topic.close()
        for sender in (self.goals, self.cancels):
            sender.unregister()


class GoalTest(NodeTest):
    """What the tests of one drive or another share."""

    def take(self, drive):
        """Use a drive, from its statuses so far on."""
        self.drive, self.robot, self.driver = drive, drive.robot, drive.node
        self.goals = drive.goals
        self._heard = len(drive.statuses.messages)

    def statuses(self, *kinds):
        """The statuses in this test, of some kinds or all."""
        heard = self.drive.statuses.messages[self._heard :]
        return [m for m in heard if m.status in (kinds or range(10))]

    def wait_for_status(self, status, number=1):
        wait_for(
            lambda: len(self.statuses(status)) >= number or not self.driver.runs(),
            lambda: f"status {status}, have {self.statuses()}",
        )
        self.assertTrue(self.driver.runs(), self.driver.err)
        return self.statuses(status)[number - 1]

    def drive_to(self, message):
        """Give a goal and wait until the robot drives to it."""
        number = len(self.statuses(GoalStatus.ACTIVE))
        self.goals.publish(message)
        active = self.wait_for_status(GoalStatus.ACTIVE, number + 1)
        self.wait_until_driving()
        return active

    def drive_far(self):
        """Drive to a goal that is not reached before long."""
        self.drive_to(goal(FAR, 0.0))

    def wait_until_driving(self):
        wait_for(lambda: self.velocity()[0] > 0.1, "the robot to drive")

    def velocity(self):
        if not self.drive.commands.messages:
            return (0.0, 0.0)
        last = self.drive.commands.messages[-1]
        return last.linear.x, last.angular.z

    def assert_at(self, x, y, yaw=None):
        self.robot.assert_stands()
        self.assertLess(math.dist((x, y), self.robot.pose[:2]), TOLERANCE + 0.03)
        if yaw is not None:
            self.assertLess(abs(math.remainder(yaw - self.robot.pose[2], math.tau)), 0.2)

    def client(self):
        client = SimpleActionClient("move_base", MoveBaseAction)
        self.addCleanup(client.stop_tracking_goal)
        ends = client.action_client
        topics = (ends.pub_goal, ends.pub_cancel, ends.result_sub, ends.status_sub)
        wait_for(lambda: all(one.get_num_connections() for one in topics), "the action server")
        return client

    def assert_ends(self, client, status, words):
        wait_for(lambda: client.get_state() not in (GoalStatus.PENDING, GoalStatus.ACTIVE), "it")
        self.assertEqual(status, client.get_state(), client.get_goal_status_text())
        self.assertIn(words, client.get_goal_status_text())
        self.assertNotIn("Traceback", self.driver.err)


class DriveToGoalTest(GoalTest):
    """All tests share a node with a long patience, and a robot."""

    @classmethod
    def setUpClass(cls):
        cls.shared = Drive(patience=20.0)

    @classmethod
    def tearDownClass(cls):
        cls.shared.end()

    def setUp(self):
        self.take(self.shared)
        with self.robot.lock:
            self.robot.pose = (0.0, 0.0, 0.0)
        self.robot.does = {"odom", "move"}
        self.robot.says = odometry
        # The next goal shall not find the pose that the robot had before.
        self.robot.wait(0.5)

    def tearDown(self):
        if self.under_way():
            self.shared.cancels.publish(GoalID())
        wait_for(lambda: not self.under_way(), "the end of all goals")

    def under_way(self):
        """The goals that have begun and not ended."""
        begun = {m.goal_id.id for m in self.statuses(GoalStatus.ACTIVE)}
        return begun - {m.goal_id.id for m in self.statuses(*ENDS)}

    def test_drives_to_a_goal_and_tells_everything(self):
        remaining = self.topic("drive_to_goal/remaining", Float64)
        markers = self.topic("drive_to_goal/markers", MarkerArray)
        path = self.topic("drive_to_goal/path", Path)
        current = self.topic("drive_to_goal/current_goal", PoseStamped)
        finished = self.topic("drive_to_goal/finished", Time)
        before = len(finished.messages)
        self.goals.publish(goal(1.0, 0.5, -2.0))
        done = self.wait_for_status(GoalStatus.SUCCEEDED)
        self.assertIn("from the goal", done.text)
        self.assert_at(1.0, 0.5, -2.0)
        message = finished.wait(before + 1)[-1]
        self.assertEqual("1", message._connection_header["latching"])
        self.assertEqual("1", done._connection_header["latching"])
        self.assertEqual(1.0, current.messages[-1].pose.position.x)
        left = [message.data for message in remaining.messages]
        self.assertAlmostEqual(math.hypot(1.0, 0.5), left[0], delta=0.1)
        self.assertLess(left[-1], TOLERANCE)
        labels = [m.text for array in markers.messages for m in array.markers if m.text]
        self.assertTrue([label for label in labels if "1.1" in label])
        self.assertEqual("odom", markers.messages[-1].markers[0].header.frame_id)
        self.assertGreater(len(path.messages[-1].poses), 10)
        self.assertEqual(
            [GoalStatus.PENDING, GoalStatus.ACTIVE, GoalStatus.SUCCEEDED],
            [m.status for m in self.statuses()],
        )

    def test_goals_in_other_frames(self):
        # The odometry's origin is at (2, 1) on the map, turned by 90 degrees.
        self.broadcast(transform("map", "odom", (2.0, 1.0, 0.0), QUARTER_TURN))
        self.goals.publish(goal(2.0, 1.6, math.pi / 2, "/map"))
        self.wait_for_status(GoalStatus.SUCCEEDED)
        self.assert_at(0.6, 0.0, 0.0)

    def test_what_cannot_be_driven_to_is_refused_and_the_old_goal_goes_on(self):
        self.drive_far()
        bad = {
            "no frame_id": goal(1.0, 0.0, frame=""),
            "no transform from 'mars' to 'odom'": goal(1.0, 0.0, frame="mars"),
            "not finite": goal(math.nan, 0.0),
        }
        for number, (why, message) in enumerate(bad.items(), 1):
            self.goals.publish(message)
            self.assertIn(why, self.wait_for_status(GoalStatus.REJECTED, number).text)
        self.assertEqual([], self.statuses(*ENDS))
        # On a busy machine the robot may stand for a moment: its odometry came late.
        self.wait_until_driving()
        self.assertEqual([], self.statuses(*ENDS))
        self.assertIn("move_base_simple/goal: refused:", self.driver.err)
        self.assertNotIn("Traceback", self.driver.err)

    def test_cancelling(self):
        self.drive_far()
        # Not about this goal.
        self.drive.cancels.publish(GoalID(id="another"))
        self.robot.wait(0.5)
        self.assertEqual([], self.statuses(GoalStatus.PREEMPTED))
        self.drive.cancels.publish(GoalID())
        self.assertIn("request", self.wait_for_status(GoalStatus.PREEMPTED).text)
        self.robot.assert_stands()
        client = self.client()
        client.send_goal(MoveBaseGoal(goal(FAR, 0.0)))
        self.wait_until_driving()
        # By its id.
        client.cancel_goal()
        self.assert_ends(client, GoalStatus.PREEMPTED, "request")
        self.robot.assert_stands()
        self.assertNotIn("uninitialized", self.driver.err)

    def test_goals_of_clients_and_of_rviz_take_each_others_places(self):
        first, second = self.client(), self.client()
        first.send_goal(MoveBaseGoal(goal(FAR, 0.0)))
        self.wait_until_driving()
        self.goals.publish(goal(0.0, FAR))
        self.assert_ends(first, GoalStatus.PREEMPTED, "another goal")
        # Before it has begun, it would be recalled instead.
        self.wait_for_status(GoalStatus.ACTIVE, 2)
        second.send_goal(MoveBaseGoal(goal(0.3, 0.0)))
        self.assert_ends(second, GoalStatus.SUCCEEDED, "from the goal")
        self.assert_at(0.3, 0.0)
        self.assertEqual(2, len(self.statuses(GoalStatus.PREEMPTED)))

    def test_a_client_whose_goal_cannot_be_reached_is_told_why(self):
        client = self.client()
        client.send_goal(MoveBaseGoal(goal(1.0, 0.0, frame="mars")))
        why = "no transform from 'mars' to 'odom'"
        self.assert_ends(client, GoalStatus.ABORTED, why)
        self.assertIn(why, self.wait_for_status(GoalStatus.REJECTED).text)
        # The robot stands still as well if it was on its way to another goal.
        self.drive_far()
        client.send_goal(MoveBaseGoal(goal(1.0, 0.0, frame="mars")))
        wait_for(lambda: self.velocity() == (0.0, 0.0), "a stop")
        client.cancel_goal()
        self.assert_ends(client, GoalStatus.PREEMPTED, "request")
        self.wait_for_status(GoalStatus.RECALLED)
        self.robot.assert_stands()

    def test_the_goal_that_comes_last_counts_whatever_its_stamp(self):
        goals = self.publisher("move_base/goal", MoveBaseActionGoal)
        self.drive_far()
        late = MoveBaseActionGoal(goal=MoveBaseGoal(goal(0.2, 0.0)))
        late.goal_id.id, late.goal_id.stamp = "late", rospy.Time(1)
        goals.publish(late)
        self.assertEqual("late", self.wait_for_status(GoalStatus.SUCCEEDED).goal_id.id)

    def test_odometry_that_pauses_stops_the_robot_for_a_while(self):
        self.drive_to(goal(1.0, 0.0))
        self.robot.does.discard("odom")
        self.robot.assert_stands()
        wait_for(lambda: "odom: the robot is stopped" in self.driver.err, "a warning")
        self.robot.does.add("odom")
        self.wait_for_status(GoalStatus.SUCCEEDED)
        self.assert_at(1.0, 0.0)

    def test_bad_odometry_is_refused_and_the_end_of_the_goal(self):
        self.drive_far()
        self.robot.says = lambda seconds, *_: odometry(seconds, math.nan)
        lost = self.wait_for_status(GoalStatus.ABORTED)
        self.assertEqual("no odometry on odom for 20 s", lost.text)
        self.assertIn("odom: refused: a pose that is not finite", self.driver.err)
        self.robot.assert_stands()

    # Last, as the node ends.
    def test_z_ctrl_c_stops_the_robot(self):
        self.drive_far()
        self.driver.signal()
        self.assert_ends_well(self.driver)
        self.robot.assert_stands()
        # It says nothing of the goal's end.
        self.take(self.shared)


class NoisyOdometryTest(GoalTest):
    """A node with odometry of another name, and goals without a heading."""

    def test_odometry_of_nobody_and_then_a_goal_without_heading(self):
        drive = Drive(does=(), odom="noisy_odom", heading=False)
        self.addCleanup(drive.end)
        self.take(drive)
        self.goals.publish(goal(1.0, 0.0))
        why = "no odometry on noisy_odom: no messages"
        self.assertEqual(f"refused: {why}", self.wait_for_status(GoalStatus.REJECTED).text)
        client = self.client()
        client.send_goal(MoveBaseGoal(goal(1.0, 0.0)))
        self.assert_ends(client, GoalStatus.ABORTED, why)
        self.robot.does = {"odom", "move"}
        self.robot.wait(0.5)
        self.goals.publish(goal(0.6, 0.0, 3.0))
        self.wait_for_status(GoalStatus.SUCCEEDED)
        self.assert_at(0.6, 0.0, 0.0)


if __name__ == "__main__":
    run_tests()
