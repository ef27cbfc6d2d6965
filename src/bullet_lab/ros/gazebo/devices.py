"""Services of cameras, IMUs and controllers, and compressed images, as models come and go.

Below a camera's name: set_camera_info, and set_parameters of dynamic_reconfigure (imager_rate).
Below its image topic: `compressed`, as image_transport publishes it, with the parameters of
compressed_image_transport. An image is compressed only while somebody listens.

In the namespace of a robot with libgazebo_ros_control.so: controller_manager/list_controllers,
list_controller_types, load_controller, unload_controller, switch_controller,
reload_controller_libraries (controller_manager_msgs), and below the name of an adjustable
controller, set_parameters of dynamic_reconfigure; its action, and query_state.
"""

from __future__ import annotations

import contextlib
import logging
import math
import threading
from functools import partial
from itertools import chain
from typing import Any, Callable

import rosgraph
import rospy
from actionlib.server_goal_handle import ServerGoalHandle
from sensor_msgs.msg import CompressedImage
from sensor_msgs.srv import SetCameraInfo
from std_srvs.srv import Empty

from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.bridge.stepper import StepperError
from bullet_lab.ros.gazebo.physics import Reconfigurable, Values
from bullet_lab.ros.gazebo.services import offer
from bullet_lab.ros.messages.actions import ACTIONS
from bullet_lab.ros.messages.conversions import compressed_message
from bullet_lab.ros.messages.gazebo_types import arm_srv, control_msg, control_srv
from bullet_lab.ros.messages.poses import InputError, vector_of
from bullet_lab.ros.node.driving import LastingServer
from bullet_lab.ros.node.node import MASTER_ERRORS, NodeError, search_parameter
from bullet_lab.simulation.models import ModelInstance
from bullet_lab.simulation.plugins.camera import Camera
from bullet_lab.simulation.plugins.controllers import ControlError, ControlParameters
from bullet_lab.simulation.plugins.controllers.actions import ACCEPTED, ActionController, Goal
from bullet_lab.simulation.plugins.controllers.controller import CONTROLLERS, Controller, Setting
from bullet_lab.simulation.plugins.hector_sensors import DriftingError, HectorImu
from bullet_lab.simulation.plugins.motion_sensors import Imu
from bullet_lab.simulation.plugins.ros_control import MimicJoint, RosControl
from bullet_lab.simulation.plugins.samples import ImageSample
from bullet_lab.srv import SetBias

LOG = logging.getLogger(__name__)

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
BASE_CLASS = "controller_interface::ControllerBase"
INTERFACE_SPACE = "hardware_interface::"
# Wall seconds between two searches for the robot's description.
RETRY_SECONDS = 0.1
# Wall seconds until a warning that the robot's description is missing.
PATIENCE = 3.0


class CompressedImages:
    """The compressed images of one camera, with its settings; for the simulation's thread."""

    def __init__(self, world: RunningWorld, camera: Camera):
        self.topic = f"{camera.image.topic}/compressed"
        self.settings: Values = {setting.name: setting.default for setting in COMPRESSION}
        self._publisher = world.topics.publisher(self.topic, CompressedImage)
        camera.image.connect(self._publish, self._publisher.has_connections)

    def _publish(self, sample: ImageSample) -> None:
        if self._publisher.has_connections():
            self._publisher.publish(compressed_message(sample, self.settings))


