"""Cameras: pictures of the simulation with the errors of lens and sensor, and depth.

libgazebo_ros_camera.so, libgazebo_ros_openni_kinect.so, libgazebo_ros_depth_camera.so, and those of
pairs of cameras and pictures on demand: libgazebo_ros_multicamera.so,
libgazebo_ros_triggered_camera.so and libgazebo_ros_triggered_multicamera.so.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from dataclasses import astuple, dataclass, replace
from typing import Any, Mapping
from xml.etree.ElementTree import Element

import cv2
import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose
from bullet_lab.core.schedule import Schedule, ScheduleError
from bullet_lab.simulation.plugins import Mount, Output, Plugin, PluginError, SensorTag
from bullet_lab.simulation.plugins.lenses import WHITE, Lens, SensorNoise, WideLens, blurred
from bullet_lab.simulation.plugins.samples import (
    CameraInfoSample,
    ImageSample,
    PointsSample,
    Trigger,
)
from bullet_lab.simulation.rendering import SAMPLES, RendererError
from bullet_lab.simulation.rendering.renderer import Shot, centred_camera
from bullet_lab.simulation.world.description import PluginTag

LOG = logging.getLogger(__name__)

# The encodings of the formats of 8 bits, and of those that depth cameras do not have.
PLAIN = {
    "R8G8B8": "rgb8",
    "B8G8R8": "bgr8",
    "L8": "mono8",
    "RGB_INT8": "rgb8",
    "BGR_INT8": "bgr8",
    "L_INT8": "mono8",
}
BAYER = "bayer_"
ENCODINGS = {
    **PLAIN,
    "L16": "mono16",
    "L_INT16": "mono16",
    "R16G16B16": "rgb16",
    "RGB_INT16": "rgb16",
    **{f"BAYER_{p}8": f"{BAYER}{p.lower()}8" for p in ("RGGB", "BGGR", "GBRG", "GRBG")},
}
# From 8 to 16 bits.
TO_16 = 257
WIDE = "wideanglecamera"
LARGEST_SIDE = 8192
# px; OpenCV fails with much more.
MOST_BLUR = 1000.0
# Hz.
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
# Triggers that wait for their picture; more are dropped.
MOST_REQUESTS = 100


@dataclass(frozen=True)
class CameraSettings:
    """Settings of a camera that may change between pictures.

    A pixel has 1, 2 or 4 samples. `exposure` is a factor of the brightness, `blur` a standard
    deviation in pixels. Noise of each pixel and colour is a share of white.
    """

    samples: int = 1
    exposure: float = 1.0
    blur: float = 0.0
    noise_mean: float = 0.0
    noise_stddev: float = 0.0

    def __post_init__(self) -> None:
        """Raise RendererError for a number that is not finite or out of its range."""
        if not all(map(math.isfinite, astuple(self))):
            raise RendererError("a camera setting is not finite")
        if min(self.exposure, self.blur, self.noise_stddev) < 0.0:
            raise RendererError("exposure, blur and noise_stddev must not be negative")
        if self.blur > MOST_BLUR:
            raise RendererError(f"blur is {self.blur:g} px; at most {MOST_BLUR:g} are allowed")
        if abs(self.noise_mean) > 1.0 or self.noise_stddev > 1.0:
            raise RendererError("noise is a share of white; at most 1 is allowed")


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
    sensors = ("camera", WIDE)
    encodings = ENCODINGS
    # Prefix of the picture's default topics.
    prefix = ""

    def __init__(self, mount: Mount):
        super().__init__(mount)
        tag = SensorTag(mount, self.sensors)
        offset = tag.numbers("camera/pose", 6, "0 0 0 0 0 0")
        self._place = tag.place(Pose.from_rpy(offset[:3], offset[3:]))
        self.lens = _lens(mount, tag)
        if self.lens.black:
            where, share = tag.where("camera/distortion"), 100.0 * self.lens.black
            LOG.warning("%s: %.0f %% of the picture is black: outside of the lens", where, share)
        self.near = tag.number("camera/clip/near", 0.1)
        self.far = tag.number("camera/clip/far", 100.0)
        self.encoding = self.encodings[tag.choice("camera/image/format", tuple(self.encodings))]
        self.settings = _settings(mount, tag)
        self._shot()
        self._baseline = mount.number("hackBaseline")
        self.frame = mount.frame(mount.text("frameName", mount.plugin.link))
        self._noise = mount.noise()
        self._table: SensorNoise | None = None
        self.name = mount.text("cameraName")
        self.calibration: Mapping[str, Any] = {}
        self.image = self._output("imageTopicName", f"{self.prefix}image_raw", ImageSample)
        info = f"{self.prefix}camera_info"
        self.info = self._output("cameraInfoTopicName", info, CameraInfoSample)
        rates = (tag.number("update_rate"), mount.number("updateRate"))
        try:
            # The slower of the two; 0 stands for the other one.
            self.schedule = Schedule(min(filter(None, rates), default=DEFAULT_RATE))
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

    def _output(self, tag: str, default: str, kind: type) -> Output:
        """Return an output on the topic in a tag."""
        return self.output(self.mount.text(tag, default), kind)

    def topic(self, name: str) -> str:
        """Return the full name of a topic, which is in the camera's namespace."""
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
        """Return the present picture, (height, width, 3) or, without colours, (height, width).

        Noise depends on the step. Raises LabError if something cannot be drawn.
        """
        picture = self._with_noise(step, self._coloured(self.lens.picture(self._picture)))
        return picture * np.uint16(TO_16) if "16" in self.encoding else picture

    def _coloured(self, picture: np.ndarray) -> np.ndarray:
        """Return a picture in the colours of the encoding, with 8 bits each."""
        picture = blurred(picture, self.settings.blur)
        if self.encoding == "bgr8":
            return cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
        if self.encoding.startswith("mono"):
            return cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
        if not self.encoding.startswith(BAYER):
            return picture
        mosaic = np.empty(picture.shape[:2], np.uint8)
        for place, colour in enumerate(self.encoding[len(BAYER) : -1]):
            row, column = divmod(place, 2)
            mosaic[row::2, column::2] = picture[row::2, column::2, "rgb".index(colour)]
        return mosaic

    def _with_noise(self, step: int, picture: np.ndarray) -> np.ndarray:
        key = (self.settings.noise_mean, self.settings.noise_stddev)
        if not any(key):
            return picture
        if self._table is None or self._table.key != key:
            self._table = SensorNoise(*key, picture.size, self._noise.at(TABLE_STEP))
        return self._table.add_to(picture, self._noise.at(step))

    def _picture(self, turn: Pose) -> np.ndarray:
        """Return a picture before the lens; if that blurs, with values brighter than white.

        A lens blurs the light before the sensor clips it.
        """
        draw, exposure = self.mount.simulation.renderer().picture, self.settings.exposure
        pose = self.pose() * turn
        picture = draw(pose, self._shot(), exposure)
        white = picture == WHITE
        if not self.settings.blur or not white.any():
            return picture
        part = slice(None), slice(None)
        if self.settings.samples == 1:
            part = _span(white.any(axis=(1, 2))), _span(white.any(axis=0).any(axis=1))
        darker = draw(pose, self._shot(), exposure / BRIGHTEST, part)
        picture, light = picture.astype(np.float32), darker.astype(np.float32) * BRIGHTEST
        # Samples of a grey pixel may be white, too. Elsewhere, the two differ by rounding.
        is_brighter = light > picture[part] + BRIGHTEST
        picture[part] = np.maximum(picture[part], light * is_brighter)
        return picture

    def _shot(self) -> Shot:
        return Shot(self.lens.ideal, self.near, self.far, self.settings.samples)


