"""Cameras that see what the simulation draws, and how far away it is.

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
# The table of noise is drawn by the generator of a step that never comes.
TABLE_STEP = 2**63
# Gazebo lets these say another geometry than that of the picture.
GEOMETRY_TAGS = ("CxPrime", "Cx", "Cy", "focalLength")
KINECT = "libgazebo_ros_openni_kinect"
KINECTS_CUTOFF = 5.0
# What is published beside points only where somebody has asked Gazebo for it, and not here.
NOT_SIMULATED = ("reduceNormals", "normalsTopicName", "reflectanceTopicName")
TO_RGB = {"bgr8": cv2.COLOR_BGR2RGB, "mono8": cv2.COLOR_GRAY2RGB}
# The view reaches beyond what is measured, by this factor.
FARTHER = 1.01
# Times white, up to which a lens that blurs is told how bright it is.
BRIGHTEST = 4.0
# The greatest number of millimetres that a 16UC1 image holds.
MOST_MILLIMETRES = 65535


class Camera(Plugin):
    """Takes pictures along the x axis of its link, the link's z axis upwards.

    The picture is drawn only while somebody wants it; camera_info tells the geometry that it
    really has, with the principal point in the middle and the lens's distortion, which is
    simulated. `settings` may be changed at any time, the rate by `set_rate`.

    Attributes:
        name: stands before its topics, if it is not empty.
        calibration: what somebody has set of camera_info, by the names of its fields.
    """

    filenames = ("libgazebo_ros_camera.so",)
    named_by_model = (False, True)
    sensors: ClassVar[Tuple[str, ...]] = ("camera",)
    # Of the topics of pictures, where the plugin names none.
    prefix: ClassVar[str] = ""

    def __init__(self, mount: Mount):
        super().__init__(mount)
        tag = SensorTag(mount, self.sensors)
        self._place = tag.place()
        self.lens = Lens(_geometry(mount, tag))
        if self.lens.black:
            where, share = tag.where("camera/distortion"), f"{100.0 * self.lens.black:.0f} %"
            LOG.warning("%s: where it shows nothing the picture is black: %s of it", where, share)
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
            # The slower of the two; 0 means the other.
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
        """Return an output on the topic in a tag, which is below the camera's name."""
        return Output(self.topic(self.mount.text(tag, default)), kind)

    def topic(self, name: str) -> str:
        """Return the full name of what is called so below the camera's name, if it has one."""
        below = self.name and not name.startswith("/")
        return self.mount.topic(f"{self.name}/{name}" if below else name)

    def produce(self, step: int) -> None:
        if self.image.wanted:
            self.image.send(ImageSample(step, self.frame, self.encoding, self.take(step)))
        self.send_geometry(step, self.info)

    def send_geometry(self, step: int, output: Output) -> None:
        """Send the geometry of the picture, if somebody wants it there."""
        if output.wanted:
            sample = CameraInfoSample(
                step, self.frame, self.camera, self._baseline, self.calibration
            )
            output.send(sample)

    def take(self, step: int) -> np.ndarray:
        """Return the picture of this moment, (height, width, 3) or, in grey, (height, width) uint8.

        Noise follows from the step. Raises LabError where something cannot be drawn.
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
        """Return the picture before a lens; where that blurs, what is brighter than white as well.

        A lens blurs the light before the sensor cuts it off.
        """
        renderer, exposure, shot = self.mount.renderer(), self.settings.exposure, self._shot()
        picture = renderer.picture(self.pose(), shot, exposure)
        if not self.settings.blur or not (picture == WHITE).any():
            return picture
        light = BRIGHTEST * renderer.picture(self.pose(), shot, exposure / BRIGHTEST)
        # Beside white a part of a pixel was cut off; elsewhere it differs by how it was rounded.
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
            LOG.warning("%s is passed over: the picture has its own", mount.where(name))
    focal = 0.5 * width / math.tan(0.5 * fov)
    centre = (0.5 * (width - 1), 0.5 * (height - 1))
    return PinholeCamera(width, height, focal, focal, *centre, _distortion(mount, tag))


def _distortion(mount: Mount, tag: SensorTag) -> Tuple[float, ...]:
    """Return k1, k2, p1, p2, k3: Gazebo bends by the sensor's and tells the plugin's."""
    told = tuple(mount.number(f"distortion{key}", 0.0) for key in DISTORTION_TAGS)
    bent = tuple(tag.number(f"camera/distortion/{key}", 0.0) for key in DISTORTION_TAGS.values())
    if any(told) and any(bent) and told != bent:
        where = mount.where("distortionK1")
        raise PluginError(f"{where}: other coefficients than those of the sensor")
    return told if any(told) else bent


def _settings(mount: Mount, tag: SensorTag) -> CameraSettings:
    told = {key: mount.number(key, getattr(CameraSettings, key)) for key in ("exposure", "blur")}
    kind = tag.text("camera/noise/type", "gaussian")
    if tag.has("camera/noise") and kind == "gaussian":
        for key in ("mean", "stddev"):
            told[f"noise_{key}"] = tag.number(f"camera/noise/{key}", 0.0)
    elif tag.has("camera/noise") and kind != "none":
        raise PluginError(f"{tag.where('camera/noise/type')}: '{kind}' is not gaussian or none")
    # How many samples a pixel gets: the plugin's own tag, or SDF's `<anti_aliasing>`.
    asked = tag.number("camera/image/anti_aliasing", CameraSettings.samples)
    default = max(number for number in SAMPLES if number <= max(asked, SAMPLES[0]))
    samples = mount.number("samples", default)
    # What is no whole number is refused as what is not among SAMPLES.
    told["samples"] = int(samples) if samples == round(samples) else samples
    return CameraSettings(**told)


class DepthCamera(Camera):
    """Takes pictures and measures the distance of what each pixel shows, in the same frame.

    Depth is metric, along the optical axis and without noise, as Gazebo's. A pixel has none
    (NaN) where nothing is within pointCloudCutoff … pointCloudCutoffMax or where something
    nearer hides it. Picture, depth and points are of one moment and one geometry; each is
    worked out only while somebody wants it.
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
        # 0 is for what has no depth, in this format. What is left of a millimetre is cut off, as
        # in Gazebo.
        whole = np.nan_to_num(np.floor(1e3 * depths.astype(float)), nan=0.0)
        pixels = np.where(whole > MOST_MILLIMETRES, 0, whole).astype(np.uint16)
        return ImageSample(step, self.frame, "16UC1", pixels)

    def _measured_range(self) -> Tuple[float, float]:
        """Return between which distances along the view (m) depth is measured."""
        mount = self.mount
        is_kinect = mount.plugin.filename.startswith(KINECT)
        closest = max(self.near, mount.number("pointCloudCutoff", 0.4))
        default = KINECTS_CUTOFF if is_kinect else self.far
        farthest = min(self.far, mount.number("pointCloudCutoffMax", default))
        if not closest < farthest:
            where = mount.where("pointCloudCutoff")
            raise PluginError(f"{where}: nothing is between {closest:g} m and {farthest:g} m")
        return closest, farthest
