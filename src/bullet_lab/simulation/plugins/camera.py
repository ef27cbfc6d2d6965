"""Cameras: pictures of the simulation, and depth.

libgazebo_ros_camera.so, libgazebo_ros_openni_kinect.so and libgazebo_ros_depth_camera.so.
"""

from __future__ import annotations

import logging
import math
from typing import Any, ClassVar, Mapping, Optional, Tuple

import cv2
import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose
from bullet_lab.core.schedule import Schedule, ScheduleError
from bullet_lab.simulation.plugins.plugin import Mount, Output, Plugin, PluginError, SensorTag
from bullet_lab.simulation.plugins.samples import CameraInfoSample, ImageSample, PointsSample
from bullet_lab.simulation.rendering.finish import (
    WHITE,
    CameraSettings,
    Lens,
    SensorNoise,
    blurred,
)
from bullet_lab.simulation.rendering.graphics import SAMPLES
from bullet_lab.simulation.rendering.renderer import Shot

LOG = logging.getLogger(__name__)

ENCODINGS = {"R8G8B8": "rgb8", "B8G8R8": "bgr8", "L8": "mono8"}
LARGEST_SIDE = 8192
DEFAULT_RATE = 30.0
DISTORTION_TAGS = {"K1": "k1", "K2": "k2", "T1": "p1", "T2": "p2", "K3": "k3"}
# The step of the generator that draws the table of noise; simulated time never reaches it.
TABLE_STEP = 2**63
# Tags that in Gazebo may contradict the geometry of the picture.
GEOMETRY_TAGS = ("CxPrime", "Cx", "Cy", "focalLength")
KINECT = "libgazebo_ros_openni_kinect"
KINECTS_CUTOFF = 5.0
# Tags of Gazebo's optional normals and reflectance, which are not simulated.
NOT_SIMULATED = ("reduceNormals", "normalsTopicName", "reflectanceTopicName")
TO_RGB = {"bgr8": cv2.COLOR_BGR2RGB, "mono8": cv2.COLOR_GRAY2RGB}
# The view reaches this much farther than what is measured.
FARTHER = 1.01
# Brightness, in units of white, up to which light enters a lens that blurs.
BRIGHTEST = 4.0
# The greatest number of millimetres that a 16UC1 image holds.
MOST_MILLIMETRES = 65535