def _span(line: np.ndarray) -> slice:
    """Return the slice from the first to the last true value."""
    places = np.flatnonzero(line)
    return slice(places[0], places[-1] + 1)


def _lens(mount: Mount, tag: SensorTag) -> Lens:
    width = tag.count("camera/image/width", 320, LARGEST_SIDE)
    height = tag.count("camera/image/height", 240, LARGEST_SIDE)
    fov = tag.number("camera/horizontal_fov", 1.047)
    is_wide = tag.element.get("type") == WIDE
    if not (0.0 < fov < math.pi or is_wide and fov <= 2.0 * math.pi + 1e-3):
        allowed = "0 … 2 pi" if is_wide else "0 … pi"
        raise PluginError(f"{tag.where('camera/horizontal_fov')}: {fov:g} is not within {allowed}")
    for name in GEOMETRY_TAGS:
        if mount.number(name) != 0.0:
            LOG.warning("%s is ignored; the value is taken from the image", mount.where(name))
    # Gazebo draws with the sensor's distortion and publishes the plugin's.
    own = tuple(mount.number(f"distortion{key}") for key in DISTORTION_TAGS)
    other = tuple(tag.number(f"camera/distortion/{key}") for key in DISTORTION_TAGS.values())
    if any(own) and any(other) and own != other:
        where = mount.where("distortionK1")
        raise PluginError(f"{where}: the coefficients differ from those of the sensor")
    if is_wide:
        return WideLens(tag, width, height, fov)
    camera = centred_camera(width, height, fov)
    return Lens(replace(camera, distortion=own if any(own) else other))


