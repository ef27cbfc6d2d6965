"""The controller manager of each robot with libgazebo_ros_control.so, and its parameters.

:ROS Services: in the robot's namespace, controller_manager/
    list_controllers, list_controller_types, load_controller, unload_controller,
    switch_controller, reload_controller_libraries (controller_manager_msgs)
    and below the name of an adjustable controller, set_parameters of dynamic_reconfigure
"""

from __future__ import annotations

import contextlib
import logging
import threading
from functools import partial
from typing import Any, Callable, Dict, List, Optional

import rosgraph
import rospy

from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.bridge.stepper import StepperError
from bullet_lab.ros.gazebo.physics import Reconfigurable, Values
from bullet_lab.ros.messages.gazebo_types import control_msg, control_srv
from bullet_lab.ros.node.node import MASTER_ERRORS, NodeError, search_parameter
from bullet_lab.simulation.plugins.controllers.controller import CONTROLLERS, Controller
from bullet_lab.simulation.plugins.controllers.description import ControlError, ControlParameters
from bullet_lab.simulation.plugins.ros_control import RosControl
from bullet_lab.simulation.simulation import ModelInstance

LOG = logging.getLogger(__name__)

BASE_CLASS = "controller_interface::ControllerBase"
INTERFACE_SPACE = "hardware_interface::"
# Wall seconds between two searches for the robot's description.
RETRY_SECONDS = 0.1
# Wall seconds until a warning that the robot's description is missing.
PATIENCE = 3.0


class ControllerManagers:
    """Starts a controller manager for each robot with controllers, as robots come and go."""

    def __init__(self, world: RunningWorld):
        self._world = world
        self._managers: Dict[str, List[_Manager]] = {}
        world.follow(self._begin, self._end)

    def _begin(self, instance: ModelInstance) -> None:
        plugins = [plugin for plugin in instance.plugins if isinstance(plugin, RosControl)]
        self._managers[instance.name] = [_Manager(self._world, plugin) for plugin in plugins]

    def _end(self, model: str) -> None:
        for manager in self._managers.pop(model):
            manager.end()


class _Manager:
    """Offers the services of one robot once its description is on the parameter server.

    All calls of the master are made in other threads: the simulation does not wait.
    """

    def __init__(self, world: RunningWorld, plugin: RosControl):
        self._world, self._plugin = world, plugin
        self._where = f"controller_manager in {plugin.namespace}"
        self._ended = threading.Event()
        self._services: List[rospy.Service] = []
        self._adjustable: Dict[str, Reconfigurable] = {}
        # Serves one client at a time.
        self._lock = threading.Lock()
        threading.Thread(target=self._begin, daemon=True).start()

    def end(self) -> None:
        """Shut down all topics and services; in the thread of the simulation."""
        self._ended.set()
        manager = self._plugin.manager
        if manager is not None:
            self._world.topics.disconnect(tuple(manager.controllers.values()))
        self._world.registrar.submit(self._shut_down)

    def _shut_down(self) -> None:
        with self._lock:
            for service in (*self._services, *self._adjustable.values()):
                service.shutdown()

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

    def _wait_for_description(self) -> Optional[str]:
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
        answers = {
            "list_controllers": (control_srv.ListControllers, self._list),
            "list_controller_types": (control_srv.ListControllerTypes, self._list_types),
            "load_controller": (control_srv.LoadController, self._ok(self._load)),
            "unload_controller": (control_srv.UnloadController, self._ok(self._unload)),
            "switch_controller": (control_srv.SwitchController, self._ok(self._switch)),
            "reload_controller_libraries": (
                control_srv.ReloadControllerLibraries,
                self._ok(self._reload),
            ),
        }
        space = f"{self._plugin.namespace}controller_manager"
        try:
            for name, answer in () if self._ended.is_set() else answers.items():
                self._services.append(rospy.Service(f"{space}/{name}", *answer))
        except (rospy.ServiceException, *MASTER_ERRORS) as error:
            LOG.error("%s: %s; it is left out", self._where, error)

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
        if controller.adjustables:
            change = partial(self._adjust, controller)
            adjustable = Reconfigurable(where, controller.adjustables, change)
            self._adjustable[request.name] = adjustable

    def _adjust(self, controller: Controller, values: Values) -> Values:
        self._world.do(lambda: controller.adjust(values, self._world.simulation.step))
        return values

    def _add(self, name: str, parameters: ControlParameters) -> Controller:
        manager = self._manager()
        controller = manager.load(name, parameters)
        try:
            self._world.topics.connect((controller,), f"controller '{name}'")
        except LabError:
            manager.unload(name)
            raise
        return controller

    def _unload(self, request: Any) -> None:
        self._world.do(lambda: self._remove(request.name))
        self._shut_down_settings()

    def _remove(self, *names: str) -> None:
        self._world.topics.disconnect(tuple(map(self._manager().unload, names)))

    def _shut_down_settings(self) -> None:
        """Shut down the settings of controllers that were removed."""
        for name in self._adjustable.keys() - self._manager().controllers.keys():
            self._adjustable.pop(name).shutdown()

    def _switch(self, request: Any) -> None:
        strict = request.strictness == control_srv.SwitchControllerRequest.STRICT
        wanted = (request.start_controllers, request.stop_controllers, strict)
        self._world.do(lambda: self._manager().switch(*wanted))

    def _reload(self, request: Any) -> None:
        def remove_all() -> None:
            manager = self._manager()
            names = tuple(manager.controllers)
            if names and not request.force_kill:
                raise ControlError(
                    f"{len(names)} controllers are loaded, and force_kill is not set"
                )
            manager.switch((), names, strict=False)
            self._remove(*names)

        self._world.do(remove_all)
        self._shut_down_settings()

    def _list(self, _request: Any) -> Any:
        loaded = self._world.do(lambda: [_state(c) for c in self._manager().controllers.values()])
        return control_srv.ListControllersResponse(controller=loaded)

    def _list_types(self, _request: Any) -> Any:
        known = sorted(CONTROLLERS)
        return control_srv.ListControllerTypesResponse(known, [BASE_CLASS] * len(known))

    def _manager(self) -> Any:
        if self._ended.is_set():
            raise ControlError("the robot was removed from the world")
        return self._plugin.manager


def _state(controller: Controller) -> Any:
    resources = control_msg.HardwareInterfaceResources(
        INTERFACE_SPACE + controller.interface, sorted(joint.name for joint in controller.joints)
    )
    names = (controller.name, controller.state, controller.kind)
    return control_msg.ControllerState(*names, [resources])


def _parameters(namespace: str) -> Any:
    """Return the tree of parameters in a namespace; None if there is none."""
    return rospy.get_param(namespace.rstrip("/") or "/", None)
