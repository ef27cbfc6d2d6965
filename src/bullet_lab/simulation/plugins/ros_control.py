"""Joints that controllers of ros_control command with their manager, and joints that follow others.

libgazebo_ros_control.so and libroboticsgroup_gazebo_mimic_joint_plugin.so.
"""

from __future__ import annotations

import logging
import math
from typing import Any, Iterable, Mapping, Sequence

from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.physics.bodies import Body
from bullet_lab.simulation.physics.physics import STEP_SECONDS
from bullet_lab.simulation.plugins import Input, Mount, Plugin, PluginError, warn_of_rivals
from bullet_lab.simulation.plugins.controllers import ControlError, ControlParameters, cars
from bullet_lab.simulation.plugins.controllers.controller import CONTROLLERS, Controller
from bullet_lab.simulation.plugins.controllers.joints import (
    AT_ONCE,
    EFFORT,
    STRONGEST,
    JointHandle,
    Pid,
    described_joints,
    joint_handles,
)
from bullet_lab.simulation.plugins.samples import Stop

LOG = logging.getLogger(__name__)

DEFAULT_HARDWARE = "gazebo_ros_control/DefaultRobotHWSim"


class RosControl(Plugin):
    """Manages and runs controllers on the joints of its model, in lock step with the physics.

    It does nothing until `configure` gives it the robot's description, which in ROS is a
    parameter. The caller then loads and starts controllers, which have inputs and outputs of
    their own.

    Attributes:
        namespace: of the robot's parameters, topics and services, with slashes around it.
        description: name of the parameter with the robot's URDF.
        joints: of the robot, by name; none before `configure`.
        controllers: all that are loaded, by name.
        stopped: whether the emergency stop is pressed.
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
        self._is_steer_bot = hardware == cars.STEER_BOT
        if not self._is_steer_bot and hardware != DEFAULT_HARDWARE:
            where = mount.where("robotSimType")
            LOG.warning("%s: %s is not simulated; %s is used", where, hardware, DEFAULT_HARDWARE)
        # Of releases before Noetic; Noetic's plugin ignores it as well.
        mount.text("legacyModeNS")
        period = mount.number("controlPeriod", STEP_SECONDS)
        if period < STEP_SECONDS:
            where = mount.where("controlPeriod")
            LOG.warning("%s: %g s is less than a time step; a time step is used", where, period)
        self._period = max(1, math.ceil(round(period * STEPS_PER_SECOND, 6)))
        self.joints: Mapping[str, JointHandle] = {}
        self.controllers: dict[str, Controller] = {}
        self.stopped = self._was_stopped = False
        # The simulated time of the last update.
        self._step = 0
        stop = mount.text("eStopTopic")
        if stop:
            topic = stop if stop.startswith("/") else self.namespace + stop
            self.inputs = (Input(topic, Stop, self._press),)

    def configure(self, urdf: str, parameters: Any) -> RosControl:
        """Read the robot's joints; return the plugin, as the manager of its controllers.

        `parameters` is the tree of parameters in the robot's namespace. Raises XmlError for an
        invalid description, and ControlError if a parameter of the hardware is missing.
        """
        where = f"model '{self.mount.model.name}': {self.description}"
        given = ControlParameters(parameters, self.namespace.rstrip("/"))
        bodies = self.mount.bodies
        if self._is_steer_bot:
            below = given.below("steer_bot_hardware_gazebo")
            self.joints = cars.steer_bot_joints(bodies, urdf, where, below)
        else:
            self.joints = joint_handles(bodies, described_joints(urdf, where), given)
        warn_of_rivals(self, self.mount.simulation.models[self.mount.model.name].plugins)
        return self

    @property
    def driven(self) -> list[str]:
        # An effort adds to what other plugins do.
        return [name for name, one in self.joints.items() if one.interface != EFFORT]

    def _press(self, stop: Stop) -> None:
        self.stopped = stop.pressed

    def load(self, name: str, parameters: ControlParameters) -> Controller:
        """Make a controller by its parameters, and return it; it does not run yet.

        Raises ControlError for a name that is loaded, an unknown type or an invalid parameter.
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
            controller = CONTROLLERS[kind](name, kind, self.namespace, parameters, self.joints)
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

        If one cannot be started or stopped, raises ControlError and changes nothing; if not
        `strict`, it is ignored, but no two running controllers may command the same joint.
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
        self._read()
        for one in (*self.joints.values(), *self.controllers.values()):
            one.placed()

    def reset(self, step: int) -> None:
        self._step = step
        self._read()
        for controller in self.controllers.values():
            controller.reset(step)

    def _chosen(self, names: Iterable[str], running: bool, strict: bool) -> list[Controller]:
        """Return the controllers of those names that run, or that do not run."""
        chosen: list[Controller] = []
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
    owners: dict[str, str] = {}
    for controller in controllers:
        for joint in controller.joints:
            owner = owners.setdefault(joint.name, controller.name)
            if owner != controller.name:
                both = f"'{owner}' and '{controller.name}'"
                raise ControlError(f"{both} would both command the joint '{joint.name}'")


class MimicJoint(Plugin):
    """Keeps a joint at multiplier · position + offset of another one.

    A motor moves it, or with hasPID an effort by the gains that `configure` gets. `gains` is the
    name of the parameters with them; empty without hasPID.
    """

    filenames = (
        "libroboticsgroup_gazebo_mimic_joint_plugin.so",
        "libroboticsgroup_upatras_gazebo_mimic_joint_plugin.so",
    )
    acts = True

    def __init__(self, mount: Mount):
        super().__init__(mount)
        self._leader, self._follower = self._joint("joint"), self._joint("mimicJoint")
        self._multiplier = mount.number("multiplier", 1.0)
        self._offset = mount.number("offset")
        self._most = mount.number("maxEffort", 1.0)
        self._least = mount.number("sensitiveness")
        # As in Gazebo's older plugin, the tag alone says yes.
        has_pid = mount.boolean("hasPID", "hasPID" in mount.plugin.tags)
        self._pid: Pid | None = None
        space = f"{mount.namespace}/gazebo_ros_control/pid_gains/{self._follower[1]}"
        self.gains = f"/{space.lstrip('/')}" if has_pid else ""

    def configure(self, parameters: object) -> None:
        """Take the gains; raises ControlError, and the motor goes on, without them."""
        self._pid = Pid(ControlParameters(parameters, self.gains))
        body, name = self._follower
        body.drive_joint(name, 0.0, 0.0)

    def before_step(self, step: int) -> None:
        body, name = self._leader
        lead = body.joint_state(name)
        target = lead.position * self._multiplier + self._offset
        body, name = self._follower
        error = target - body.joint_state(name).position
        if abs(error) < self._least:
            return
        if self._pid is None:
            # Where the leader will be after the step: a lag would feed the leader's oscillations.
            target += lead.velocity * self._multiplier * STEP_SECONDS
            body.hold_joint(name, target, STRONGEST, AT_ONCE)
        else:
            effort = self._pid.command(error, STEP_SECONDS)
            body.exert(name, min(max(effort, -self._most), self._most))

    def _joint(self, tag: str) -> tuple[Body, str]:
        """Return the joint that a tag names; raises PluginError."""
        name = self.mount.scoped(self.mount.required(tag))
        for body in self.mount.bodies.values():
            if name in body.joint_names:
                return body, name
        raise PluginError(f"{self.mount.where(tag)}: no movable joint '{name}'")
