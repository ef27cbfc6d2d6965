"""libgazebo_ros_control.so: joints that controllers of ros_control command, and their manager."""

from __future__ import annotations

import logging
import math
from typing import Any, Dict, Iterable, List, Mapping, Sequence

from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.physics.physics import STEP_SECONDS
from bullet_lab.simulation.plugins import Input, Mount, Plugin, warn_of_rivals
from bullet_lab.simulation.plugins.controllers import ControlError, ControlParameters, steer_bot
from bullet_lab.simulation.plugins.controllers.controller import CONTROLLERS, Controller
from bullet_lab.simulation.plugins.controllers.joints import (
    EFFORT,
    JointHandle,
    described_joints,
    joint_handles,
)
from bullet_lab.simulation.plugins.samples import Stop

LOG = logging.getLogger(__name__)

DEFAULT_HARDWARE = "gazebo_ros_control/DefaultRobotHWSim"


class RosControl(Plugin):
    """Runs controllers on the joints of its model, in lock step with the physics.

    It does nothing until `configure` gives it the robot's description, which in ROS is a
    parameter. The caller then loads and starts controllers by its `manager`; controllers have
    inputs and outputs of their own.

    Attributes:
        namespace: of the robot's parameters, topics and services, with slashes around it.
        description: name of the parameter with the robot's URDF.
        manager: of its controllers; it has no joints before `configure`.
    """

    filenames = ("libgazebo_ros_control.so",)
    acts = True

    def __init__(self, mount: Mount):
        super().__init__(mount)
        mount.require_moving()
        # As in Gazebo, the default namespace is the model's name.
        space = (mount.text("robotNamespace") or mount.model.name).strip("/")
        self.namespace = f"/{space}/" if space else "/"
        self.description = mount.text("robotParam", "robot_description")
        hardware = mount.text("robotSimType", DEFAULT_HARDWARE)
        self._is_steer_bot = hardware == steer_bot.HARDWARE
        if hardware not in (DEFAULT_HARDWARE, steer_bot.HARDWARE):
            where = mount.where("robotSimType")
            LOG.warning("%s: %s is not simulated; %s is used", where, hardware, DEFAULT_HARDWARE)
        # Of releases before Noetic; Noetic's plugin ignores it as well.
        mount.text("legacyModeNS")
        period = mount.number("controlPeriod", STEP_SECONDS)
        if period < STEP_SECONDS:
            where = mount.where("controlPeriod")
            LOG.warning("%s: %g s is less than a time step; a time step is used", where, period)
        steps = max(1, math.ceil(round(period * STEPS_PER_SECOND, 6)))
        self.manager = ControllerManager(self.namespace, steps)
        stop = mount.text("eStopTopic")
        if stop:
            topic = stop if stop.startswith("/") else self.namespace + stop
            self.inputs = (Input(topic, Stop, self._press),)

    def configure(self, urdf: str, parameters: Any) -> ControllerManager:
        """Read the robot's joints, and return the manager of its controllers.

        Args:
            urdf: the robot's description.
            parameters: the tree of parameters in the robot's namespace, with joint_limits/<joint>
                and gazebo_ros_control/pid_gains/<joint>.

        Raises:
            XmlError: the description is invalid.
            ControlError: a parameter of the hardware is missing.
        """
        where = f"model '{self.mount.model.name}': {self.description}"
        given = ControlParameters(parameters, self.namespace.rstrip("/"))
        bodies = self.mount.bodies
        if self._is_steer_bot:
            below = given.below("steer_bot_hardware_gazebo")
            self.manager.joints = steer_bot.steer_bot_joints(bodies, urdf, where, below)
        else:
            self.manager.joints = joint_handles(bodies, described_joints(urdf, where), given)
        warn_of_rivals(self, self.mount.simulation.models[self.mount.model.name].plugins)
        return self.manager

    @property
    def driven(self) -> list[str]:
        # An effort adds to what other plugins do.
        return [name for name, one in self.manager.joints.items() if one.interface != EFFORT]

    def before_step(self, step: int) -> None:
        self.manager.before_step(step)

    def placed(self) -> None:
        self.manager.placed()

    def reset(self, step: int) -> None:
        self.manager.reset(step)

    def _press(self, stop: Stop) -> None:
        self.manager.stopped = stop.pressed


