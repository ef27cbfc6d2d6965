"""A robot's camera without the robot: it stands wherever one wants a picture from."""

from __future__ import annotations

from dataclasses import replace
from typing import Optional

import numpy as np

from bullet_lab.errors import LabError
from bullet_lab.numerics.pinhole import PinholeCamera
from bullet_lab.simulation.description import Link, Model, World
from bullet_lab.simulation.devices.camera import Camera
from bullet_lab.simulation.pose import Pose
from bullet_lab.simulation.resources import ResourceFinder
from bullet_lab.simulation.samples import ImageSample
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.urdf_reader import read_urdf_file
from bullet_lab.vision.images import grey

ROBOT = "package://bullet_lab/urdf/camera_robot.urdf"
NAME = "free_camera"

# Columns: the axes of the optical frame (right, down, ahead) in that of the camera's link.
OPTICAL_AXES = ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))


class FreeCameraError(LabError):
    """A robot has no camera that could be taken off it."""


class FreeCamera:
    """Takes pictures in a world with the camera that a robot has, noise included.

    Args:
        world: what there is to see.
        seed: of the noise.
        robot: URDF file with the camera.

    Raises:
        LabError: a file cannot be read, or the robot has no camera.
    """

    def __init__(self, world: World, seed: int = 0, robot: str = ROBOT):
        model = camera_alone(read_urdf_file(ResourceFinder.anywhere().find(robot)))
        self._simulation = Simulation(world, seed)
        self._instance = self._simulation.add(model)
        self._device: Camera = self._instance.devices[0]
        self._device.image.connect(self._keep)
        self._sample: Optional[ImageSample] = None

    def __enter__(self) -> FreeCamera:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def close(self) -> None:
        """Give everything back."""
        self._simulation.close()

    @property
    def camera(self) -> PinholeCamera:
        """Geometry of the pictures."""
        return self._device.camera

    def take(self, pose: Pose, number: int) -> np.ndarray:
        """Return the picture from a pose, (height, width) of uint8, grey.

        Args:
            pose: of the camera in the world: x ahead, z up.
            number: of the picture, >= 0; its noise follows from this and the seed.

        Raises:
            LabError: something cannot be drawn.
        """
        self._instance.place(pose)
        self._device.produce(number)
        return grey(self._sample.pixels, self._sample.encoding)

    def _keep(self, sample: ImageSample) -> None:
        self._sample = sample


def camera_alone(robot: Model) -> Model:
    """Return a model of nothing but a robot's camera; its frame is that of the camera's link.

    Raises:
        FreeCameraError: the robot has no camera.
    """
    cameras = [plugin for plugin in robot.plugins if plugin.filename == "libgazebo_ros_camera.so"]
    if not cameras:
        raise FreeCameraError(f"robot '{robot.name}' has no camera")
    plugin = replace(cameras[0], link="camera")
    return Model(NAME, (Link("camera"),), plugins=(plugin,), static=True)


def in_optical_frame(pose: Pose, points: np.ndarray) -> np.ndarray:
    """Return (n, 3) points of the world as a camera at a pose has them: right, down, ahead."""
    inside = (np.asarray(points, dtype=float) - pose.position) @ pose.rotation_matrix()
    return inside @ np.array(OPTICAL_AXES)
