"""Controllers of ros_control: their base, and those of single joints.

They pass commands on, run a PID loop, or report joint states.
"""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Iterator, Mapping, Sequence

from bullet_lab.core.schedule import Schedule, ScheduleError
from bullet_lab.simulation.plugins import Device
from bullet_lab.simulation.plugins.controllers import ControlError, ControlParameters
from bullet_lab.simulation.plugins.controllers.joints import (
    EFFORT,
    POSITION,
    VELOCITY,
    JointHandle,
    Pid,
)
from bullet_lab.simulation.plugins.samples import (
    JointCommand,
    JointCommands,
    JointSample,
    LoopSample,
    is_sound,
)

LOG = logging.getLogger(__name__)

# States of a controller in controller_manager_msgs/ControllerState.
INITIALIZED = "initialized"
RUNNING = "running"
STOPPED = "stopped"
# The interface of a controller that only reads joints.
STATES = "JointStateInterface"
# Updates between two samples of a loop's state.
STATE_EVERY = 10
EXTRA_STATE = ("position", "velocity", "effort")


@dataclass(frozen=True)
class Setting:
    """A setting that can change while its owner runs.

    It has the type of its default; a number has limits, and a text choices.
    """

    name: str
    default: Any
    description: str
    min: Any = ""
    max: Any = ""
    choices: tuple[str, ...] = ()


class Controller(Device, ABC):
    """Base of all controllers.

    While a controller runs, `update` is called at each control period. It reads its joints and
    writes their commands, which act until the next ones. `namespace` is that of the robot, with a
    slash at its end; `handles` are all joints of the robot that have a transmission, by name.

    Attributes:
        kinds: the types of ros_controllers that the class implements, with their interfaces.
        joints: those that it commands.
        adjustables: the settings that `adjust` changes, with their first values.
    """

    kinds = {}

    def __init_subclass__(cls, **arguments: Any):
        super().__init_subclass__(**arguments)
        CONTROLLERS.update(dict.fromkeys(cls.__dict__.get("kinds", ()), cls))

    def __init__(
        self,
        name: str,
        kind: str,
        namespace: str,
        parameters: ControlParameters,
        handles: Mapping[str, JointHandle],
    ):
        self.name, self.kind, self.namespace = name, kind, namespace
        self.handles = handles
        self.interface = self.kinds[kind]
        self.state = INITIALIZED
        self.joints: tuple[JointHandle, ...] = ()
        self.adjustables: tuple[Setting, ...] = ()
        self.configure(parameters)

    @abstractmethod
    def configure(self, given: ControlParameters) -> None:
        """Read the parameters; raises ControlError."""

    def topic(self, name: str) -> str:
        """Return a topic's full name, which is within the controller's namespace."""
        return name if name.startswith("/") else f"{self.namespace}{self.name}/{name}"

    def find_joints(self, names: Sequence[str], *interfaces: str) -> tuple[JointHandle, ...]:
        """Return joints that take commands of one of the interfaces; raises ControlError.

        By default, it is that of the controller.
        """
        interfaces = interfaces or (self.interface,)
        usable = {name: j for name, j in self.handles.items() if j.interface in interfaces}
        for name in names:
            if name not in usable:
                have = ", ".join(usable) or "none"
                wanted = " or ".join(interfaces)
                raise ControlError(f"no joint '{name}' has a {wanted}; those are: {have}")
        return tuple(usable[name] for name in names)

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

    def adjust(self, values: Mapping[str, Any], step: int) -> None:
        """Change the adjustable settings, by name, from the simulated time `step` on."""


CONTROLLERS: dict[str, type[Controller]] = {}
"""The controllers that are simulated, by the types of ros_controllers."""


def schedule_of(rate: float, where: str, name: str = "publish_rate") -> Schedule:
    """Return the schedule for a rate in Hz; raises ControlError."""
    try:
        return Schedule(rate)
    except ScheduleError as error:
        raise ControlError(f"{where}/{name}: {error}") from error


def is_due(schedule: Schedule | None, step: int) -> bool:
    """Return whether an occurrence is due, and go on to the next one after `step`."""
    if schedule is None or step < schedule.next_step:
        return False
    while schedule.next_step <= step:
        schedule.advance()
    return True


