"""What sensors offer beside their topics: compressed pictures, calibration, settings.

Below a camera's name: set_camera_info, and set_parameters of dynamic_reconfigure (imager_rate);
below the topic of its pictures: compressed, as image_transport sends it, with the parameters of
compressed_image_transport. A picture is compressed only while somebody listens.
"""

from __future__ import annotations

import contextlib
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Callable, Dict, List

import rospy
from sensor_msgs.msg import CompressedImage
from sensor_msgs.srv import SetCameraInfo, SetCameraInfoResponse
from std_srvs.srv import Empty, EmptyResponse

from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.bridge.stepper import StepperError
from bullet_lab.ros.gazebo.reconfigure import Reconfigurable, Setting, Values
from bullet_lab.ros.messages.conversions import compressed_message
from bullet_lab.ros.node.node import MASTER_ERRORS
from bullet_lab.simulation.plugins import Plugin
from bullet_lab.simulation.plugins.camera import Camera, DepthCamera
from bullet_lab.simulation.plugins.motion_sensors import Imu
from bullet_lab.simulation.plugins.samples import ImageSample

# Those of compressed_image_transport, but what restarts a JPEG.
COMPRESSION = (
    Setting("format", "jpeg", "how pictures are compressed", choices=("jpeg", "png")),
    Setting("jpeg_quality", 80, "of a JPEG, in percent", 1, 100),
    Setting("jpeg_progressive", False, "JPEGs that are seen before they are whole"),
    Setting("jpeg_optimize", False, "smaller JPEGs, in more time"),
    Setting("png_level", 9, "of a PNG: 1 is fast, 9 is small", 1, 9),
)
# Hz.
LEAST_RATE, GREATEST_RATE = 1.0, 50.0
# What set_camera_info changes.
CALIBRATED = ("height", "width", "distortion_model", "D", "K", "R", "P", "binning_x", "binning_y")

# Of the distortion models that OpenCV knows, the largest has 14; characters of a model's name.
MOST_COEFFICIENTS, LONGEST_NAME = 14, 100


class CompressedPictures:
    """The compressed pictures of one camera. Belongs to the thread that steps the simulation."""

    def __init__(self, world: RunningWorld, camera: Camera):
        self.topic = f"{camera.image.topic}/compressed"
        self.settings: Values = {setting.name: setting.default for setting in COMPRESSION}
        self._publisher = world.topics.publisher(self.topic, CompressedImage)
        camera.image.connect(self._publish, self._publisher.has_connections)

    def set(self, values: Values) -> Values:
        """Compress differently from now on; return what holds."""
        formats = COMPRESSION[0].choices
        known = {setting.name: values[setting.name] for setting in COMPRESSION}
        if known["format"] not in formats:
            known["format"] = self.settings["format"]
        self.settings = known
        return known

    def _publish(self, sample: ImageSample) -> None:
        if self._publisher.has_connections():
            self._publisher.publish(compressed_message(sample, self.settings))


@dataclass
class _Offered:
    """What a sensor offers: a topic, if any, and what can be shut down."""

    topic: str
    services: List[Any] = field(default_factory=list)


class SensorServices:
    """Offers what the sensors of all models have beside their topics, while they are there."""

    def __init__(self, world: RunningWorld):
        self._world = world
        self._offered: Dict[str, List[_Offered]] = {}
        # Asking the master for each of them would hold the simulation up.
        self._clerk = ThreadPoolExecutor(1)
        self._offers = {Camera: self._offer, DepthCamera: self._offer, Imu: self._offer_calibration}
        world.changed.append(self._changed)
        self._changed("")

    def _changed(self, name: str) -> None:
        """Follow a model that has come or gone, or all with an empty name."""
        for model in [name] if name else {*self._world.models, *self._offered}:
            instance = self._world.models.get(model)
            sensors = [p for p in (instance.plugins if instance else ()) if type(p) in self._offers]
            if sensors and model not in self._offered:
                self._offered[model] = [self._offers[type(sensor)](sensor) for sensor in sensors]
            elif not sensors and model in self._offered:
                for offered in self._offered.pop(model):
                    if offered.topic:
                        self._world.topics.release(offered.topic)
                    self._clerk.submit(_shut_down, offered.services)

    def _offer(self, camera: Camera) -> _Offered:
        pictures = CompressedPictures(self._world, camera)
        offered = _Offered(pictures.topic)
        self._clerk.submit(self._register, camera, pictures, offered.services)
        return offered

    def _offer_calibration(self, imu: Imu) -> _Offered:
        offered = _Offered("")
        name = rospy.resolve_name(imu.service)
        offer = partial(rospy.Service, name, Empty, lambda _: EmptyResponse())
        self._clerk.submit(_take_up, [offer], offered.services, imu)
        return offered

    def _register(self, camera: Camera, pictures: CompressedPictures, services: List[Any]) -> None:
        service = rospy.resolve_name(camera.topic("set_camera_info"))
        space = service.rsplit("/", 1)[0]
        calibrate, change = partial(self._calibrate, camera), partial(self._set_rate, camera)
        offers = [
            partial(rospy.Service, service, SetCameraInfo, calibrate),
            partial(Reconfigurable, rospy.resolve_name(pictures.topic), COMPRESSION, pictures.set),
        ]
        if camera.name:
            offers.append(partial(Reconfigurable, space, [_rate_of(camera)], change))
        _take_up(offers, services, camera)

    def _calibrate(self, camera: Camera, request: Any) -> SetCameraInfoResponse:
        told = {name: getattr(request.camera_info, name) for name in CALIBRATED}
        wrong = wrong_calibration(told)
        if wrong:
            return SetCameraInfoResponse(False, wrong)

        def change() -> None:
            camera.calibration = told

        try:
            self._world.do(change)
        except StepperError as error:
            return SetCameraInfoResponse(False, str(error))
        return SetCameraInfoResponse(True, "")

    def _set_rate(self, camera: Camera, values: Values) -> Values:
        rate = values["imager_rate"]
        with contextlib.suppress(StepperError):
            self._world.do(lambda: camera.set_rate(rate, self._world.simulation.step))
        return values


def wrong_calibration(told: Dict[str, Any]) -> str:
    """Return what is wrong with a calibration of set_camera_info; empty where nothing is."""
    for name in "DKRP":
        if not all(map(math.isfinite, told[name])):
            return f"{name} has a number that is not finite"
    if len(told["D"]) > MOST_COEFFICIENTS:
        return f"D has {len(told['D'])} coefficients; at most {MOST_COEFFICIENTS} are allowed"
    if len(told["distortion_model"]) > LONGEST_NAME:
        return f"distortion_model has more than {LONGEST_NAME} characters"
    return ""


def _rate_of(camera: Camera) -> Setting:
    default = min(max(1.0 / camera.schedule.period, LEAST_RATE), GREATEST_RATE)
    return Setting(
        "imager_rate", default, "pictures per simulated second", LEAST_RATE, GREATEST_RATE
    )


def _take_up(offers: List[Callable[[], Any]], services: List[Any], sensor: Plugin) -> None:
    for offer in offers:
        try:
            services.append(offer())
        except (rospy.ServiceException, *MASTER_ERRORS) as error:
            # Two sensors without a name of their own want the same services.
            if not rospy.is_shutdown():
                rospy.logwarn("sensor '%s': %s", sensor.mount.plugin.name, error)


def _shut_down(services: List[Any]) -> None:
    for service in services:
        service.shutdown()
