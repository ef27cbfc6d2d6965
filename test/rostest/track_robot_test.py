#!/usr/bin/env python3
"""Each beacon has its own topics, and the report's strings to the letter."""

import math

import rospy
import rostest
from lab_testing import Node, NodeTest, odometry, wait_for
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Range
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from bullet_lab.ros.nodes.track_robot import accept_beacons

THREE = {"beacon_0": (1, 1), "beacon_1": (5, 1), "beacon_2": (-5, 1)}


class TrackRobotTest(NodeTest):
    """What is said of the report's beacons, by a node that all tests share, and of others."""

    @classmethod
    def setUpClass(cls):
        cls.shared = Node("track_robot.py")

    @classmethod
    def tearDownClass(cls):
        cls.shared.end()

    def listen(self, names=tuple(THREE)):
        self.lines = {name: self.topic(name, String) for name in names}
        self.ranges = {name: self.topic(f"{name}/range", Range) for name in names}
        self.odom = self.publisher("odom", Odometry)

    def test_strings_are_those_of_the_report(self):
        self.listen()
        # Distances that every formula gives to the last digit: 3-4-5 and the like.
        said = {
            (1.0, 2.0): ("beacon_0", "x:1 y:1, distance: 1.0"),
            (5.0, 4.0): ("beacon_1", "x:5 y:1, distance: 3.0"),
            (-5.0, -11.0): ("beacon_2", "x:-5 y:1, distance: 12.0"),
        }
        for k, (place, (name, words)) in enumerate(said.items()):
            self.odom.publish(odometry(k + 1.0, *place))
            line = self.lines[name].wait(k + 1)[k].data
            self.assertEqual(f"source: {name}, position: {words}", line)

    def test_beacons_from_the_parameter_whole_or_not(self):
        self.node("track_robot.py", "other", beacons="[[lamp, 0.5, -2], [post, 3, 4.0]]")
        self.listen(["lamp", "post"])
        wait_for(lambda: self.odom.get_num_connections() == 2, "both nodes")
        places = [(3.5, 2.0), (0.0, 0.0)]
        for k, (x, y) in enumerate(places):
            self.odom.publish(odometry(k + 1.0, x, y))
        self.assertEqual(
            "source: post, position: x:3 y:4.0, distance: 5.0", self.lines["post"].wait(2)[1].data
        )
        # A distance that is a root: to the last digit but one.
        said, at = self.lines["lamp"].wait(2)[1].data.split(" distance: ")
        self.assertEqual("source: lamp, position: x:0.5 y:-2,", said)
        self.assertAlmostEqual(math.hypot(0.5, -2), float(at), 14)

    def test_ranges_are_the_same_distances_with_the_stamp_of_the_odometry(self):
        self.listen()
        for k in range(1, 21):
            self.odom.publish(odometry(0.05 * k, 0.3 * k, -0.2 * k))
        for name, (x, y) in THREE.items():
            for k, message in enumerate(self.ranges[name].wait(20), 1):
                self.assertEqual(rospy.Time.from_sec(0.05 * k), message.header.stamp)
                self.assertAlmostEqual(math.hypot(0.3 * k - x, -0.2 * k - y), message.range, 5)
                self.assertTrue(message.min_range <= message.range <= message.max_range)
                line = self.lines[name].wait(20)[k - 1].data
                self.assertAlmostEqual(float(line.split()[-1]), message.range, 5)

    def test_markers_say_the_distances(self):
        self.listen()
        markers = self.topic("beacon_markers", MarkerArray)
        self.odom.publish(odometry(1.0, 1.0, 3.0))
        labels = {m.text: m for m in markers.wait(1)[0].markers if m.text}
        self.assertIn("beacon_0: 2.00 m", labels)
        self.assertEqual(3, len(labels))
        place = labels["beacon_0: 2.00 m"].pose.position
        self.assertEqual((1.0, 1.0), (place.x, place.y))

    def test_what_cannot_be_used_is_refused(self):
        self.listen()
        bad = [odometry(2.0, math.nan), odometry(2.0, frame="map")]
        for message in [odometry(1.0), *bad, odometry(3.0)]:
            self.odom.publish(message)
        stamps = [m.header.stamp.to_sec() for m in self.ranges["beacon_2"].wait(2)]
        self.assertEqual([1.0, 3.0], stamps)
        wait_for(lambda: "odom: refused:" in self.shared.err, "a warning")
        self.assertNotIn("Traceback", self.shared.err)

    def test_bad_beacons(self):
        for value in (
            5,
            [["a", 1]],
            [["a", 1, 2, 3]],
            [["a", 1, math.inf]],
            [["a", 1, "2"]],
            [["a", True, 2]],
            [["a b", 1, 2]],
            [["", 1, 2]],
            [[7, 1, 2]],
            [["a", 1, 2], ["a", 3, 4]],
            {"a": [1, 2]},
        ):
            with self.subTest(value=value), self.assertRaises((ValueError, TypeError)):
                accept_beacons(value)


def setUpModule():
    rospy.init_node("track_robot_test")


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "track_robot_test", "__main__")