class DeviceServices:
    """Offers the services of the cameras, IMUs and controllers of all models."""

    def __init__(self, world: RunningWorld):
        self._world = world
        world.follow(self._begin)

    def _begin(self, instance: ModelInstance) -> Callable[[], None]:
        registrar, services, ends = self._world.registrar, [], contextlib.ExitStack()
        ends.callback(registrar.submit, _shut_down, services)
        for plugin in instance.plugins:
            offers: list[Callable[[], Any]] = []
            if isinstance(plugin, RosControl):
                ends.callback(ControllerServices(self._world, plugin).end)
            elif isinstance(plugin, Camera):
                images = CompressedImages(self._world, plugin)
                ends.callback(self._world.topics.release, images.topic)
                offers = self._camera_services(plugin, images)
            elif isinstance(plugin, HectorImu):
                offers = self._bias_services(plugin)
            elif isinstance(plugin, MimicJoint) and plugin.gains:
                registrar.submit(self._give_gains, plugin)
            elif type(plugin) is Imu:
                name = rospy.resolve_name(plugin.service)
                offers = [partial(rospy.Service, name, Empty, lambda _: ())]
            sensor = plugin.mount.plugin.name
            registrar.submit(_start, offers, services, f"sensor '{sensor}'")
        return ends.close

    def _give_gains(self, plugin: MimicJoint) -> None:
        try:
            parameters = _parameters(plugin.gains)
            self._world.do(lambda: plugin.configure(parameters))
        except (LabError, *MASTER_ERRORS) as error:
            LOG.warning("%s: %s; a motor moves it", plugin.mount.where("hasPID"), error)

    def _camera_services(self, camera: Camera, images: CompressedImages) -> list[Callable[[], Any]]:
        name = rospy.resolve_name(camera.topic("set_camera_info"))
        topic = rospy.resolve_name(images.topic)
        offers: list[Callable[[], Any]] = [
            partial(offer, name, SetCameraInfo, partial(self._calibrate, camera)),
            partial(Reconfigurable, topic, COMPRESSION, images.settings.update),
        ]
        if camera.name:
            default = min(max(1.0 / camera.schedule.period, LEAST_RATE), GREATEST_RATE)
            what = "pictures per simulated second"
            rate = Setting("imager_rate", default, what, LEAST_RATE, GREATEST_RATE)
            space, change = name.rsplit("/", 1)[0], partial(self._set_rate, camera)
            offers.append(partial(Reconfigurable, space, [rate], change))
        return offers

    def _bias_services(self, imu: HectorImu) -> list[Callable[[], Any]]:
        def set_drift(error: DriftingError, request: Any) -> None:
            drift = vector_of(request.bias, "bias") if hasattr(request, "bias") else (0.0,) * 3
            self._world.do(lambda: error.reset(self._world.simulation.step, drift))

        kinds = (
            (imu.service, Empty, imu.rate),
            (f"{imu.space}/set_accel_bias", SetBias, imu.accel),
            (f"{imu.space}/set_rate_bias", SetBias, imu.rate),
        )
        return [
            partial(offer, rospy.resolve_name(name), kind, partial(set_drift, error))
            for name, kind, error in kinds
        ]

    def _calibrate(self, camera: Camera, request: Any) -> None:
        calibration = {name: getattr(request.camera_info, name) for name in CALIBRATED}
        check_calibration(calibration)
        self._world.do(lambda: setattr(camera, "calibration", calibration))

    def _set_rate(self, camera: Camera, values: Values) -> None:
        rate, simulation = values["imager_rate"], self._world.simulation
        self._world.do(lambda: camera.set_rate(rate, simulation.step))


def check_calibration(calibration: dict[str, Any]) -> None:
    """Raise InputError for an invalid calibration of set_camera_info."""
    for name in "DKRP":
        if not all(map(math.isfinite, calibration[name])):
            raise InputError(f"{name} has a number that is not finite")
    count = len(calibration["D"])
    if count > MOST_COEFFICIENTS:
        raise InputError(f"D has {count} coefficients; at most {MOST_COEFFICIENTS} are allowed")
    if len(calibration["distortion_model"]) > LONGEST_NAME:
        raise InputError(f"distortion_model has more than {LONGEST_NAME} characters")


def _start(offers: list[Callable[[], Any]], services: list[Any], where: str) -> None:
    for start in offers:
        try:
            services.append(start())
        except (rospy.ServiceException, *MASTER_ERRORS) as error:
            # Two sensors of the same name have the same services.
            if not rospy.is_shutdown():
                rospy.logwarn("%s: %s", where, error)


def _shut_down(services: list[Any]) -> None:
    for service in services:
        service.shutdown()