class ControllerManager:
    """Loads, starts, stops, runs and unloads the controllers of one robot.

    Args:
        namespace: of the robot, with slashes around it.
        period: steps between two updates.

    Attributes:
        joints: of the robot, by name.
        controllers: all that are loaded, by name.
        stopped: whether the emergency stop is pressed.
    """

    def __init__(self, namespace: str, period: int):
        self.joints: Mapping[str, JointHandle] = {}
        self.controllers: Dict[str, Controller] = {}
        self.stopped = False
        self._namespace, self._period = namespace, period
        # The simulated time of the last update.
        self._step = 0
        self._was_stopped = False

    def load(self, name: str, parameters: ControlParameters) -> Controller:
        """Make a controller by its parameters, and return it; it does not run yet.

        Raises:
            ControlError: the name is loaded already, the type is not simulated, or a parameter
                is invalid.
        """
        if name in self.controllers:
            raise ControlError(f"controller '{name}' is loaded already")
        kind = parameters.get("type", "")
        if not kind:
            hint = "is the namespace of its parameters right?"
            raise ControlError(f"controller '{name}': {parameters.where}/type is missing; {hint}")
        if kind not in CONTROLLERS:
            hint = "controller_manager/list_controller_types names those that are"
            raise ControlError(f"controller '{name}': the type '{kind}' is not simulated; {hint}")
        try:
            controller = CONTROLLERS[kind](name, kind, self._namespace, parameters, self.joints)
        except ControlError as error:
            raise ControlError(f"controller '{name}': {error}") from error
        self.controllers[name] = controller
        return controller

    def unload(self, name: str) -> Controller:
        """Remove a controller, and return it; raises ControlError if it is unknown or runs."""
        if name not in self.controllers:
            raise ControlError(f"no controller '{name}' is loaded")
        if self.controllers[name].running:
            raise ControlError(f"controller '{name}' is running: it has to be stopped first")
        return self.controllers.pop(name)

    def switch(self, start: Sequence[str], stop: Sequence[str], strict: bool = True) -> None:
        """Stop some controllers and start others, between two steps.

        If not `strict`, controllers that cannot be started or stopped are ignored, except that
        no two running controllers may command the same joint.

        Raises:
            ControlError: a controller cannot be started or stopped; nothing is changed.
        """
        for name in set(start) & set(stop) & set(self.controllers):
            raise ControlError(f"controller '{name}' cannot be started and stopped at once")
        to_stop = self._chosen(stop, True, strict)
        to_start = self._chosen(start, False, strict)
        running = [one for one in self.controllers.values() if one.running and one not in to_stop]
        _refuse_conflicts(running + to_start)
        for controller in to_stop:
            controller.stop()
        for controller in to_start:
            controller.start(self._step)

    def before_step(self, step: int) -> None:
        """Control the joints in the coming step."""
        if step - self._step >= self._period:
            seconds = (step - self._step) / STEPS_PER_SECOND
            self._step = step
            self._read()
            is_released = self._was_stopped and not self.stopped
            self._was_stopped = self.stopped
            running = [controller for controller in self.controllers.values() if controller.running]
            for controller in running if is_released else ():
                controller.stop()
                controller.start(step)
            for controller in running:
                controller.update(step, seconds)
        for joint in self.joints.values():
            joint.write(self.stopped)

    def _read(self) -> None:
        for joint in self.joints.values():
            joint.read()

    def placed(self) -> None:
        """Handle that the robot was placed somewhere else."""
        self._read()
        for one in (*self.joints.values(), *self.controllers.values()):
            one.placed()

    def reset(self, step: int) -> None:
        """Start anew after a reset of the robot; simulated time is now `step`."""
        self._step = step
        self._read()
        for controller in self.controllers.values():
            controller.reset(step)

    def _chosen(self, names: Iterable[str], running: bool, strict: bool) -> List[Controller]:
        """Return the controllers of those names that run, or that do not run."""
        chosen: List[Controller] = []
        for name in dict.fromkeys(names):
            controller = self.controllers.get(name)
            if controller is not None and controller.running is running:
                chosen.append(controller)
            elif strict and controller is None:
                raise ControlError(f"no controller '{name}' is loaded")
            elif strict:
                state = "not running" if running else "running already"
                raise ControlError(f"controller '{name}' is {state}")
        return chosen


def _refuse_conflicts(controllers: Iterable[Controller]) -> None:
    owners: Dict[str, str] = {}
    for controller in controllers:
        for joint in controller.joints:
            owner = owners.setdefault(joint.name, controller.name)
            if owner != controller.name:
                both = f"'{owner}' and '{controller.name}'"
                raise ControlError(f"{both} would both command the joint '{joint.name}'")
