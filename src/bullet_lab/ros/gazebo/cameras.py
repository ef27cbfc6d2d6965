"""Services of sensors, and compressed images.

Below a camera's name: set_camera_info, and set_parameters of dynamic_reconfigure (imager_rate).
Below its image topic: `compressed`, as image_transport publishes it, with the parameters of
compressed_image_transport. An image is compressed only while somebody listens.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any, Callable, Dict, List

import rospy
from sensor_msgs.msg import CompressedImage
from sensor_msgs.srv import SetCameraInfo
from std_srvs.srv import Empty, EmptyResponse

from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.gazebo.physics import Reconfigurable, Values
from bullet_lab.ros.gazebo.services import offer
from bullet_lab.ros.messages.conversions import compressed_message
from bullet_lab.ros.messages.poses import InputError
from bullet_lab.ros.node.node import MASTER_ERRORS
from bullet_lab.simulation.models import ModelInstance
from bullet_lab.simulation.plugins.camera import Camera, DepthCamera
from bullet_lab.simulation.plugins.controllers.controller import Setting
from bullet_lab.simulation.plugins.motion_sensors import Imu
from bullet_lab.simulation.plugins.samples import ImageSample

# Those of compressed_image_transport, without the restart interval of a JPEG.
COMPRESSION = (
    Setting("format", "jpeg", "compression format", choices=("jpeg", "png")),
    Setting("jpeg_quality", 80, "quality of a JPEG, in percent", 1, 100),
    Setting("jpeg_progressive", False, "JPEGs that are seen before they are whole"),
    Setting("jpeg_optimize", False, "smaller JPEGs, in more time"),
    Setting("png_level", 9, "compression level of a PNG: 1 is fast, 9 is small", 1, 9),
)
# Hz.
LEAST_RATE = 1.0
GREATEST_RATE = 50.0
# The fields of CameraInfo that set_camera_info changes.
CALIBRATED = ("height", "width", "distortion_model", "D", "K", "R", "P", "binning_x", "binning_y")
# The largest of OpenCV's distortion models has 14 coefficients.
MOST_COEFFICIENTS = 14
# Characters of a distortion model's name.
LONGEST_NAME = 100


class CompressedImages:
    """The compressed images of one camera; for the thread of the simulation."""

    def __init__(self, world: RunningWorld, camera: Camera):
        self.topic = f"{camera.image.topic}/compressed"
        self._settings: Values = {setting.name: setting.default for setting in COMPRESSION}
        self._publisher = world.topics.publisher(self.topic, CompressedImage)
        camera.image.connect(self._publish, self._publisher.has_connections)

    def set(self, values: Values) -> Values:
        """Set the compression, and return the settings; raises InputError."""
        choices = COMPRESSION[0].choices
        if values["format"] not in choices:
            raise InputError(f"format is '{values['format']}'; known are {', '.join(choices)}")
        self._settings = values
        return values

    def _publish(self, sample: ImageSample) -> None:
        if self._publisher.has_connections():
            self._publisher.publish(compressed_message(sample, self._settings))


class SensorServices:
    """Offers the services of the cameras and IMUs of all models, as models come and go."""

    def __init__(self, world: RunningWorld):
        self._world = world
        # By model.
        self._topics: Dict[str, List[str]] = {}
        self._services: Dict[str, List[Any]] = {}
        world.follow(self._begin, self._end)

    def _begin(self, instance: ModelInstance) -> None:
        topics = self._topics[instance.name] = []
        services = self._services[instance.name] = []
        for plugin in instance.plugins:
            if type(plugin) in (Camera, DepthCamera):
                images = CompressedImages(self._world, plugin)
                topics.append(images.topic)
                offers = self._camera_services(plugin, images)
            elif type(plugin) is Imu:
                name = rospy.resolve_name(plugin.service)
                offers = [partial(rospy.Service, name, Empty, lambda _: EmptyResponse())]
            else:
                continue
            self._world.registrar.submit(_start, offers, services, plugin.mount.plugin.name)

    def _end(self, model: str) -> None:
        for topic in self._topics.pop(model):
            self._world.topics.release(topic)
        self._world.registrar.submit(_shut_down, self._services.pop(model))

    def _camera_services(self, camera: Camera, images: CompressedImages) -> List[Callable[[], Any]]:
        name = rospy.resolve_name(camera.topic("set_camera_info"))
        topic = rospy.resolve_name(images.topic)
        offers: List[Callable[[], Any]] = [
            partial(offer, name, SetCameraInfo, partial(self._calibrate, camera)),
            partial(Reconfigurable, topic, COMPRESSION, images.set),
        ]
        if camera.name:
            default = min(max(1.0 / camera.schedule.period, LEAST_RATE), GREATEST_RATE)
            what = "pictures per simulated second"
            rate = Setting("imager_rate", default, what, LEAST_RATE, GREATEST_RATE)
            space, change = name.rsplit("/", 1)[0], partial(self._set_rate, camera)
            offers.append(partial(Reconfigurable, space, [rate], change))
        return offers

    def _calibrate(self, camera: Camera, request: Any) -> None:
        calibration = {name: getattr(request.camera_info, name) for name in CALIBRATED}
        check_calibration(calibration)
        self._world.do(lambda: setattr(camera, "calibration", calibration))

    def _set_rate(self, camera: Camera, values: Values) -> Values:
        rate, simulation = values["imager_rate"], self._world.simulation
        self._world.do(lambda: camera.set_rate(rate, simulation.step))
        return values


def check_calibration(calibration: Dict[str, Any]) -> None:
    """Raise InputError for an invalid calibration of set_camera_info."""
    for name in "DKRP":
        if not all(map(math.isfinite, calibration[name])):
            raise InputError(f"{name} has a number that is not finite")
    count = len(calibration["D"])
    if count > MOST_COEFFICIENTS:
        raise InputError(f"D has {count} coefficients; at most {MOST_COEFFICIENTS} are allowed")
    if len(calibration["distortion_model"]) > LONGEST_NAME:
        raise InputError(f"distortion_model has more than {LONGEST_NAME} characters")


def _start(offers: List[Callable[[], Any]], services: List[Any], sensor: str) -> None:
    for start in offers:
        try:
            services.append(start())
        except (rospy.ServiceException, *MASTER_ERRORS) as error:
            # Two sensors of the same name have the same services.
            if not rospy.is_shutdown():
                rospy.logwarn("sensor '%s': %s", sensor, error)


def _shut_down(services: List[Any]) -> None:
    for service in services:
        service.shutdown()
