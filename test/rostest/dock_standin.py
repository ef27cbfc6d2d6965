"""A robot before a dock without a simulation: perfect wheels, a perfect camera, and a clock."""

import math
import threading
import time

import numpy as np
import rospy
import tf2_ros
from bullet_lab.msg import MarkerDetection, MarkerDetectionArray
from geometry_msgs.msg import TransformStamped, Twist
from lab_testing import odometry
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo

from bullet_lab.core.pinhole import PinholeCamera

CAMERA = PinholeCamera(640, 480, 502.3, 502.3, 319.5, 239.5)
CAMERA_AHEAD, CAMERA_HEIGHT = 0.16, 0.44
MARKER_SIZE, MARKER_HEIGHT = 0.2, 0.5
FRAME = "camera_optical_frame"
STEP = 0.01
SPEED = 8.0
# Wall seconds for a command at each tick, once there was one at the tick before; after a tick
# without one, the speed for as many simulated seconds: a node that is starved keeps its odometry.
ANSWER_SECONDS = 0.3
SLOW_SPEED, SLOW_SECONDS = 1.0, 0.6


class StandIn:
    """Simulates what dock.py is told, `SPEED` times as fast as the wall clock.

    Time waits a little for a node that sends commands, so that a busy machine changes nothing.

    Attributes:
        pose: x, y, yaw of the robot; the marker stands at x = 4.
        does: what goes on; take a word out and it stops: "odom", "camera_info", "detections",
            "move".
        marker: id of the marker; None for no marker.
        matrix: K as camera_info tells it.
        time: simulated time in s.
    """

    def __init__(self):
        self.pose = (2.6, 0.0, 0.0)
        self.does = {"odom", "camera_info", "detections", "move"}
        self.marker = 0
        self.matrix = CAMERA.matrix.ravel().tolist()
        self.time = 1.0
        self.shift = (0.0, 0.0)
        self._command = (0.0, 0.0)
        self._answered = threading.Event()
        self._answers = False
        self._over = False
        self._publishers = {
            "clock": self._publisher("/clock", Clock),
            "odom": self._publisher("odom", Odometry),
            "camera_info": self._publisher("mycamera/camera_info", CameraInfo),
            "detections": self._publisher("aruco/detections", MarkerDetectionArray),
        }
        self._static = tf2_ros.StaticTransformBroadcaster()
        self._static.sendTransform([_camera_transform(), _map_transform()])
        self._subscriber = rospy.Subscriber("cmd_vel", Twist, self._take, tcp_nodelay=True)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def end(self):
        self._over = True
        self._thread.join()
        self._subscriber.unregister()
        for publisher in self._publishers.values():
            publisher.unregister()

    @staticmethod
    def _publisher(topic, kind):
        return rospy.Publisher(topic, kind, queue_size=100, tcp_nodelay=True)

    def _take(self, message):
        self._command = (message.linear.x, message.angular.z)
        self._answers = True
        self._answered.set()

    def _run(self):
        next_time, number, slow = time.monotonic(), 0, 0.0
        while not self._over:
            number += 1
            speed = SLOW_SPEED if slow > 0.0 else SPEED
            next_time = max(next_time + STEP / speed, time.monotonic())
            time.sleep(max(0.0, next_time - time.monotonic()))
            self._step(number)
            slow -= STEP
            if self._answers and number % 5 == 0:
                self._answers = self._answered.wait(ANSWER_SECONDS)
                slow = 0.0 if self._answers else SLOW_SECONDS
                self._answered.clear()

    def _step(self, number):
        self.time += STEP
        if "move" in self.does:
            ahead, turn = self._command
            x, y, yaw = self.pose
            middle = yaw + 0.5 * turn * STEP
            self.pose = (
                x + ahead * STEP * math.cos(middle),
                y + ahead * STEP * math.sin(middle),
                yaw + turn * STEP,
            )
        stamp = rospy.Time.from_sec(self.time)
        self._publishers["clock"].publish(Clock(stamp))
        if number % 5 == 0 and "odom" in self.does:
            x, y, yaw = self.pose
            message = odometry(self.time, x + self.shift[0], y + self.shift[1], yaw)
            message.twist.twist.linear.x, message.twist.twist.angular.z = self._command
            self._publishers["odom"].publish(message)
        if number % 10 == 0:
            self._look(stamp)

    def _look(self, stamp):
        if "camera_info" in self.does:
            info = CameraInfo(width=640, height=480, distortion_model="plumb_bob")
            info.header.stamp, info.header.frame_id = stamp, FRAME
            info.K = self.matrix
            self._publishers["camera_info"].publish(info)
        if "detections" in self.does:
            message = MarkerDetectionArray()
            message.header.stamp, message.header.frame_id = stamp, FRAME
            corners = None if self.marker is None else seen_corners(self.pose)
            if corners is not None:
                detection = MarkerDetection(id=self.marker, dictionary="DICT_APRILTAG_36h10")
                detection.size = MARKER_SIZE
                detection.corners = corners.ravel().tolist()
                message.detections = [detection]
            self._publishers["detections"].publish(message)


def seen_corners(pose):
    """Pixels of the marker's corners, shape (4, 2), or None where it is not all in the image."""
    half = 0.5 * MARKER_SIZE
    # The marker faces -x: as one looks at it, left is +y.
    corners = np.array([(half, half), (-half, half), (-half, -half), (half, -half)])
    x, y, yaw = pose
    cosine, sine = math.cos(yaw), math.sin(yaw)
    dx, dy = 4.0 - x, corners[:, 0] - y
    ahead = cosine * dx + sine * dy - CAMERA_AHEAD
    left = cosine * dy - sine * dx
    up = MARKER_HEIGHT + corners[:, 1] - CAMERA_HEIGHT
    pixels = CAMERA.project(np.column_stack((-left, -up, ahead)))
    inside = (pixels > 2.0).all() and (pixels < (637.0, 477.0)).all()
    return pixels if inside and x < 3.9 else None


def _camera_transform():
    transform = TransformStamped()
    transform.header.frame_id, transform.child_frame_id = "base_footprint", FRAME
    transform.transform.translation.x = CAMERA_AHEAD
    transform.transform.translation.z = CAMERA_HEIGHT
    turn = transform.transform.rotation
    turn.x, turn.y, turn.z, turn.w = -0.5, 0.5, -0.5, 0.5
    return transform


def _map_transform():
    """The odometry's origin on a map: 1 m to the left of the map's, turned by 90 degrees."""
    transform = TransformStamped()
    transform.header.frame_id, transform.child_frame_id = "map", "odom"
    transform.transform.translation.y = 1.0
    turn = transform.transform.rotation
    turn.z = turn.w = math.sqrt(0.5)
    return transform
