"""What controllers have in common: their kinds, parameters, joints, topics and states."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Dict, Mapping, Tuple, Type

from bullet_lab.core.schedule import Schedule, ScheduleError
from bullet_lab.simulation.plugins.controllers.description import EFFORT, POSITION, VELOCITY
from bullet_lab.simulation.plugins.controllers.hardware import JointHandle, RobotHardware
from bullet_lab.simulation.plugins.controllers.parameters import ControlError, ControlParameters
from bullet_lab.simulation.plugins.plugin import Input, Output

# What a controller that only reads joints claims.
STATES = "JointStateInterface"
# States of a controller, in the words of controller_manager_msgs/ControllerState.
INITIALIZED, RUNNING, STOPPED = "initialized", "running", "stopped"


@dataclass(frozen=True)
class ControllerSetup:
    """What a controller is made of: its name and kind, its parameters, and the robot's hardware.

    `namespace` is the robot's, with a slash at its end, before all topics that are its own.
    """

    name: str
    kind: str
    namespace: str
    parameters: ControlParameters
    hardware: RobotHardware

    def topic(self, name: str) -> str:
        """Return a topic's name within the controller's own namespace."""
        return f"{self.namespace}{self.name}/{name}"

    def joints(self, names: Tuple[str, ...], interface: str) -> Tuple[JointHandle, ...]:
        """Return joints that take commands of an interface; raises ControlError."""
        return tuple(self.hardware.joint(name, interface) for name in names)

    def joint_name(self) -> str:
        """Return the parameter `joint`; raises ControlError without one."""
        name = self.parameters.text("joint")
        if not name:
            raise ControlError(f"{self.parameters.where}/joint names no joint")
        return name

    def schedule(self, rate: float) -> Schedule:
        """Return the schedule for a rate in Hz; raises ControlError."""
        try:
            return Schedule(rate)
        except ScheduleError as error:
            raise ControlError(f"{self.parameters.where}/publish_rate: {error}") from error


@dataclass(frozen=True)
class Adjustable:
    """What can be changed of a controller while it runs: its value, and its limits of a number."""

    name: str
    value: Any
    description: str
    least: Any = ""
    greatest: Any = ""


class Controller(ABC):
    """Base of all controllers.

    While it runs, `update` is called at each control period. It reads its joints, and writes
    their commands, which act until others are written.

    Attributes:
        kinds: the names of the controllers of ros_controllers that the class stands for, each
            with the hardware interface that it takes.
        joints: those that it commands.
        inputs: topics with commands for it.
        outputs: topics with what it says.
        adjustables: what `adjust` changes, as it is at the start.
    """

    kinds: ClassVar[Mapping[str, str]] = {}

    def __init_subclass__(cls, **arguments: Any):
        super().__init_subclass__(**arguments)
        _KINDS.update(dict.fromkeys(cls.__dict__.get("kinds", ()), cls))

    def __init__(self, setup: ControllerSetup):
        self.setup = setup
        self.state = INITIALIZED
        self.joints: Tuple[JointHandle, ...] = ()
        self.inputs: Tuple[Input, ...] = ()
        self.outputs: Tuple[Output, ...] = ()
        self.adjustables: Tuple[Adjustable, ...] = ()

    @property
    def name(self) -> str:
        """Its name."""
        return self.setup.name

    @property
    def interface(self) -> str:
        """The hardware interface of its joints."""
        return self.kinds[self.setup.kind]

    @property
    def running(self) -> bool:
        """Whether it controls now."""
        return self.state == RUNNING

    def start(self, step: int) -> None:
        """Control from the simulated time `step` on."""
        self.starting(step)
        self.state = RUNNING

    def stop(self) -> None:
        """Control no longer."""
        self.stopping()
        self.state = STOPPED

    def starting(self, step: int) -> None:
        """Get ready, at the simulated time `step`."""

    @abstractmethod
    def update(self, step: int, seconds: float) -> None:
        """Read and command joints at the simulated time `step`, `seconds` after the last time."""

    def stopping(self) -> None:
        """Leave the joints in order."""

    def placed(self) -> None:
        """Take note that the robot was put somewhere else."""

    def reset(self, step: int) -> None:
        """Begin anew after the robot was put back; simulated time is now `step`."""

    def adjust(self, values: Mapping[str, Any], step: int) -> None:
        """Change what is adjustable, by its names, from the simulated time `step` on."""

    def _refuse_unless_running(self) -> None:
        if not self.running:
            raise ControlError(f"controller '{self.name}' is not running")


_KINDS: Dict[str, Type[Controller]] = {}


def known_controllers() -> Tuple[str, ...]:
    """Return the names of the kinds of controllers that are simulated."""
    return tuple(sorted(_KINDS))


def make_controller(setup: ControllerSetup) -> Controller:
    """Return a controller of the kind that is asked for; raises ControlError."""
    kind = _KINDS.get(setup.kind)
    if kind is None:
        known = ", ".join(known_controllers())
        raise ControlError(f"the type '{setup.kind}' is not simulated; known are {known}")
    return kind(setup)


__all__ = [
    "EFFORT",
    "POSITION",
    "STATES",
    "VELOCITY",
    "Adjustable",
    "Controller",
    "ControllerSetup",
    "known_controllers",
    "make_controller",
]