def _settings(mount: Mount, tag: SensorTag) -> CameraSettings:
    given = {key: mount.number(key, getattr(CameraSettings, key)) for key in ("exposure", "blur")}
    kind = tag.text("camera/noise/type", "gaussian")
    if kind == "gaussian":
        for key in ("mean", "stddev"):
            given[f"noise_{key}"] = tag.number(f"camera/noise/{key}")
    elif kind != "none":
        raise PluginError(f"{tag.where('camera/noise/type')}: '{kind}' is not gaussian or none")
    # Samples of each pixel: the plugin's own tag, or SDF's `<anti_aliasing>`.
    asked = tag.number("camera/image/anti_aliasing", CameraSettings.samples)
    default = max(number for number in SAMPLES if number <= max(asked, SAMPLES[0]))
    samples = mount.number("samples", default)
    # `Shot` refuses all numbers that are not among SAMPLES.
    return CameraSettings(int(samples) if samples in SAMPLES else samples, **given)


class DepthCamera(Camera):
    """Takes pictures, and measures the depth of each pixel.

    Depth is in metres along the optical axis and without noise, as in Gazebo. A pixel has none
    (NaN) if the first surface that it shows is not within pointCloudCutoff …
    pointCloudCutoffMax. Picture, depth and points are of one moment and one geometry; each is
    computed only if it has a listener. As in Gazebo, depth_camera's points are in a single row, and
    nothing comes on its two topics of camera_info.
    """

    filenames = ("libgazebo_ros_openni_kinect.so", "libgazebo_ros_depth_camera.so")
    sensors = ("depth",)
    encodings = PLAIN
    prefix = "ir/"

    def __init__(self, mount: Mount):
        super().__init__(mount)
        self._is_kinect = mount.plugin.filename.startswith(KINECT)
        # The least and the greatest depth that is measured, in m.
        self._closest = max(self.near, mount.number("pointCloudCutoff", 0.4))
        default = KINECTS_CUTOFF if self._is_kinect else self.far
        self._farthest = min(self.far, mount.number("pointCloudCutoffMax", default))
        if self._closest >= self._farthest:
            limits = f"{self._closest:g} m, is not below the greatest, {self._farthest:g} m"
            where = mount.where("pointCloudCutoff")
            raise PluginError(f"{where}: the least depth, {limits}")
        self._in_millimetres = mount.boolean("useDepth16UC1Format", False)
        for tag in NOT_SIMULATED:
            mount.text(tag)
        self.depth = self._output("depthImageTopicName", "depth/image_raw", ImageSample)
        tag, info = "depthImageCameraInfoTopicName", "depth/camera_info"
        self.depth_info = self._output(tag, info, CameraInfoSample)
        self.points = self._output("pointCloudTopicName", "points", PointsSample)

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
            cloud = self.points_at(depths)
            if not self._is_kinect:
                cloud, colours = cloud.reshape(1, -1, 3), colours.reshape(1, -1, 3)
            self.points.send(PointsSample(step, self.frame, cloud, colours))
        if self._is_kinect:
            self.send_geometry(step, self.info)
            self.send_geometry(step, self.depth_info)

    def measure(self) -> np.ndarray:
        """Return distances along the optical axis, (height, width) float32 in m, or NaN."""
        shot = Shot(self.lens.ideal, self.near, FARTHER * self._farthest)
        depths = self.mount.simulation.renderer().depths(self.pose(), shot)
        depths[(depths <= self._closest) | (depths >= self._farthest)] = np.nan
        return self.lens.pick(depths)

    def points_at(self, depths: np.ndarray) -> np.ndarray:
        """Return the points of the optical frame (m) at each pixel's depth, (h, w, 3) float32."""
        x, y = self.lens.slopes
        return np.dstack((x * depths, y * depths, depths))

    def _depth_image(self, step: int, depths: np.ndarray) -> ImageSample:
        if not self._in_millimetres:
            return ImageSample(step, self.frame, "32FC1", depths)
        # In this format, 0 means no depth. Millimetres are rounded down, as in Gazebo.
        whole = np.floor(1e3 * depths.astype(float))
        pixels = np.where(whole <= MOST_MILLIMETRES, whole, 0).astype(np.uint16)
        return ImageSample(step, self.frame, "16UC1", pixels)


