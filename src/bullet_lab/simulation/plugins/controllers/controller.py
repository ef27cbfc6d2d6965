"""Controllers and their manager, as ros_control's controller_manager has them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Dict, Iterable, List, Mapping, Sequence, Tuple, Type

from bullet_lab.core.schedule import Schedule, ScheduleError
from bullet_lab.simulation.plugins import Input, Output
from bullet_lab.simulation.plugins.controllers.description import ControlError, ControlParameters
from bullet_lab.simulation.plugins.controllers.hardware import JointHandle

# States of a controller in controller_manager_msgs/ControllerState.
INITIALIZED = "initialized"
RUNNING = "running"
STOPPED = "stopped"


@dataclass(frozen=True)
class ControllerSetup:
    """What a controller is made from.

    Attributes:
        name: of the controller.
        kind: its type in ros_control.
        namespace: of the robot, with a slash at its end.
        parameters: of the controller.
        handles: all joints of the robot that have a transmission, by name.
    """

    name: str
    kind: str
    namespace: str
    parameters: ControlParameters
    handles: Mapping[str, JointHandle]

    def topic(self, name: str) -> str:
        """Return a topic's name within the controller's namespace."""
        return f"{self.namespace}{self.name}/{name}"

    def joints(self, names: Sequence[str], interface: str) -> Tuple[JointHandle, ...]:
        """Return joints that take commands of an interface; raises ControlError."""
        usable = {name: one for name, one in self.handles.items() if one.interface == interface}
        for name in names:
            if name not in usable:
                have = ", ".join(usable) or "none"
                raise ControlError(f"no joint '{name}' has a {interface}; those are: {have}")
        return tuple(usable[name] for name in names)

    def schedule(self, rate: float) -> Schedule:
        """Return the schedule for a rate in Hz; raises ControlError."""
        try:
            return Schedule(rate)
        except ScheduleError as error:
            raise ControlError(f"{self.parameters.where}/publish_rate: {error}") from error


@dataclass(frozen=True)
class Adjustable:
    """A setting that can change while its controller runs; limits are for numbers only."""

    name: str
    value: Any
    description: str
    least: Any = ""
    greatest: Any = ""


class Controller(ABC):
    """Base of all controllers.

    While a controller runs, `update` is called at each control period. It reads its joints and
    writes their commands, which act until the next ones.

    Attributes:
        kinds: the types of ros_controllers that the class implements, each with its hardware
            interface.
        joints: those that it commands.
        inputs: topics with commands for it.
        outputs: topics with its samples.
        adjustables: the settings that `adjust` changes, with their first values.
    """

    kinds: ClassVar[Mapping[str, str]] = {}

    def __init_subclass__(cls, **arguments: Any):
        super().__init_subclass__(**arguments)
        _KINDS.update(dict.fromkeys(cls.__dict__.get("kinds", ()), cls))

    def __init__(self, setup: ControllerSetup):
        self.setup = setup
        self.name = setup.name
        self.interface = self.kinds[setup.kind]
        self.state = INITIALIZED
        self.joints: Tuple[JointHandle, ...] = ()
        self.inputs: Tuple[Input, ...] = ()
        self.outputs: Tuple[Output, ...] = ()
        self.adjustables: Tuple[Adjustable, ...] = ()

    @property
    def running(self) -> bool:
        """Whether it controls now."""
        return self.state == RUNNING

    def start(self, step: int) -> None:
        """Control from the simulated time `step` on."""
        self.starting(step)
        self.state = RUNNING

    def stop(self) -> None:
        """Stop controlling."""
        self.stopping()
        self.state = STOPPED

    def starting(self, step: int) -> None:
        """Prepare to run from the simulated time `step` on."""

    @abstractmethod
    def update(self, step: int, seconds: float) -> None:
        """Read and command joints at the simulated time `step`, `seconds` after the last time."""

    def stopping(self) -> None:
        """Write the last commands before a stop."""

    def placed(self) -> None:
        """Handle that the robot was placed somewhere else."""

    def reset(self, step: int) -> None:
        """Start anew after a reset of the robot; simulated time is now `step`."""

    def adjust(self, values: Mapping[str, Any], step: int) -> None:
        """Change the adjustable settings, by name, from the simulated time `step` on."""


_KINDS: Dict[str, Type[Controller]] = {}


def known_controllers() -> Tuple[str, ...]:
    """Return the types of controllers that are simulated."""
    return tuple(sorted(_KINDS))


class ControllerManager:
    """Loads, starts, stops and unloads the controllers of one robot.

    Attributes:
        joints: of the robot, by name.
        controllers: all that are loaded, by name.
        step: the present simulated time.
    """

    def __init__(self, joints: Mapping[str, JointHandle], namespace: str):
        self.joints = joints
        self.controllers: Dict[str, Controller] = {}
        self.step = 0
        self._namespace = namespace

    def load(self, name: str, parameters: ControlParameters) -> Controller:
        """Make a controller by its parameters, and return it; it does not run yet.

        Raises:
            ControlError: the name is loaded already, the type is not simulated, or a parameter
                is invalid.
        """
        if name in self.controllers:
            raise ControlError(f"controller '{name}' is loaded already")
        kind = parameters.text("type")
        if not kind:
            raise ControlError(f"controller '{name}': {parameters.where}/type is missing")
        if kind not in _KINDS:
            known = f"known are {', '.join(known_controllers())}"
            raise ControlError(f"controller '{name}': the type '{kind}' is not simulated; {known}")
        try:
            setup = ControllerSetup(name, kind, self._namespace, parameters, self.joints)
            self.controllers[name] = _KINDS[kind](setup)
        except ControlError as error:
            raise ControlError(f"controller '{name}': {error}") from error
        return self.controllers[name]

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
            controller.start(self.step)

    def restart(self) -> None:
        """Stop and start again all running controllers."""
        for controller in self.controllers.values():
            if controller.running:
                controller.stop()
                controller.start(self.step)

    def update(self, seconds: float) -> None:
        """Update all running controllers, `seconds` after the last time."""
        for controller in self.controllers.values():
            if controller.running:
                controller.update(self.step, seconds)

    def read(self) -> None:
        """Read the state of all joints."""
        for joint in self.joints.values():
            joint.read()

    def write(self, seconds: float, stopped: bool) -> None:
        """Let all joints act on the coming step; `stopped` is the emergency stop."""
        for joint in self.joints.values():
            joint.write(seconds, stopped)

    def placed(self) -> None:
        """Handle that the robot was placed somewhere else."""
        self.read()
        for one in (*self.joints.values(), *self.controllers.values()):
            one.placed()

    def reset(self, step: int) -> None:
        """Start anew after a reset of the robot; simulated time is now `step`."""
        self.step = step
        self.read()
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