class Camera(Plugin):
    """Takes pictures along the x axis of its link, with the link's z axis upwards.

    A picture is drawn only if it has a listener. camera_info has the true geometry of the
    picture: the principal point is in the middle, and the distortion of the lens is simulated.
    `settings` may be changed at any time, the rate by `set_rate`.

    Attributes:
        name: namespace of its topics; may be empty.
        calibration: fields of camera_info that were set from outside, by name.
    """

    filenames = ("libgazebo_ros_camera.so",)
    named_by_model = (False, True)
    sensors: ClassVar[Tuple[str, ...]] = ("camera",)
    # Prefix of the picture's default topics.
    prefix: ClassVar[str] = ""

    def __init__(self, mount: Mount):
        super().__init__(mount)
        tag = SensorTag(mount, self.sensors)
        self._place = tag.place()
        self.lens = Lens(_geometry(mount, tag))
        if self.lens.black:
            where, share = tag.where("camera/distortion"), 100.0 * self.lens.black
            LOG.warning("%s: %.0f %% of the picture is black: outside of the lens", where, share)
        self.near = tag.number("camera/clip/near", 0.1)
        self.far = tag.number("camera/clip/far", 100.0)
        self.encoding = ENCODINGS[tag.choice("camera/image/format", tuple(ENCODINGS))]
        self.settings = _settings(mount, tag)
        self._shot()
        self._baseline = mount.number("hackBaseline", 0.0)
        self.frame = mount.frame(mount.text("frameName", mount.plugin.link))
        self._noise = mount.noise()
        self._table: Optional[Tuple[tuple, SensorNoise]] = None
        self.name = mount.text("cameraName")
        self.calibration: Mapping[str, Any] = {}
        self.image = self.output("imageTopicName", f"{self.prefix}image_raw", ImageSample)
        self.info = self.output(
            "cameraInfoTopicName", f"{self.prefix}camera_info", CameraInfoSample
        )
        self.outputs = (self.image, self.info)
        rates = (tag.number("update_rate", 0.0), mount.number("updateRate", 0.0))
        given = [rate for rate in rates if rate != 0.0]
        try:
            # The slower of the two; 0 stands for the other one.
            self.schedule = Schedule(min(given, default=DEFAULT_RATE))
        except ScheduleError as error:
            raise PluginError(f"{mount.where('updateRate')}: {error}") from error

    @property
    def camera(self) -> PinholeCamera:
        """Geometry of the picture."""
        return self.lens.camera

    def set_rate(self, rate: float, step: int) -> None:
        """Take `rate` pictures per second, counted from a step on; raises ScheduleError."""
        self.schedule = Schedule(rate, step)

    def pose(self) -> Pose:
        """Return the camera's pose in the world: x ahead, z up."""
        return self._place.pose()

    def output(self, tag: str, default: str, kind: type) -> Output:
        """Return an output on the topic in a tag, in the camera's namespace."""
        return Output(self.topic(self.mount.text(tag, default)), kind)

    def topic(self, name: str) -> str:
        """Return the full name of a topic in the camera's namespace."""
        below = self.name and not name.startswith("/")
        return self.mount.topic(f"{self.name}/{name}" if below else name)

    def produce(self, step: int) -> None:
        if self.image.wanted:
            self.image.send(ImageSample(step, self.frame, self.encoding, self.take(step)))
        self.send_geometry(step, self.info)

    def send_geometry(self, step: int, output: Output) -> None:
        """Send the geometry of the picture, if the output has a listener."""
        if output.wanted:
            sample = CameraInfoSample(
                step, self.frame, self.camera, self._baseline, self.calibration
            )
            output.send(sample)

    def take(self, step: int) -> np.ndarray:
        """Return the present picture, (height, width, 3) or, in grey, (height, width) uint8.

        Noise depends on the step. Raises LabError if something cannot be drawn.
        """
        settings = self.settings
        picture = blurred(self.lens.bend(self._picture()), settings.blur)
        if self.encoding == "bgr8":
            picture = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
        elif self.encoding == "mono8":
            picture = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
        if settings.noise_mean or settings.noise_stddev:
            picture = self._noisy(picture, step)
        return picture

    def _picture(self) -> np.ndarray:
        """Return the picture before the lens; if that blurs, with values brighter than white.

        A lens blurs the light before the sensor clips it.
        """
        renderer, exposure, shot = self.mount.renderer(), self.settings.exposure, self._shot()
        picture = renderer.picture(self.pose(), shot, exposure)
        if not self.settings.blur or not (picture == WHITE).any():
            return picture
        light = BRIGHTEST * renderer.picture(self.pose(), shot, exposure / BRIGHTEST)
        # Near white, a part of the pixel was clipped; elsewhere, the two differ by rounding.
        return np.where(light > picture + BRIGHTEST, light, picture).astype(np.float32)

    def _shot(self) -> Shot:
        return Shot(self.lens.ideal, self.near, self.far, self.settings.samples)

    def _noisy(self, picture: np.ndarray, step: int) -> np.ndarray:
        key = (self.settings.noise_mean, self.settings.noise_stddev)
        if self._table is None or self._table[0] != key:
            table = SensorNoise(*key, picture.size, self._noise.at(TABLE_STEP))
            self._table = (key, table)
        return self._table[1].add_to(picture, self._noise.at(step))


def _geometry(mount: Mount, tag: SensorTag) -> PinholeCamera:
    width = tag.count("camera/image/width", 320, LARGEST_SIDE)
    height = tag.count("camera/image/height", 240, LARGEST_SIDE)
    fov = tag.number("camera/horizontal_fov", 1.047)
    if not 0.0 < fov < math.pi:
        raise PluginError(f"{tag.where('camera/horizontal_fov')}: {fov:g} is not within 0 … pi")
    for name in GEOMETRY_TAGS:
        if mount.number(name, 0.0) != 0.0:
            LOG.warning("%s is ignored; the value is taken from the image", mount.where(name))
    focal = 0.5 * width / math.tan(0.5 * fov)
    centre = (0.5 * (width - 1), 0.5 * (height - 1))
    return PinholeCamera(width, height, focal, focal, *centre, _distortion(mount, tag))


