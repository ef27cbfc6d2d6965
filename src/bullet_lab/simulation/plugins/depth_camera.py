"""libgazebo_ros_openni_kinect.so, libgazebo_ros_depth_camera.so: a camera that measures depth."""

from __future__ import annotations

from typing import ClassVar, Optional, Tuple

import cv2
import numpy as np

from bullet_lab.simulation.plugins.camera import Camera
from bullet_lab.simulation.plugins.device import DeviceError, Mount, device
from bullet_lab.simulation.plugins.samples import CameraInfoSample, ImageSample, PointsSample
from bullet_lab.simulation.rendering.renderer import Shot

KINECT = "libgazebo_ros_openni_kinect"
KINECTS_CUTOFF = 5.0
# What is published beside points only where somebody has asked Gazebo for it, and not here.
NOT_SIMULATED = ("reduceNormals", "normalsTopicName", "reflectanceTopicName")
TO_RGB = {"bgr8": cv2.COLOR_BGR2RGB, "mono8": cv2.COLOR_GRAY2RGB}
# The view reaches beyond what is measured, by this factor.
FARTHER = 1.01
# The greatest number of millimetres that a 16UC1 image holds.
MOST_MILLIMETRES = 65535


@device("libgazebo_ros_openni_kinect.so", "libgazebo_ros_depth_camera.so")
class DepthCamera(Camera):
    """Takes pictures and measures the distance of what each pixel shows, in the same frame.

    Depth is metric, along the optical axis and without noise, as Gazebo's. A pixel has none
    (NaN) where nothing is within pointCloudCutoff … pointCloudCutoffMax or where something
    nearer hides it. Picture, depth and points are of one moment and one geometry; each is
    worked out only while somebody wants it.

    Tags as in Gazebo, besides the camera's: depthImageTopicName (depth/image_raw),
    depthImageCameraInfoTopicName (depth/camera_info), pointCloudTopicName (points),
    pointCloudCutoff (0.4 m), pointCloudCutoffMax (5 m for openni_kinect, for depth_camera as far
    as the sensor sees) and useDepth16UC1Format (false). Normals and reflectance are not
    simulated.
    """

    sensors: ClassVar[Tuple[str, ...]] = ("depth",)

    def __init__(self, mount: Mount):
        super().__init__(mount)
        self._closest, self._farthest = self._measured_range()
        self._in_millimetres = mount.boolean("useDepth16UC1Format", False)
        for tag in NOT_SIMULATED:
            mount.text(tag)
        self.depth = self.output("depthImageTopicName", "depth/image_raw", ImageSample)
        self.depth_info = self.output(
            "depthImageCameraInfoTopicName", "depth/camera_info", CameraInfoSample
        )
        self.points = self.output("pointCloudTopicName", "points", PointsSample)
        self.outputs = (*self.outputs, self.depth, self.depth_info, self.points)
        self._slopes: Optional[np.ndarray] = None

    def produce(self, step: int) -> None:
        """Send what is wanted of picture, depth, points and geometry."""
        image, depth, points = (o.wanted for o in (self.image, self.depth, self.points))
        picture = self.take(step) if image or points else None
        depths = self.measure() if depth or points else None
        if image:
            self.send_picture(step, picture)
        if depth:
            self.depth.send(self._depth_image(step, depths))
        if points:
            colours = self._coloured(picture)
            self.points.send(PointsSample(step, self.frame, self.points_at(depths), colours))
        self.send_geometry(step, self.info)
        self.send_geometry(step, self.depth_info)

    def measure(self) -> np.ndarray:
        """Return the distances along the optical axis, (height, width) float32 in m, or NaN.

        Raises:
            LabError: something in the world cannot be drawn.
        """
        shot = Shot(self.lens.ideal, self.near, FARTHER * self._farthest)
        depths = self.mount.renderer().depths(self.pose(), shot)
        depths[(depths <= self._closest) | (depths >= self._farthest)] = np.nan
        return self.lens.pick(depths)

    def points_at(self, depths: np.ndarray) -> np.ndarray:
        """Return the points of the optical frame (m) at each pixel's depth, (h, w, 3) float32."""
        if self._slopes is None:
            self._slopes = self.lens.slopes()
        x, y = self._slopes
        return np.dstack((x * depths, y * depths, depths))

    def _depth_image(self, step: int, depths: np.ndarray) -> ImageSample:
        if not self._in_millimetres:
            return ImageSample(step, self.frame, "32FC1", depths)
        # 0 is for what has no depth, in this format.
        whole = np.nan_to_num(np.rint(1e3 * depths), nan=0.0)
        pixels = np.where(whole > MOST_MILLIMETRES, 0, whole).astype(np.uint16)
        return ImageSample(step, self.frame, "16UC1", pixels)

    def _coloured(self, picture: np.ndarray) -> np.ndarray:
        code = TO_RGB.get(self.encoding)
        return picture if code is None else cv2.cvtColor(picture, code)

    def _measured_range(self) -> Tuple[float, float]:
        """Return between which distances along the view (m) depth is measured."""
        mount = self.mount
        is_kinect = mount.plugin.filename.startswith(KINECT)
        closest = max(self.near, mount.number("pointCloudCutoff", 0.4))
        default = KINECTS_CUTOFF if is_kinect else self.far
        farthest = min(self.far, mount.number("pointCloudCutoffMax", default))
        if not closest < farthest:
            raise DeviceError(
                f"{mount.where('pointCloudCutoff')}: nothing is between {closest:g} m and "
                f"{farthest:g} m"
            )
        return closest, farthest
