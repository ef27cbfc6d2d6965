"""The controller manager of each robot that has libgazebo_ros_control.so, with its parameters.

:ROS Services: in the robot's namespace, controller_manager/
    list_controllers, list_controller_types, load_controller, unload_controller,
    switch_controller, reload_controller_libraries (controller_manager_msgs)
    and below the name of a controller that can be adjusted, set_parameters of dynamic_reconfigure
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from dataclasses import astuple
from functools import partial
from typing import Any, Callable, Collection, Dict, List, Optional

import rosgraph
import rospy

from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.bridge.stepper import StepperError
from bullet_lab.ros.gazebo.reconfigure import Reconfigurable, Setting, Values
from bullet_lab.ros.messages.control_types import msg, srv
from bullet_lab.ros.node.node import MASTER_ERRORS, NodeError, search_parameter
from bullet_lab.simulation.plugins.controllers.controller import Controller, known_controllers
from bullet_lab.simulation.plugins.controllers.description import ControlError, ControlParameters
from bullet_lab.simulation.plugins.ros_control import RosControl

LOG = logging.getLogger(__name__)

BASE_CLASS = "controller_interface::ControllerBase"
INTERFACE_SPACE = "hardware_interface::"
# Wall seconds between two looks for a description, and until it is said that there is none yet.
LOOK_SECONDS = 0.1
PATIENCE = 3.0


class ControllerManagers:
    """Keeps a controller manager for each robot with controllers, as robots come and go."""

    def __init__(self, world: RunningWorld):
        self._world = world
        self._managers: Dict[RosControl, _Manager] = {}
        world.changed.append(self._look)
        self._look("")

    def _look(self, _name: str) -> None:
        """Note who has come and who has gone; in the thread that steps the simulation."""
        there = {
            plugin
            for instance in self._world.models.values()
            for plugin in instance.plugins
            if isinstance(plugin, RosControl)
        }
        for plugin in there - set(self._managers):
            self._managers[plugin] = _Manager(self._world, plugin)
        for plugin in set(self._managers) - there:
            self._managers.pop(plugin).end()


class _Manager:
    """Offers the services of one robot, once there is a description of it.

    What talks to the master does so in a thread of its own: the simulation does not wait for it.
    """

    def __init__(self, world: RunningWorld, plugin: RosControl):
        self._world, self._plugin = world, plugin
        self._ended = threading.Event()
        self._services: List[rospy.Service] = []
        self._adjusted: Dict[str, Reconfigurable] = {}
        # Of one client at a time.
        self._lock = threading.Lock()
        threading.Thread(target=self._begin, daemon=True).start()

    def end(self) -> None:
        """Give up what it has on ROS; in the thread that steps the simulation."""
        self._ended.set()
        manager = self._plugin.manager
        if manager is not None:
            self._world.topics.disconnect_devices(tuple(manager.controllers.values()))
        threading.Thread(target=self._withdraw, daemon=True).start()

    def _withdraw(self) -> None:
        with self._lock:
            for service in (*self._services, *self._adjusted.values()):
                service.shutdown()
            self._services.clear()
            self._adjusted.clear()

    def _begin(self) -> None:
        where = f"controller_manager in {self._plugin.namespace}"
        try:
            urdf = self._wait_for_description()
            if urdf is not None:
                parameters = _parameters(self._plugin.namespace)
                self._world.do(lambda: self._plugin.configure(urdf, parameters))
                self._offer()
        except StepperError:
            return
        except (LabError, rospy.ServiceException, *MASTER_ERRORS) as error:
            LOG.error("%s: %s; it is left out", where, error)

    def _wait_for_description(self) -> Optional[str]:
        """Return the robot's URDF, once the parameter is there; None if the robot has gone."""
        name, waited = self._plugin.description, 0.0
        while not (self._ended.is_set() or rospy.is_shutdown()):
            with contextlib.suppress(NodeError):
                text = search_parameter(name, self._plugin.namespace)
                if text:
                    return text
            if waited <= PATIENCE < waited + LOOK_SECONDS:
                LOG.warning("controllers in %s wait for %s", self._plugin.namespace, name)
            waited += LOOK_SECONDS
            self._ended.wait(LOOK_SECONDS)
        return None

    def _offer(self) -> None:
        space = f"{self._plugin.namespace}controller_manager"
        answers = {
            "list_controllers": (srv.ListControllers, self._list),
            "list_controller_types": (srv.ListControllerTypes, self._list_types),
            "load_controller": (srv.LoadController, self._ok(self._load)),
            "unload_controller": (srv.UnloadController, self._ok(self._unload)),
            "switch_controller": (srv.SwitchController, self._ok(self._switch)),
            "reload_controller_libraries": (
                srv.ReloadControllerLibraries,
                self._ok(self._reload),
            ),
        }
        for name, (kind, answer) in answers.items():
            self._offer_one(f"{space}/{name}", kind, answer)

    def _offer_one(self, name: str, kind: Any, answer: Callable[[Any], Any]) -> None:
        """Offer a service, once that of a robot that has gone is away; raises ServiceException."""
        end = time.monotonic() + PATIENCE
        while not self._ended.is_set():
            try:
                with self._lock:
                    self._services.append(rospy.Service(name, kind, answer))
                return
            except rospy.ServiceException:
                if time.monotonic() > end:
                    raise
                self._ended.wait(LOOK_SECONDS)

    def _ok(self, act: Callable[[Any], None]) -> Callable[[Any], bool]:
        """Return what answers whether something could be done, and says why it could not."""

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
            raise ControlError(f"no controller can be called '{request.name}'")
        parameters = ControlParameters(_parameters(where), where)
        refused = self._plugin.refused
        if request.name not in self._manager().controllers:
            refused[request.name] = f"{request.name} ({parameters.text('type') or 'no type'})"
        controller = self._world.do(lambda: self._add(request.name, parameters))
        refused.pop(request.name, None)
        settings = [Setting(*astuple(one)) for one in controller.adjustables]
        if settings:
            change = partial(self._adjust, controller)
            self._adjusted[request.name] = Reconfigurable(where, settings, change)

    def _adjust(self, controller: Controller, values: Values) -> Values:
        with contextlib.suppress(StepperError):
            self._world.do(lambda: controller.adjust(values, self._world.simulation.step))
        return values

    def _add(self, name: str, parameters: ControlParameters) -> Controller:
        manager = self._manager()
        controller = manager.load(name, parameters)
        try:
            self._world.topics.connect_devices((controller,), f"controller '{name}'")
        except LabError:
            manager.unload(name)
            raise
        return controller

    def _unload(self, request: Any) -> None:
        self._world.do(lambda: self._take_out(request.name))
        self._keep_adjusted({*self._adjusted} - {request.name})

    def _keep_adjusted(self, names: Collection[str]) -> None:
        """Offer settings of the controllers of these names alone."""
        for name in {*self._adjusted} - {*names}:
            self._adjusted.pop(name).shutdown()

    def _take_out(self, name: str) -> None:
        self._world.topics.disconnect_devices((self._manager().unload(name),))

    def _switch(self, request: Any) -> None:
        strict = request.strictness == srv.SwitchControllerRequest.STRICT
        wanted = (request.start_controllers, request.stop_controllers, strict)
        self._world.do(lambda: self._manager().switch(*wanted))

    def _reload(self, request: Any) -> None:
        self._world.do(lambda: self._unload_all(request.force_kill))
        self._keep_adjusted(())

    def _unload_all(self, by_force: bool) -> None:
        manager = self._manager()
        names = tuple(manager.controllers)
        if names and not by_force:
            raise ControlError(f"{len(names)} controllers are loaded, and force_kill is not set")
        manager.switch((), names, strict=False)
        for name in names:
            self._take_out(name)

    def _list(self, _request: Any) -> Any:
        loaded = self._world.do(lambda: [_state(c) for c in self._manager().controllers.values()])
        return srv.ListControllersResponse(controller=loaded)

    def _list_types(self, _request: Any) -> Any:
        known = known_controllers()
        return srv.ListControllerTypesResponse(known, [BASE_CLASS] * len(known))

    def _manager(self) -> Any:
        if self._ended.is_set():
            raise ControlError("the robot was taken away")
        return self._plugin.manager


def _state(controller: Controller) -> Any:
    resources = msg.HardwareInterfaceResources(
        INTERFACE_SPACE + controller.interface, sorted(joint.name for joint in controller.joints)
    )
    setup = controller.setup
    return msg.ControllerState(setup.name, controller.state, setup.kind, [resources])


def _parameters(namespace: str) -> Any:
    """Return the tree of parameters in a namespace, None where there is none."""
    return rospy.get_param(namespace.rstrip("/") or "/", None)