class JointTargets(Controller):
    """Brings joints to targets from the topic `command`: a number, or one for each of a group.

    Parameters: joint, or joints for the kinds named JointGroup…. A target of the kind that a joint
    takes is passed on to it; as in ros_controllers, the joint keeps its last one when the
    controller stops. For the others there are PIDs, with the gains in pid, or <joint>/pid in a
    group; with them, the state of a single joint is sent at each tenth update.
    """

    passed_on = {
        "position_controllers/JointPositionController": POSITION,
        "position_controllers/JointGroupPositionController": POSITION,
        "velocity_controllers/JointVelocityController": VELOCITY,
        "velocity_controllers/JointGroupVelocityController": VELOCITY,
        "effort_controllers/JointEffortController": EFFORT,
        "effort_controllers/JointGroupEffortController": EFFORT,
    }
    kinds = {
        **passed_on,
        "effort_controllers/JointPositionController": EFFORT,
        "effort_controllers/JointGroupPositionController": EFFORT,
        "velocity_controllers/JointPositionController": VELOCITY,
        "effort_controllers/JointVelocityController": EFFORT,
    }

    def configure(self, given: ControlParameters) -> None:
        grouped = "/JointGroup" in self.kind
        if grouped:
            kind, names = JointCommands, given.required_names("joints")
        else:
            kind, names = JointCommand, (given.get("joint", ""),)
            if not names[0]:
                raise ControlError(f"{given.where}/joint is missing or empty; it must name a joint")
        self.by_position = self.kind.endswith("PositionController")
        self.joints = self.find_joints(names)
        self.input("command", kind, self.command)
        self.targets = (0.0,) * len(names)
        by_pid = () if self.kind in self.passed_on else names
        paths = [f"{name}/pid" if grouped else "pid" for name in by_pid]
        self._pids = [Pid(given.below(path)) for path in paths]
        self._updates = 0
        self.states = self.output("state", LoopSample, bool(by_pid) and not grouped)

    def starting(self, step: int) -> None:
        """Have the present positions as targets, or no velocity or effort."""
        self.targets = tuple(one.position if self.by_position else 0.0 for one in self.joints)
        for pid in self._pids:
            pid.reset()

    def command(self, command: JointCommand | JointCommands) -> None:
        """Take over new targets of the joints.

        Raises ControlError if their number is wrong, or one is not finite or too large.
        """
        values = (command.value,) if isinstance(command, JointCommand) else command.values
        if len(values) != len(self.joints):
            joints = len(self.joints)
            raise ControlError(f"{len(values)} numbers for the {joints} joints of '{self.name}'")
        if not is_sound(*values):
            raise ControlError(f"a command to '{self.name}' is not finite, or too large")
        self.targets = tuple(values)

    def update(self, step: int, seconds: float) -> None:
        if not self._pids:
            for joint, target in zip(self.joints, self.targets):
                joint.command = target
        for joint, pid, target in zip(self.joints, self._pids, self.targets):
            if self.by_position:
                value, slope = joint.position, joint.velocity
                target = joint.described.within_limits(target)
                error = joint.described.error(value, target)
            else:
                value, slope = joint.velocity, 0.0
                error = target - value
            joint.command = pid.command(error, seconds)
            if self._updates % STATE_EVERY == 0 and self.states.wanted:
                loop = (target, value, slope, error, seconds, joint.command)
                gains = (pid.p, pid.i, pid.d, pid.i_max)
                self.states.send(LoopSample(step, *loop, gains, pid.antiwindup))
        self._updates += 1


class JointStateController(Controller):
    """Sends the states of the joints that have a transmission, or of those in `joints`.

    Parameters: publish_rate in Hz, joints, and extra_joints, whose states are given there.
    """

    kinds = {"joint_state_controller/JointStateController": STATES}

    def configure(self, given: ControlParameters) -> None:
        rate = given.get("publish_rate")
        if rate is None:
            raise ControlError(f"{given.where}/publish_rate is missing")
        # As in ros_controllers, nothing is sent without a rate.
        self._schedule = schedule_of(rate, given.where) if rate > 0.0 else None
        names = given.names("joints") or tuple(self.handles)
        for name in names:
            if name not in self.handles:
                raise ControlError(f"no joint '{name}' has a transmission")
        self._read = [self.handles[name] for name in names]
        self._extra = tuple(_extra_joints(given, names))
        self._names = (*names, *(name for name, *_ in self._extra))
        self.states = self.output(f"{self.namespace}joint_states", JointSample)
        self._begun = False

    def starting(self, step: int) -> None:
        if not self._begun:
            self.reset(step)

    def reset(self, step: int) -> None:
        self._begun = False
        if self._schedule is not None:
            self._schedule.restart(step)

    def update(self, step: int, seconds: float) -> None:
        is_late = is_due(self._schedule, step)
        if self._schedule is None or (self._begun and not is_late):
            return
        self._begun = True
        if self.states.wanted:
            states = [(joint.position, joint.velocity, joint.effort) for joint in self._read]
            states += [state for _, *state in self._extra]
            self.states.send(JointSample(step, self._names, *zip(*states)))


def _extra_joints(
    parameters: ControlParameters, taken: Sequence[str]
) -> Iterator[tuple[str, float, float, float]]:
    """Yield name, position, velocity and effort of each extra joint; ignore invalid entries."""
    extra = parameters.value("extra_joints")
    if extra is not None and not isinstance(extra, list):
        LOG.warning("%s/extra_joints is not a list; ignored", parameters.where)
        return
    for number, entry in enumerate(extra or ()):
        given = ControlParameters(entry, f"{parameters.where}/extra_joints[{number}]")
        name = given.get("name", "")
        if not name or name in taken:
            LOG.warning("%s: the name '%s' is missing or taken; ignored", given.where, name)
            continue
        yield (name, *(given.get(key, 0.0) for key in EXTRA_STATE))