def _distortion(mount: Mount, tag: SensorTag) -> Tuple[float, ...]:
    """Return k1, k2, p1, p2, k3, of the plugin's tags or the sensor's.

    Gazebo draws with the sensor's and publishes the plugin's.
    """
    plugin = tuple(mount.number(f"distortion{key}", 0.0) for key in DISTORTION_TAGS)
    sensor = tuple(tag.number(f"camera/distortion/{key}", 0.0) for key in DISTORTION_TAGS.values())
    if any(plugin) and any(sensor) and plugin != sensor:
        where = mount.where("distortionK1")
        raise PluginError(f"{where}: the coefficients differ from those of the sensor")
    return plugin if any(plugin) else sensor


def _settings(mount: Mount, tag: SensorTag) -> CameraSettings:
    given = {key: mount.number(key, getattr(CameraSettings, key)) for key in ("exposure", "blur")}
    kind = tag.text("camera/noise/type", "gaussian")
    if tag.has("camera/noise") and kind == "gaussian":
        for key in ("mean", "stddev"):
            given[f"noise_{key}"] = tag.number(f"camera/noise/{key}", 0.0)
    elif tag.has("camera/noise") and kind != "none":
        raise PluginError(f"{tag.where('camera/noise/type')}: '{kind}' is not gaussian or none")
    # Samples of each pixel: the plugin's own tag, or SDF's `<anti_aliasing>`.
    asked = tag.number("camera/image/anti_aliasing", CameraSettings.samples)
    default = max(number for number in SAMPLES if number <= max(asked, SAMPLES[0]))
    samples = mount.number("samples", default)
    # `CameraSettings` refuses all numbers that are not among SAMPLES.
    given["samples"] = int(samples) if samples == round(samples) else samples
    return CameraSettings(**given)


class DepthCamera(Camera):
    """Takes pictures, and measures the depth of each pixel.

    Depth is in metres along the optical axis and without noise, as in Gazebo. A pixel has none
    (NaN) if the first surface that it shows is not within pointCloudCutoff …
    pointCloudCutoffMax. Picture, depth and points are of one moment and one geometry; each is
    computed only if it has a listener.
    """

    filenames = ("libgazebo_ros_openni_kinect.so", "libgazebo_ros_depth_camera.so")
    sensors: ClassVar[Tuple[str, ...]] = ("depth",)
    prefix = "ir/"

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
        image, depth, points = (o.wanted for o in (self.image, self.depth, self.points))
        picture = self.take(step) if image or points else None
        depths = self.measure() if depth or points else None
        if image:
            self.image.send(ImageSample(step, self.frame, self.encoding, picture))
        if depth:
            self.depth.send(self._depth_image(step, depths))
        if points:
            code = TO_RGB.get(self.encoding)
            colours = picture if code is None else cv2.cvtColor(picture, code)
            self.points.send(PointsSample(step, self.frame, self.points_at(depths), colours))
        self.send_geometry(step, self.info)
        self.send_geometry(step, self.depth_info)

    def measure(self) -> np.ndarray:
        """Return distances along the optical axis, (height, width) float32 in m, or NaN."""
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
        # In this format, 0 means no depth. Millimetres are rounded down, as in Gazebo.
        whole = np.nan_to_num(np.floor(1e3 * depths.astype(float)), nan=0.0)
        pixels = np.where(whole > MOST_MILLIMETRES, 0, whole).astype(np.uint16)
        return ImageSample(step, self.frame, "16UC1", pixels)

    def _measured_range(self) -> Tuple[float, float]:
        """Return the least and the greatest depth that is measured, in m."""
        mount = self.mount
        is_kinect = mount.plugin.filename.startswith(KINECT)
        closest = max(self.near, mount.number("pointCloudCutoff", 0.4))
        default = KINECTS_CUTOFF if is_kinect else self.far
        farthest = min(self.far, mount.number("pointCloudCutoffMax", default))
        if not closest < farthest:
            where = mount.where("pointCloudCutoff")
            problem = f"the least depth, {closest:g} m, is not below the greatest, {farthest:g} m"
            raise PluginError(f"{where}: {problem}")
        return closest, farthest
