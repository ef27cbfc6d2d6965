"""A picture of a model in a running simulator, by a camera that is put there for it."""

from __future__ import annotations

import math
import time
from typing import Any, Callable, List, Optional

import numpy as np
import rospy
from sensor_msgs.msg import Image

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.ros.gazebo.client import call
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.ros.messages.images import pixels_of
from bullet_lab.ros.messages.poses import pose_message
from bullet_lab.ros.node.lock_step import publishers_know_this_node
from bullet_lab.ros.node.publishers import subscriber

NAME = "bullet_lab_photographer"
FIELD_OF_VIEW = 0.8
# Where the camera stands, as seen from the middle of the model: ahead, to its left, above.
DIRECTION = (0.72, 0.52, 0.46)
# Of the half diagonal, so that all of it is in the picture with some room around it.
DISTANCE = 1.25 / math.sin(0.5 * FIELD_OF_VIEW * 0.75)
# What is nearer than this part of the way to the model is not drawn: walls of narrow rooms.
CLEARANCE = 0.5
# A thing without size is looked at from here, m.
SMALLEST = 0.1
# Wall seconds for a connection, or a picture that has been taken.
LATEST = 2.0
CAMERA = """<sdf version="1.6"><model name="{name}"><static>true</static><link name="link">
  <sensor name="camera" type="camera"><update_rate>2</update_rate><camera>
    <horizontal_fov>{fov}</horizontal_fov>
    <image><width>800</width><height>600</height><format>R8G8B8</format></image>
    <clip><near>{near}</near><far>{far}</far></clip>
  </camera>
  <plugin name="camera" filename="libgazebo_ros_camera.so">
    <cameraName>{name}</cameraName><imageTopicName>image_raw</imageTopicName>
    <cameraInfoTopicName>camera_info</cameraInfoTopicName><frameName>{name}</frameName>
    <robotNamespace>/</robotNamespace><samples>4</samples>
  </plugin></sensor></link></model></sdf>"""


def camera_pose(least: Vector, greatest: Vector) -> Pose:
    """Return where a camera sees the whole of a box, looking along its x."""
    middle = 0.5 * (np.array(least) + greatest)
    way = distance_to(least, greatest) * np.array(DIRECTION) / np.linalg.norm(DIRECTION)
    yaw = math.atan2(-way[1], -way[0])
    pitch = math.atan2(way[2], math.hypot(way[0], way[1]))
    return Pose.from_rpy(tuple((middle + way).tolist()), (0.0, pitch, yaw))


def distance_to(least: Vector, greatest: Vector) -> float:
    """Return how far from the middle of a box (m) its camera stands."""
    half = 0.5 * float(np.linalg.norm(np.subtract(greatest, least)))
    return DISTANCE * max(half, SMALLEST)


def photograph(
    least: Vector, greatest: Vector, wait: Callable[[], None], patience: int
) -> Optional[np.ndarray]:
    """Return a picture of what is in a box of the world (m), (h, w, 3) uint8, blue green red.

    `wait` lets a twentieth of a second pass, and is called `patience` times, so that the world is
    as far afterwards however long the picture takes; None if none comes.
    """
    distance = distance_to(least, greatest)
    near = CLEARANCE * distance
    text = CAMERA.format(name=NAME, fov=FIELD_OF_VIEW, near=near, far=distance + 100.0)
    pose = pose_message(camera_pose(least, greatest))
    pictures: List[Any] = []
    call("/gazebo/spawn_sdf_model", srv.SpawnModel, NAME, text, "/", pose, "world")
    listener = subscriber(f"/{NAME}/image_raw", Image, pictures.append)
    try:
        _wait_until(lambda: publishers_know_this_node(listener.resolved_name))
        for _ in range(patience):
            wait()
        _wait_until(lambda: pictures)
    finally:
        listener.unregister()
        if not rospy.is_shutdown():
            call("/gazebo/delete_model", srv.DeleteModel, NAME)
    return pixels_of(pictures[0], "bgr8") if pictures else None


def _wait_until(holds: Callable[[], Any]) -> None:
    deadline = time.monotonic() + LATEST
    while not holds() and time.monotonic() < deadline and not rospy.is_shutdown():
        rospy.rostime.wallsleep(0.01)