class MultiCamera(Camera):
    """One camera of a `<sensor type="multicamera">`.

    As in Gazebo, it has the namespace left or right below cameraName, by its own name.
    """

    filenames = ("libgazebo_ros_multicamera.so",)

    @classmethod
    def split(cls, tag: PluginTag) -> tuple[PluginTag, ...]:
        if tag.sensor is None or tag.sensor.get("type") != "multicamera":
            return (tag,)
        parts = []
        for camera in tag.sensor.findall("camera"):
            side = next((s for s in ("left", "right") if s in camera.get("name", "")), "")
            if not side:
                what = f"plugin '{tag.name}': camera '{camera.get('name')}' is left out"
                LOG.warning("%s: its name has neither left nor right", what)
                continue
            sensor = Element("sensor", type="camera", name=f"{tag.sensor.get('name', '')}_{side}")
            sensor.extend([one for one in tag.sensor if one.tag in ("update_rate", "pose")])
            sensor.append(camera)
            space = tag.tags.get("cameraName", "")
            tags = {**tag.tags, "cameraName": f"{space}/{side}" if space else side}
            if side == "left":
                # As in Gazebo, the baseline is that of the right camera.
                tags["hackBaseline"] = "0"
            names = {"name": f"{tag.name}_{side}", "tags": tags}
            parts.append(replace(tag, sensor=sensor, element=None, **names))
        return tuple(parts)


class OnDemand(Schedule):
    """Each step, to look for requests: as a rate of messages, none."""

    period = math.inf


class TriggeredCamera(Camera):
    """Takes a picture for each message on its topic of triggers, one in a step."""

    filenames = ("libgazebo_ros_triggered_camera.so",)

    def __init__(self, mount: Mount):
        super().__init__(mount)
        self.schedule = OnDemand(0.0)
        topic = mount.text("triggerTopicName", "image_trigger")
        # Filled by other threads.
        self._requests: deque[Trigger] = deque(maxlen=MOST_REQUESTS)
        self.input(topic, Trigger, self._requests.append)

    def reset(self, step: int) -> None:
        self._requests.clear()

    def set_rate(self, rate: float, step: int) -> None:
        """Do nothing: it has no rate."""

    def produce(self, step: int) -> None:
        if self._requests:
            self._requests.popleft()
            super().produce(step)


class TriggeredMultiCamera(MultiCamera, TriggeredCamera):
    """One camera of a `<sensor type="multicamera">`, with a trigger of its own."""

    filenames = ("libgazebo_ros_triggered_multicamera.so",)
