import math
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rospy")

import rospy
from bullet_lab.msg import DockGoal, MarkerDetection, MarkerDetectionArray
from geometry_msgs.msg import PoseStamped, Quaternion
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo

from bullet_lab.core.pose import Pose
from bullet_lab.docking.database import Dock, DockMarker, DockTolerance, DockUncertainty
from bullet_lab.docking.types import DockingError
from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.world_topics import TouchCounter
from bullet_lab.ros.messages.images import CameraGeometryError
from bullet_lab.ros.messages.poses import InputError
from bullet_lab.ros.node import message_queue
from bullet_lab.ros.node.message_queue import MessageQueue
from bullet_lab.ros.node.odometry import OdometryError
from bullet_lab.ros.nodes.dock import with_tolerances
from bullet_lab.ros.nodes.dock_messages import (
    GoalError,
    NotYetError,
    camera_of,
    mount_of,
    odometry_of,
    rough_pose,
    sightings_of,
)
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation

DOCK = Dock(
    "dock",
    "odom",
    (4.0, 0.0, 0.1),
    DockMarker("DICT_APRILTAG_36h10", 0, 0.2, 0.5),
    None,
    3.0,
    0.4,
    DockTolerance(0.005, 0.006, 0.007),
    DockUncertainty(0.3, 0.2),
)


def odometry(stamp=1.0, yaw=0.0):
    message = Odometry()
    message.header.stamp = rospy.Time.from_sec(stamp)
    message.pose.pose.orientation.z = math.sin(0.5 * yaw)
    message.pose.pose.orientation.w = math.cos(0.5 * yaw)
    return message


def test_odometry_with_the_covariance_of_its_twist():
    message = odometry(yaw=0.5)
    message.pose.pose.position.x = 2.0
    message.twist.twist.linear.x, message.twist.twist.angular.z = 0.3, -0.2
    message.twist.covariance = list(range(36))
    found = odometry_of(message)
    assert found.stamp == 1.0
    assert found.pose == pytest.approx((2.0, 0.0, 0.5))
    assert found.velocity == (0.3, -0.2)
    assert found.twist_covariance.tolist() == [[0, 1, 5], [6, 7, 11], [30, 31, 35]]


def test_odometry_that_is_none_is_refused():
    message = odometry()
    message.pose.pose.orientation.w = 0.0
    with pytest.raises(OdometryError):
        odometry_of(message)


def test_a_camera_on_the_robot():
    # The optical frame of a camera that looks ahead.
    mount = mount_of(Pose((0.16, 0.01, 0.44), (-0.5, 0.5, -0.5, 0.5)))
    assert (mount.x, mount.y, mount.z) == pytest.approx((0.16, 0.01, 0.44))
    assert (mount.roll, mount.pitch, mount.yaw) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


def test_camera_info():
    info = CameraInfo(width=640, height=480, distortion_model="plumb_bob")
    info.K = [500.0, 0.0, 320.0, 0.0, 501.0, 240.0, 0.0, 0.0, 1.0]
    camera = camera_of(info)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (500.0, 501.0, 320.0, 240.0)
    info.K = [0.0] * 9
    with pytest.raises(CameraGeometryError):
        camera_of(info)


def test_markers_without_finite_corners_are_left_out():
    good = MarkerDetection(id=3, dictionary="d", corners=list(range(8)))
    bad = MarkerDetection(id=4, corners=[math.nan] * 8)
    (found,) = sightings_of(MarkerDetectionArray(detections=[bad, good]))
    assert (found.id, found.dictionary) == (3, "d")
    assert found.corners.tolist() == [[0, 1], [2, 3], [4, 5], [6, 7]]


def make_queue(rate=20.0, read=lambda message: message.header.stamp.to_sec()):
    return MessageQueue("odom", Odometry, read, rate)


def receive(queue, *stamps):
    for stamp in stamps:
        queue._receive(odometry(stamp))


def test_a_queue_gives_what_is_stamped_up_to_now():
    queue = make_queue()
    receive(queue, 0.05, 0.1, 0.15)
    assert queue.take(rospy.Time.from_sec(0.1)) == [0.05, 0.1]
    assert queue.take(rospy.Time.from_sec(0.1)) == []
    assert queue.take(rospy.Time.from_sec(1.0)) == [0.15]


def test_a_queue_refuses_what_goes_back_and_says_why(monkeypatch):
    monkeypatch.setattr(rospy, "logwarn", lambda *_: None)
    queue = make_queue()
    receive(queue, 0.1, 0.05)
    assert "before" in queue.trouble
    assert queue.take(rospy.Time(1)) == [0.1]
    queue.clear()
    receive(queue, 0.05)
    assert (queue.trouble, queue.take(rospy.Time(1))) == ("", [0.05])


@pytest.mark.parametrize(
    ("rate", "stamps", "now", "due"),
    [
        (20.0, (), 0.0, False),
        (20.0, (), 0.05, True),
        (20.0, (0.05,), 0.05, False),
        (20.0, (0.05,), 0.1, True),
        # At 30 Hz the bridge's steps are 34, 67 and 100 ms.
        (30.0, (0.034,), 0.05, False),
        (30.0, (0.034,), 0.066, False),
        (30.0, (0.034,), 0.067, True),
        (30.0, (0.067,), 0.099, False),
        (30.0, (0.067,), 0.1, True),
        (5.0, (0.2,), 0.35, False),
    ],
)
def test_a_queue_waits_for_what_is_due(monkeypatch, rate, stamps, now, due):
    monkeypatch.setattr(rospy, "is_shutdown", lambda: False)
    monkeypatch.setattr(message_queue, "LATEST", 0.05)
    queue = make_queue(rate)
    monkeypatch.setattr(message_queue, "in_lock_step", lambda: True)
    queue.clear()
    receive(queue, *stamps)
    start = time.monotonic()
    queue.wait(rospy.Time.from_sec(now))
    assert (time.monotonic() - start >= 0.05) == due


