"""A robot without a simulation: perfect wheels and a clock, and a camera before a dock."""

import math
import threading
import time

import numpy as np
import rospy
import tf2_ros
from bullet_lab.msg import (
    DockActionResult,
    MarkerDetection,
    MarkerDetectionArray,
    UndockActionResult,
)
from geometry_msgs.msg import Twist
from lab_testing import QUARTER_TURN, odometry, transform, wait_for
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo

from bullet_lab.core.pinhole import PinholeCamera

CAMERA = PinholeCamera(640, 480, 502.3, 502.3, 319.5, 239.5)
CAMERA_AHEAD, CAMERA_HEIGHT = 0.16, 0.44
MARKER_SIZE, MARKER_HEIGHT = 0.2, 0.5
FRAME = "camera_optical_frame"
OPTICAL = (-0.5, 0.5, -0.5, 0.5)
SPEED = 8.0
# Wall seconds for a command to a robot at rest, once there was one at the tick before.
REST_SECONDS = 3.0
# Likewise to a robot that moves.
MOTION_SECONDS = 60.0
# After time was set back, a node may miss a tick: steps that do not wait.
FREE_STEPS = 5


class RobotStandIn:
    """Simulates wheels and odometry, at most `SPEED` times as fast as the wall clock.

    As long as the robot moves, time waits at each tick for the next command: a busy machine
    changes nothing. At rest it waits for a while, unless a goal has ended.
    The node that drives the robot ticks once a `tick`.

    Args:
        tick: s from one command to the next, and from one message of odometry to the next.
        odom: topic of the odometry.
        ends: topics that tell of the ends of goals, and their types.

    Attributes:
        pose: x, y, yaw of the robot.
        does: what goes on; take a word out and it stops: "odom", "move".
        lock: held to change the pose.
        says: makes a message of odometry from seconds, x, y and yaw.
    """

    def __init__(self, tick=0.05, odom="odom", ends=()):
        self.pose = (0.0, 0.0, 0.0)
        self.does = {"odom", "move"}
        self._now = rospy.Time(1)
        self._free = 0
        self.says = odometry
        self.lock = threading.Lock()
        self._tick = tick
        self._command = (0.0, 0.0)
        self._answered = threading.Event()
        self._answers = False
        self._over = False
        self._steps = 0
        self._publishers = {
            "clock": self._publisher("/clock", Clock),
            "odom": self._publisher(odom, Odometry),
        }
        self._subscriber = rospy.Subscriber("cmd_vel", Twist, self._take, tcp_nodelay=True)
        self._ends = [rospy.Subscriber(*end, self._take_end) for end in ends]
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self):
        """Let time pass."""
        self._thread.start()
        return self

    def end(self):
        """Stop time."""
        self._over = True
        self._thread.join()
        for topic in (self._subscriber, *self._ends, *self._publishers.values()):
            topic.unregister()

    def set_time(self, now):
        """Set the simulated time."""
        with self.lock:
            self._now, self._free = now, FREE_STEPS

    def wait(self, seconds):
        """Wait until some simulated seconds have passed."""
        until = self._steps + round(seconds / self._tick)
        wait_for(lambda: self._steps >= until, "simulated time")

    def assert_stands(self):
        """Assert that the robot is stopped, and stays where it is."""
        wait_for(lambda: self._command == (0.0, 0.0), "a stop")
        # A step that has begun may still move it.
        self.wait(2.0 * self._tick)
        place = self.pose
        self.wait(0.5)
        assert (place, (0.0, 0.0)) == (self.pose, self._command)

    @staticmethod
    def _publisher(topic, kind):
        return rospy.Publisher(topic, kind, queue_size=100, tcp_nodelay=True)

    def _take(self, message):
        self._command = (message.linear.x, message.angular.z)
        self._answers = True
        self._answered.set()

    def _take_end(self, _):
        self._answers = False
        self._answered.set()

    def _run(self):
        next_time = time.monotonic()
        while not self._over:
            next_time = max(next_time + self._tick / SPEED, time.monotonic())
            time.sleep(max(0.0, next_time - time.monotonic()))
            self._step()
            self._free -= 1
            if self._answers and self._free < 0:
                self._wait_for_command()

    def _wait_for_command(self):
        begun = time.monotonic()
        while not self._answered.wait(0.1):
            patience = REST_SECONDS if self._command == (0.0, 0.0) else MOTION_SECONDS
            is_late = time.monotonic() > begun + patience
            if self._over or is_late or self._subscriber.get_num_connections() == 0:
                self._answers = False
                return
        self._answered.clear()

    def _step(self):
        """Move, and send odometry before the clock that wakes the driver."""
        self._steps += 1
        with self.lock:
            self._now += rospy.Duration(0, round(1e9 * self._tick))
            now = self._now
            if "move" in self.does:
                self._move()
        self._sense(now)
        self._publishers["clock"].publish(Clock(now))

    def _move(self):
        (x, y, yaw), (ahead, turn) = self.pose, self._command
        middle = yaw + 0.5 * turn * self._tick
        x += ahead * self._tick * math.cos(middle)
        y += ahead * self._tick * math.sin(middle)
        self.pose = (x, y, yaw + turn * self._tick)

    def _sense(self, now):
        """Send what the robot measures."""
        if "odom" in self.does:
            message = self.says(now.to_sec(), *self.pose)
            message.twist.twist.linear.x, message.twist.twist.angular.z = self._command
            self._publishers["odom"].publish(message)


class DockStandIn(RobotStandIn):
    """A robot with a camera; the marker of the dock stands at x = 4.

    Attributes:
        does: also "camera_info" and "detections".
    """

    def __init__(self):
        docked, undocked = ("dock/result", DockActionResult), ("undock/result", UndockActionResult)
        super().__init__(ends=[docked, undocked])
        self.pose = (2.6, 0.0, 0.0)
        self.does |= {"camera_info", "detections"}
        self._publishers["camera_info"] = self._publisher("mycamera/camera_info", CameraInfo)
        self._publishers["detections"] = self._publisher("aruco/detections", MarkerDetectionArray)
        self._static = tf2_ros.StaticTransformBroadcaster()
        camera = transform("base_footprint", FRAME, (CAMERA_AHEAD, 0.0, CAMERA_HEIGHT), OPTICAL)
        # The odometry's origin: 1 m to the left of the map's, turned by 90 degrees.
        odom = transform("map", "odom", (0.0, 1.0, 0.0), QUARTER_TURN)
        self._static.sendTransform([camera, odom])

    def _sense(self, now):
        super()._sense(now)
        # Every other time.
        if self._steps % 2:
            return
        if "camera_info" in self.does:
            info = CameraInfo(width=640, height=480, distortion_model="plumb_bob")
            info.header.stamp, info.header.frame_id = now, FRAME
            info.K = CAMERA.matrix.ravel().tolist()
            self._publishers["camera_info"].publish(info)
        if "detections" in self.does:
            message = MarkerDetectionArray()
            message.header.stamp, message.header.frame_id = now, FRAME
            corners = seen_corners(self.pose)
            if corners is not None:
                detection = MarkerDetection(id=0, dictionary="DICT_APRILTAG_36h10")
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
