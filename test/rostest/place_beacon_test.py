#!/usr/bin/env python3
"""A click in RViz places a beacon where there is room, and track_robot measures it."""

import math
import sys
import unittest

import rospy
import rostest
import tf2_ros
from geometry_msgs.msg import Point, PointStamped, TransformStamped
from lab_testing import Node, Topic, publisher, wait_for
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


class PlaceBeaconTest(unittest.TestCase):
    """The report's three beacons stand there already, and the block robot at the origin."""

    def setUp(self):
        self.bridge = self.start(
            "pybullet_bridge.py",
            world="package://bullet_lab/worlds/beacons.world",
            robot=BLOCK_ROBOT,
            publish_world_tf=True,
        )
        self.node = self.start("place_beacon.py")
        self.placed = self.topic("place_beacon/placed", String)
        self.clicks = publisher("/clicked_point", PointStamped)
        self.addCleanup(self.clicks.unregister)

    def start(self, script, **parameters):
        node = Node(script, **parameters)
        self.addCleanup(node.end)
        return node

    def topic(self, name, kind):
        topic = Topic(name, kind)
        self.addCleanup(topic.close)
        return topic

    def refused(self, why):
        wait_for(lambda: why in self.node.err, f"'{why}' in the warnings")

    def test_a_beacon_for_each_click_with_the_first_free_name(self):
        self.clicks.publish(click(2.0, 3.0, z=0.4))
        self.assertEqual("beacon_3", self.placed.wait(1)[0].data)
        self.assertEqual((2.0, 3.0), place_of("beacon_3"))
        delete("beacon_1")
        self.clicks.publish(click(-2.0, 3.0))
        self.assertEqual("beacon_1", self.placed.wait(2)[1].data)
        self.assertEqual((-2.0, 3.0), place_of("beacon_1"))

    def test_points_in_other_frames(self):
        broadcaster = tf2_ros.StaticTransformBroadcaster()
        self.addCleanup(broadcaster.pub_tf.unregister)
        transform = TransformStamped(child_frame_id="map")
        transform.header.frame_id = "world"
        transform.transform.translation.x = 1.0
        transform.transform.rotation.z = transform.transform.rotation.w = math.sqrt(0.5)
        broadcaster.sendTransform(transform)
        self.clicks.publish(click(3.0, 0.5, "map"))
        name = self.placed.wait(1)[0].data
        for wanted, value in zip((0.5, 3.0), place_of(name)):
            self.assertAlmostEqual(wanted, value, 9)

    def test_what_is_refused(self):
        before = world()
        # One report a second: a node of its own for each would take longer.
        for why, message in {
            "too near to beacon_0": click(1.45, 1.0),
            "too near to block_robot": click(0.3, 0.3),
            "the point is not finite": click(math.nan, 0.0),
            "no frame_id": click(3.0, 3.0, ""),
            "no transform from 'mars' to 'world'": click(3.0, 3.0, "mars"),
        }.items():
            self.clicks.publish(message)
            self.refused(why)
            rospy.rostime.wallsleep(1.1)
        self.assertEqual(before, world())
        self.clicks.publish(click(1.6, 1.0))
        self.placed.wait(1)
        # The new one takes up room as well.
        self.clicks.publish(click(1.7, 1.0))
        self.refused("too near to beacon_3")
        self.assertNotIn("Traceback", self.node.err)

    def test_the_robot_is_tracked_from_beacons_that_come_and_go(self):
        self.start("track_robot.py", watch=True)
        known = self.topic("beacon_0", String)
        labels = self.topic("beacon_markers", MarkerArray)
        self.assertIn("position: x:1 y:1,", known.wait(1)[0].data)
        self.clicks.publish(click(3.0, -4.0))
        self.placed.wait(1)
        ranges, line = self.topic("beacon_3/range", Range), self.topic("beacon_3", String)
        self.assertAlmostEqual(5.0, ranges.wait(2)[-1].range, 2)
        said = "source: beacon_3, position: x:3.0 y:-4.0,"
        self.assertTrue(line.wait(1)[0].data.startswith(said))
        delete("beacon_3")
        wait_for(lambda: not ranges.is_connected(), "the beacon's topic to go")
        # The configured ones stay, whatever becomes of them.
        delete("beacon_0")
        count = len(known.messages)
        known.wait(count + 10)
        texts = [m.text for m in labels.wait(len(labels.messages) + 2)[-1].markers if m.text]
        self.assertEqual(3, len(texts))


if __name__ == "__main__":
    rospy.init_node("place_beacon_test")
    rostest.rosrun("bullet_lab", "place_beacon_test", PlaceBeaconTest, sys.argv)