class ControllerServices:
    """Offers the controller manager of one robot once its description is a parameter.

    All calls of the master are made in other threads: the simulation does not wait.
    """

    def __init__(self, world: RunningWorld, plugin: RosControl):
        self._world, self._plugin = world, plugin
        self._where = f"controller_manager in {plugin.namespace}"
        self._ended = threading.Event()
        self._services: list[rospy.Service] = []
        # Settings and actions of controllers, by name.
        self._offered: dict[str, list[Any]] = {}
        # Serves one client at a time.
        self._lock = threading.Lock()
        threading.Thread(target=self._begin, daemon=True).start()

    def end(self) -> None:
        """Shut down all topics and services; in the thread of the simulation."""
        self._ended.set()
        self._world.topics.disconnect(tuple(self._plugin.controllers.values()))
        self._world.registrar.submit(self._shut_down)

    def _shut_down(self) -> None:
        with self._lock:
            _shut_down([*self._services, *chain(*self._offered.values())])

    def _begin(self) -> None:
        try:
            urdf = self._wait_for_description()
            if urdf is not None:
                parameters = _parameters(self._plugin.namespace)
                self._world.do(lambda: self._plugin.configure(urdf, parameters))
                self._world.registrar.submit(self._offer_services)
        except StepperError:
            return
        except (LabError, *MASTER_ERRORS) as error:
            LOG.error("%s: %s; it is left out", self._where, error)

    def _wait_for_description(self) -> str | None:
        """Return the robot's URDF once the parameter is set; None if the robot was removed."""
        name, waited = self._plugin.description, 0.0
        while not (self._ended.is_set() or rospy.is_shutdown()):
            with contextlib.suppress(NodeError):
                text = search_parameter(name, self._plugin.namespace)
                if text:
                    return text
            if waited <= PATIENCE < waited + RETRY_SECONDS:
                LOG.warning("controllers in %s wait for %s", self._plugin.namespace, name)
            waited += RETRY_SECONDS
            self._ended.wait(RETRY_SECONDS)
        return None

    def _offer_services(self) -> None:
        """Offer the services, unless the robot was removed in the meantime."""
        answers: dict[str, tuple[Any, Callable[[Any], Any]]] = {
            "list_controllers": (control_srv.ListControllers, self._list),
            "list_controller_types": (control_srv.ListControllerTypes, self._list_types),
            "load_controller": (control_srv.LoadController, self._ok(self._load)),
        }
        changes = {
            "unload_controller": (control_srv.UnloadController, self._unload),
            "switch_controller": (control_srv.SwitchController, self._switch),
            "reload_controller_libraries": (control_srv.ReloadControllerLibraries, self._reload),
        }
        for name, (kind, change) in changes.items():
            answers[name] = (kind, self._ok(partial(self._between_steps, change)))
        space = f"{self._plugin.namespace}controller_manager"
        offers: list[Callable[[], Any]] = [
            partial(rospy.Service, f"{space}/{name}", *answer) for name, answer in answers.items()
        ]
        _start([] if self._ended.is_set() else offers, self._services, self._where)

    def _ok(self, act: Callable[[Any], None]) -> Callable[[Any], bool]:
        """Return a service that returns whether an action succeeded, and logs its error."""

        def answer(request: Any) -> bool:
            try:
                with self._lock:
                    act(request)
                return True
            except StepperError as error:
                raise rospy.ServiceException(str(error)) from error
            except LabError as error:
                LOG.error("%scontroller_manager: %s", self._plugin.namespace, error)
                return False

        return answer

    def _load(self, request: Any) -> None:
        where = f"{self._plugin.namespace}{request.name}"
        if not request.name or not rosgraph.names.is_legal_name(where):
            raise ControlError(f"invalid controller name '{request.name}'")
        parameters = ControlParameters(_parameters(where), where)
        refused = self._plugin.refused
        if request.name not in self._manager().controllers:
            refused[request.name] = f"{request.name} ({parameters.get('type', '') or 'no type'})"
        controller = self._world.do(lambda: self._add(request.name, parameters))
        refused.pop(request.name, None)
        offered = self._offered[request.name] = []
        if controller.adjustables:
            change = partial(self._adjust, controller)
            offered.append(Reconfigurable(where, controller.adjustables, change))
        if isinstance(controller, ActionController):
            offered.append(ControllerAction(self._world, controller))

    def _adjust(self, controller: Controller, values: Values) -> None:
        self._world.do(lambda: controller.adjust(values, self._world.simulation.step))

    def _add(self, name: str, parameters: ControlParameters) -> Controller:
        manager = self._manager()
        controller = manager.load(name, parameters)
        try:
            if isinstance(controller, ActionController) and not ACTIONS:
                raise ControlError(f"'{controller.kind}' needs the package control_msgs")
            self._world.topics.connect((controller,), f"controller '{name}'")
        except LabError:
            manager.unload(name)
            raise
        return controller

    def _between_steps(self, change: Callable[[Any], None], request: Any) -> None:
        """Change controllers in the thread of the simulation; shut down those that it removes."""
        self._world.do(lambda: change(request))
        for name in self._offered.keys() - self._manager().controllers.keys():
            _shut_down(self._offered.pop(name))

    def _unload(self, request: Any) -> None:
        self._remove(request.name)

    def _remove(self, *names: str) -> None:
        self._world.topics.disconnect(tuple(map(self._manager().unload, names)))

    def _switch(self, request: Any) -> None:
        strict = request.strictness == control_srv.SwitchControllerRequest.STRICT
        self._manager().switch(request.start_controllers, request.stop_controllers, strict)

    def _reload(self, request: Any) -> None:
        manager = self._manager()
        names = tuple(manager.controllers)
        if names and not request.force_kill:
            raise ControlError(f"{len(names)} controllers are loaded, and force_kill is not set")
        manager.switch((), names, strict=False)
        self._remove(*names)

    def _list(self, _request: Any) -> Any:
        loaded = self._world.do(lambda: [_state(c) for c in self._manager().controllers.values()])
        return control_srv.ListControllersResponse(controller=loaded)

    def _list_types(self, _request: Any) -> Any:
        known = sorted(CONTROLLERS)
        return control_srv.ListControllerTypesResponse(known, [BASE_CLASS] * len(known))

    def _manager(self) -> Any:
        if self._ended.is_set():
            raise ControlError("the robot was removed from the world")
        return self._plugin