def test_a_queue_goes_on_as_soon_as_it_is_there(monkeypatch):
    monkeypatch.setattr(rospy, "is_shutdown", lambda: False)
    queue = make_queue()
    monkeypatch.setattr(message_queue, "in_lock_step", lambda: True)
    threading.Timer(0.05, receive, (queue, 0.05)).start()
    start = time.monotonic()
    queue.wait(rospy.Time.from_sec(0.05))
    assert time.monotonic() - start < 5.0
    assert queue.take(rospy.Time.from_sec(0.05)) == [0.05]


def test_what_never_comes_is_waited_for_once(monkeypatch):
    monkeypatch.setattr(rospy, "is_shutdown", lambda: False)
    monkeypatch.setattr(message_queue, "LATEST", 0.1)
    queue = make_queue()
    monkeypatch.setattr(message_queue, "in_lock_step", lambda: True)
    queue.clear()
    for expected in (True, False, False):
        start = time.monotonic()
        queue.wait(rospy.Time(1))
        assert (time.monotonic() - start >= 0.1) == expected


def test_out_of_lock_step_nothing_is_waited_for(monkeypatch):
    monkeypatch.setattr(rospy, "is_shutdown", lambda: False)
    start = time.monotonic()
    make_queue().wait(rospy.Time(1))
    assert time.monotonic() - start < message_queue.LATEST


def goal(frame="", x=0.0, y=0.0, yaw=0.0):
    message = PoseStamped()
    message.header.frame_id = frame
    message.pose.position.x, message.pose.position.y = x, y
    message.pose.orientation.z = math.sin(0.5 * yaw)
    message.pose.orientation.w = math.cos(0.5 * yaw)
    return DockGoal(dock_id="dock", dock_pose=message)


def lookup(target, source):
    if source != "map":
        raise InputError(f"no transform from {source}")
    return Pose.from_rpy((1.0, 2.0, 0.0), (0.0, 0.0, math.pi / 2))


def test_the_rough_pose_is_that_of_the_database_unless_the_goal_has_one():
    assert rough_pose(goal(), DOCK, "odom", lookup) == pytest.approx((4.0, 0.0, 0.1))
    given = rough_pose(goal("odom", 3.0, 1.0, -0.2), DOCK, "/odom", lookup)
    assert given == pytest.approx((3.0, 1.0, -0.2))


def test_a_pose_in_another_frame_is_turned_into_that_of_the_odometry():
    found = rough_pose(goal("map", 3.0, 1.0, -0.2), DOCK, "odom", lookup)
    assert found == pytest.approx((0.0, 5.0, math.pi / 2 - 0.2))


def test_an_unknown_frame_may_be_known_later():
    with pytest.raises(NotYetError) as caught:
        rough_pose(goal("mars"), DOCK, "odom", lookup)
    assert caught.value.error == DockingError.NOT_VALID


def test_a_leaning_dock_is_refused_for_good():
    wrong = goal("odom")
    wrong.dock_pose.pose.orientation = Quaternion(math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
    with pytest.raises(GoalError) as caught:
        rough_pose(wrong, DOCK, "odom", lookup)
    assert not isinstance(caught.value, NotYetError)
    assert isinstance(caught.value, LabError)


def test_tolerances_are_replaced_where_they_are_given():
    assert with_tolerances(DOCK, 0.0, 0.0, 0.0) == DOCK
    assert with_tolerances(DOCK, 0.1, 0.0, 0.3).tolerance == DockTolerance(0.1, 0.006, 0.3)


class Listener:
    """A publisher that keeps what it is given."""

    def __init__(self):
        self.listens = True
        self.messages = []

    def has_connections(self):
        return self.listens

    def publish(self, message):
        self.messages.append(message)


def test_touches_are_counted_anew_each_time_and_the_floor_is_none():
    listener = Listener()
    with Simulation.of("package://bullet_lab/worlds/docking.world") as simulation:
        robot = simulation.spawn("package://bullet_lab/urdf/camera_robot.urdf")
        topics = SimpleNamespace(publisher=lambda topic, kind: listener)
        world = SimpleNamespace(
            simulation=simulation, models=simulation.models, topics=topics, changed=[]
        )
        TouchCounter(world)
        simulation.run_for(0.5)
        assert listener.messages[-1].models == []
        assert len(listener.messages) == 5
        for times in (1, 2):
            # Into the left wall, pushing against it for a second, and away from it.
            robot.place(Pose.from_rpy((3.0, 0.25, 0.0), (0.0, 0.0, math.pi / 2)))
            robot.command("cmd_vel", PlanarCommand(0.2))
            simulation.run_for(1.3)
            assert listener.messages[-1].models == ["docking_station"]
            assert times <= listener.messages[-1].touches[0] <= 4 * times
            robot.place(Pose((3.0, 0.0, 0.0)))
            simulation.run_for(0.2)
        assert listener.messages[-1].header.stamp.to_sec() == pytest.approx(3.5)
        listener.listens = False
        count = len(listener.messages)
        simulation.run_for(0.2)
        assert len(listener.messages) == count


def test_corners_stay_numbers():
    message = MarkerDetectionArray(detections=[MarkerDetection(corners=[0.5] * 8)])
    assert sightings_of(message)[0].corners.dtype == np.float64
