#!/usr/bin/env python3
"""A click in RViz places a beacon where there is room, and track_robot measures it."""

import math
import sys

import rospy
import rostest
import tf2_ros
from geometry_msgs.msg import Point, PointStamped
from lab_testing import (
    QUARTER_TURN,
    Node,
    NodeTest,
    Topic,
    advertised,
    publisher,
    transform,
    wait_for,
)
from sensor_msgs.msg import Range
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from bullet_lab.ros.messages.gazebo_types import srv

BLOCK_ROBOT = "package://bullet_lab/urdf/block_robot.urdf"


def click(x, y, frame="world", z=0.0):
    message = PointStamped()
    message.header.stamp, message.header.frame_id = rospy.Time.now(), frame
    message.point = Point(x, y, z)
    return message


def world():
    """The models by name."""
    properties = rospy.ServiceProxy("/gazebo/get_world_properties", srv.GetWorldProperties)
    return set(properties().model_names)


def place_of(model):
    state = rospy.ServiceProxy("/gazebo/get_model_state", srv.GetModelState)(model, "")
    return state.pose.position.x, state.pose.position.y


def delete(model):
    rospy.ServiceProxy("/gazebo/delete_model", srv.DeleteModel)(model)


class PlaceBeaconTest(NodeTest):
    """The report's three beacons stand there already, and the block robot at the origin."""

    @classmethod
    def setUpClass(cls):
        cls.bridge = Node(
            "pybullet_bridge.py",
            world="package://bullet_lab/worlds/beacons.world",
            robot=BLOCK_ROBOT,
            publish_world_tf=True,
        )
        cls.shared = Node("place_beacon.py")
        cls.placed = Topic("place_beacon/placed", String)
        cls.clicks = publisher("/clicked_point", PointStamped)
        cls.before = world()

    @classmethod
    def tearDownClass(cls):
        cls.shared.end()
        cls.bridge.end()

    def tearDown(self):
        for model in world() - self.before:
            delete(model)

    def place(self, message):
        """Click, and return the name of the beacon that was placed."""
        number = len(self.placed.messages) + 1
        self.clicks.publish(message)
        return self.placed.wait(number)[-1].data

    def refuse(self, message, why):
        """Click until the warning comes: one a second is written."""

        def is_refused():
            self.clicks.publish(message)
            rospy.rostime.wallsleep(0.1)
            return why in self.shared.err

        wait_for(is_refused, f"'{why}' in the warnings")

    def test_a_beacon_for_each_click_with_the_first_free_name(self):
        self.assertEqual("beacon_3", self.place(click(2.0, 3.0, z=0.4)))
        self.assertEqual((2.0, 3.0), place_of("beacon_3"))
        delete("beacon_1")
        self.assertEqual("beacon_1", self.place(click(-2.0, 3.0)))
        self.assertEqual((-2.0, 3.0), place_of("beacon_1"))

    def test_points_in_other_frames(self):
        broadcaster = tf2_ros.StaticTransformBroadcaster()
        self.addCleanup(broadcaster.pub_tf.unregister)
        broadcaster.sendTransform(transform("world", "map", (1.0, 0.0, 0.0), QUARTER_TURN))
        name = self.place(click(3.0, 0.5, "map"))
        for wanted, value in zip((0.5, 3.0), place_of(name)):
            self.assertAlmostEqual(wanted, value, 9)

    def test_what_is_refused(self):
        for why, message in {
            "too near to beacon_0": click(1.45, 1.0),
            "too near to block_robot": click(0.3, 0.3),
            "the point is not finite": click(math.nan, 0.0),
            "no frame_id": click(3.0, 3.0, ""),
            "no transform from 'mars' to 'world'": click(3.0, 3.0, "mars"),
        }.items():
            self.refuse(message, why)
        self.assertEqual(self.before, world())
        self.assertEqual("beacon_3", self.place(click(1.6, 1.0)))
        # The new one takes up room as well.
        self.refuse(click(1.7, 1.0), "too near to beacon_3")
        self.assertNotIn("Traceback", self.shared.err)

    def test_the_robot_is_tracked_from_beacons_that_come_and_go(self):
        self.node("track_robot.py", watch=True)
        known = self.topic("beacon_2", String)
        labels = self.topic("beacon_markers", MarkerArray)
        self.assertIn("position: x:-5 y:1,", known.wait(1)[0].data)
        self.assertEqual("beacon_3", self.place(click(3.0, -4.0)))
        ranges, line = self.topic("beacon_3/range", Range), self.topic("beacon_3", String)
        self.assertAlmostEqual(5.0, ranges.wait(2)[-1].range, 2)
        said = "source: beacon_3, position: x:3.0 y:-4.0,"
        self.assertTrue(line.wait(1)[0].data.startswith(said))
        delete("beacon_3")
        wait_for(lambda: not advertised("/beacon_3/range"), "the beacon's topic to go")
        # The configured ones stay, whatever becomes of them.
        delete("beacon_2")
        self.addCleanup(self.place, click(-5.0, 2.0))
        count = len(known.messages)
        known.wait(count + 10)
        texts = [m.text for m in labels.wait(len(labels.messages) + 2)[-1].markers if m.text]
        self.assertEqual(3, len(texts))


if __name__ == "__main__":
    rospy.init_node("place_beacon_test")
    rostest.rosrun("bullet_lab", "place_beacon_test", PlaceBeaconTest, sys.argv)