class ControllerAction:
    """Gives the goals of an action server to a controller, and offers its queries.

    Goals come in threads of rospy that hold actionlib's lock. The controller moves them later, in
    the thread of the simulation, which takes that lock for a moment.
    """

    def __init__(self, world: RunningWorld, controller: ActionController):
        self._world, self._controller = world, controller
        kind, self._goal_of, self._feedback, self._result = ACTIONS[controller.action]
        self._goals: dict[str, Goal] = {}
        calls = (kind, self._receive, self._cancel)
        self._server = LastingServer(controller.topic(controller.action), *calls, auto_start=False)
        self._server.start()
        kind = arm_srv.QueryTrajectoryState
        self._services = [
            rospy.Service(controller.topic(name), kind, partial(self._answer, query))
            for name, query in controller.queries.items()
        ]

    def shutdown(self) -> None:
        """Shut down the action and the services."""
        self._server.stop()
        _shut_down(self._services)

    def _answer(self, query: Any, request: Any) -> Any:
        try:
            names, point = self._world.do(lambda: query(request.time.to_sec()))
        except LabError as error:
            raise rospy.ServiceException(str(error)) from error
        return (names, *point[1:])

    def _receive(self, handle: ServerGoalHandle) -> None:
        name = handle.get_goal_id().id

        def move(state: str, result: Any, text: str) -> None:
            if state == ACCEPTED:
                handle.set_accepted()
                return
            del self._goals[name]
            message = None if result is None else self._result(*result)
            getattr(handle, f"set_{state}")(message, text)

        def tell(feedback: Any) -> None:
            handle.publish_feedback(self._feedback(*feedback))

        goal = self._goals[name] = Goal(self._goal_of(handle.get_goal()), move, tell)
        self._controller.receive(goal)

    def _cancel(self, handle: ServerGoalHandle) -> None:
        goal = self._goals.get(handle.get_goal_id().id)
        if goal is not None:
            self._controller.cancel(goal)


def _state(controller: Controller) -> Any:
    claimed = {controller.interface: []}
    for joint in controller.joints:
        claimed.setdefault(joint.interface, []).append(joint.name)
    resources = [
        control_msg.HardwareInterfaceResources(INTERFACE_SPACE + interface, sorted(joints))
        for interface, joints in claimed.items()
    ]
    names = (controller.name, controller.state, controller.kind)
    return control_msg.ControllerState(*names, resources)


def _parameters(namespace: str) -> Any:
    """Return the tree of parameters in a namespace; None if there is none."""
    # Of the root, rospy.get_param returns what it has cached, and nothing else.
    with contextlib.suppress(rosgraph.MasterException):
        return rosgraph.Master(rospy.get_name()).getParam(namespace.rstrip("/") or "/")
    return None
