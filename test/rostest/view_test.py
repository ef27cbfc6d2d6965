#!/usr/bin/env python3
"""The page shows things where they are, a user can drive, and without a page nothing is heard."""

import time

import numpy as np
import rosgraph
import rospy
from geometry_msgs.msg import PoseStamped, Twist
from lab_testing import PACKAGE, Node, NodeTest, Process, Topic, run_tests, wait_for
from nav_msgs.msg import Odometry
from view_looker import Looker, wait_for_url
from visualization_msgs.msg import Marker

WORLD = "package://bullet_lab/worlds/sensors.world"
ROBOT = PACKAGE / "urdf" / "sensor_robot.urdf"
CENTIMETRE = 0.01


def heard():
    """Return the topics that the view subscribes to."""
    _, subscribers, _ = rosgraph.Master("/test").getSystemState()
    return {topic for topic, nodes in subscribers if "/view" in nodes}


class ViewTest(NodeTest):
    @classmethod
    def setUpClass(cls):
        rospy.set_param("/robot_description", ROBOT.read_text())
        cls.bridge = Node("pybullet_bridge.py", world=WORLD, publish_world_tf=True, paused=True)
        cls.states = Process("rosrun", "robot_state_publisher", "robot_state_publisher")
        cls.shared = Node("view.py", port=18080, unpause=True)
        cls.url = wait_for_url(lambda: cls.shared.out)
        cls.commands = Topic("cmd_vel", Twist, connected=False)
        cls.odom = Topic("odom", Odometry)

    @classmethod
    def tearDownClass(cls):
        for node in (cls.states, cls.shared, cls.bridge):
            node.end()

    def setUp(self):
        self.looker = Looker(self.url)

    def tearDown(self):
        self.looker.close()

    def see(self, name):
        """Wait until copies are in a node, and return where."""
        return wait_for(lambda: self.looker.positions(name).tolist(), name)

    def test_a_robot_that_is_driven_is_seen_where_odometry_says(self):
        before = np.array(self.see("/robots/0"))
        with self.looker.driver() as driver:

            def is_driven():
                driver.send("1 0")
                time.sleep(0.1)
                return np.linalg.norm(self.see("/robots/0") - before) > 0.3

            wait_for(is_driven, "the robot to be driven")
            self.assertGreater(self.commands.messages[-1].linear.x, 0.0)
        wait_for(lambda: self.commands.messages[-1] == Twist(), "the robot to be stopped")
        wait_for(self.is_still, "the robot to stand")
        self.odom.wait(len(self.odom.messages) + 10)
        place = self.odom.position()
        # The page shows the newest pose when all is still.
        wait_for(lambda: self.is_seen_at(place), lambda: f"{self.see('/robots/0')} at {place}")

    def is_seen_at(self, place):
        seen = self.see("/robots/0")[0]
        return np.hypot(seen[0] - place.x, seen[1] - place.y) < CENTIMETRE

    def is_still(self):
        return abs(self.odom.messages[-1].twist.twist.linear.x) < 1e-3

    def test_a_click_on_the_floor_is_a_goal(self):
        goals = self.topic("move_base_simple/goal", PoseStamped, False)
        self.see("/robots/0")

        def clicked():
            self.looker.click(1.5, -0.5)
            time.sleep(0.2)
            return goals.messages

        goal = wait_for(clicked, "a goal")[0]
        self.assertEqual(goal.header.frame_id, "world")
        self.assertAlmostEqual(goal.pose.position.x, 1.5)
        self.assertAlmostEqual(goal.pose.position.y, -0.5)

    def test_what_sensors_feel_is_seen(self):
        points = wait_for(lambda: self.looker.nodes.get("/topics/scan"), "the laser")["points"]
        self.assertTrue(np.isfinite(points).all())
        wait_for(lambda: "/topics/sonar" in self.looker.nodes, "the sonar")
        self.assertTrue(len(self.see("/topics/bullet_lab/world/solids/box")))

    def test_bad_messages_are_ignored(self):
        sender = self.publisher("/strange", Marker)
        good = Marker(type=Marker.CUBE, ns="good")
        good.header.frame_id, good.color.a = "world", 1.0
        good.scale.x = good.scale.y = good.scale.z = 0.3
        bad = Marker(type=Marker.CUBE)
        bad.pose.position.x = float("nan")
        for marker in (bad, Marker(type=77), good):
            sender.publish(marker)
        self.see("/topics/strange/solids/box")

    def test_nothing_is_heard_while_nobody_looks(self):
        self.see("/robots/0")
        self.assertIn("/tf", heard())
        self.looker.close()
        wait_for(lambda: not heard(), lambda: str(heard()))
        self.looker = Looker(self.url)
        self.see("/robots/0")


if __name__ == "__main__":
    run_tests()
