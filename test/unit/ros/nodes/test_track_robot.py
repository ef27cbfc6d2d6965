"""Each beacon has its own topics, and the report's strings to the letter."""

import math

import pytest
import rospy
from message_fields import message
from nav_msgs.msg import Odometry
from shared import cases

from bullet_lab.errors import LabError
from bullet_lab.ros.nodes import track_robot
from bullet_lab.ros.nodes.track_robot import TrackRobot, TrackRobotParameters, accept_beacons

NODE = track_robot


def odometry(seconds, x=0.0, y=0.0, frame="odom"):
    text = f"""
        header: {{frame_id: {frame}}}
        child_frame_id: base_footprint
        pose: {{pose: {{position: {{x: {x}, y: {y}}}, orientation: {{w: 1.0}}}}}}
    """
    made = message(Odometry, text)
    made.header.stamp = rospy.Time.from_sec(seconds)
    return made


@cases("""
place, name, words:
  # Distances that every formula gives to the last digit: 3-4-5 and the like.
  - [[1.0, 2.0], beacon_0, "x:1 y:1, distance: 1.0"]
  - [[5.0, 4.0], beacon_1, "x:5 y:1, distance: 3.0"]
  - [[-5.0, -11.0], beacon_2, "x:-5 y:1, distance: 12.0"]
""")
def test_strings_are_those_of_the_report(published, place, name, words):
    TrackRobot(TrackRobotParameters()).callback(odometry(1.0, *place))
    (line,) = published[name]
    assert line.data == f"source: {name}, position: {words}"


def test_beacons_from_the_parameter_whole_or_not(published):
    beacons = accept_beacons([["lamp", 0.5, -2], ["post", 3, 4.0]])
    node = TrackRobot(TrackRobotParameters(beacons=beacons))
    node.callback(odometry(1.0))
    assert published["post"][0].data == "source: post, position: x:3 y:4.0, distance: 5.0"
    # A distance that is a root: to the last digit but one.
    said, at = published["lamp"][0].data.split(" distance: ")
    assert said == "source: lamp, position: x:0.5 y:-2,"
    assert float(at) == pytest.approx(math.hypot(0.5, -2), abs=1e-14)


def test_lines_ranges_and_labels_say_the_same_distances(published, as_before):
    node = TrackRobot(TrackRobotParameters())
    for k in range(1, 3):
        node.callback(odometry(0.05 * k, 0.3 * k, -0.2 * k))
    told = []
    for topic, messages in sorted(published.items()):
        told += [f"# {topic}", *(line for one in messages for line in str(one).splitlines())]
    as_before(told, "beacons.txt")


def test_what_cannot_be_used_is_refused(published):
    node = TrackRobot(TrackRobotParameters())
    node.callback(odometry(1.0))
    for bad in (odometry(2.0, ".nan"), odometry(2.0, frame="map")):
        with pytest.raises(LabError):
            node.callback(bad)
    node.callback(odometry(3.0))
    assert [m.header.stamp.to_sec() for m in published["beacon_2/range"]] == [1.0, 3.0]


@cases("""
value:
  - 5
  - [[a, 1]]
  - [[a, 1, 2, 3]]
  - [[a, 1, .inf]]
  - [[a, 1, "2"]]
  - [[a, true, 2]]
  - [[a b, 1, 2]]
  - [["", 1, 2]]
  - [[7, 1, 2]]
  - [[a, 1, 2], [a, 3, 4]]
  - {a: [1, 2]}
""")
def test_bad_beacons(value):
    with pytest.raises((ValueError, TypeError)):
        accept_beacons(value)
