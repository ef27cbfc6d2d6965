"""Controllers of single joints: they pass commands on, run a PID loop, or report joint states."""

from __future__ import annotations

import logging
from typing import Iterator, Sequence, Tuple, Union

from bullet_lab.simulation.plugins import Input, Output
from bullet_lab.simulation.plugins.controllers.controller import Controller, ControllerSetup
from bullet_lab.simulation.plugins.controllers.description import (
    EFFORT,
    POSITION,
    VELOCITY,
    ControlError,
    ControlParameters,
)
from bullet_lab.simulation.plugins.controllers.hardware import JointHandle
from bullet_lab.simulation.plugins.controllers.pid import Pid, PidGains
from bullet_lab.simulation.plugins.samples import (
    JointCommand,
    JointCommands,
    JointSample,
    LoopSample,
    is_sound,
)

LOG = logging.getLogger(__name__)

# The interface of a controller that only reads joints.
STATES = "JointStateInterface"
EFFORT_FOR_VELOCITY = "effort_controllers/JointVelocityController"
# Updates between two samples of a loop's state.
STATE_EVERY = 10
EXTRA_STATE = ("position", "velocity", "effort")


class JointTargets(Controller):
    """Takes a number for a joint, or one for each joint of a group, on the topic `command`.

    Parameters: joint, or joints for the kinds named JointGroup….
    """

    def __init__(self, setup: ControllerSetup):
        super().__init__(setup)
        self.grouped = "/JointGroup" in setup.kind
        if self.grouped:
            names = setup.parameters.required_names("joints")
        else:
            names = (setup.parameters.text("joint"),)
            if not names[0]:
                raise ControlError(f"{setup.parameters.where}/joint names no joint")
        kind = JointCommands if self.grouped else JointCommand
        self.joints = setup.joints(names, self.interface)
        self.inputs = (Input(setup.topic("command"), kind, self.command),)
        self.targets: Tuple[float, ...] = (0.0,) * len(names)

    def command(self, command: Union[JointCommand, JointCommands]) -> None:
        """Take over new targets of the joints.

        Raises:
            ControlError: the number of values is not that of the joints, or a value is not finite
                or exceeds `LARGEST_COMMAND`.
        """
        values = (command.value,) if isinstance(command, JointCommand) else command.values
        if len(values) != len(self.joints):
            joints = len(self.joints)
            raise ControlError(f"{len(values)} numbers for the {joints} joints of '{self.name}'")
        if not is_sound(*values):
            raise ControlError(f"a command to '{self.name}' is not finite, or too large")
        self.targets = tuple(values)


class ForwardCommand(JointTargets):
    """Passes commands on to the joints.

    Until the first command, the targets are the present positions, or no velocity or effort. As
    in ros_controllers, a joint keeps its last command when the controller stops.
    """

    kinds = {
        "position_controllers/JointPositionController": POSITION,
        "position_controllers/JointGroupPositionController": POSITION,
        "velocity_controllers/JointVelocityController": VELOCITY,
        "velocity_controllers/JointGroupVelocityController": VELOCITY,
        "effort_controllers/JointEffortController": EFFORT,
        "effort_controllers/JointGroupEffortController": EFFORT,
    }

    def starting(self, step: int) -> None:
        by_position = self.interface == POSITION
        self.targets = tuple(joint.position if by_position else 0.0 for joint in self.joints)

    def update(self, step: int, seconds: float) -> None:
        for joint, target in zip(self.joints, self.targets):
            joint.command = target


class JointPid(JointTargets):
    """Brings joints to a position or velocity by an effort, or to a position by a velocity.

    Parameters besides those of the joints: the gains in pid, or <joint>/pid in a group. The state
    of a single joint is sent at each tenth update.
    """

    kinds = {
        "effort_controllers/JointPositionController": EFFORT,
        "effort_controllers/JointGroupPositionController": EFFORT,
        "velocity_controllers/JointPositionController": VELOCITY,
        EFFORT_FOR_VELOCITY: EFFORT,
    }

    def __init__(self, setup: ControllerSetup):
        super().__init__(setup)
        paths = [f"{joint.name}/pid" if self.grouped else "pid" for joint in self.joints]
        self._pids = [Pid(PidGains.of(setup.parameters.below(path))) for path in paths]
        self._by_velocity = setup.kind == EFFORT_FOR_VELOCITY
        self._updates = 0
        self.states = Output(setup.topic("state"), LoopSample)
        self.outputs = () if self.grouped else (self.states,)

    def starting(self, step: int) -> None:
        self.targets = tuple(0.0 if self._by_velocity else one.position for one in self.joints)
        for pid in self._pids:
            pid.reset()

    def update(self, step: int, seconds: float) -> None:
        for joint, pid, target in zip(self.joints, self._pids, self.targets):
            if self._by_velocity:
                error = target - joint.velocity
            else:
                target = joint.described.within_limits(target)
                error = joint.described.error(joint.position, target)
            joint.command = pid.command(error, seconds)
            if self._updates % STATE_EVERY == 0 and self.outputs and self.states.wanted:
                self._send_state(step, seconds, joint, pid, target, error)
        self._updates += 1

    def _send_state(
        self, step: int, seconds: float, joint: JointHandle, pid: Pid, target: float, error: float
    ) -> None:
        by_velocity, gains = self._by_velocity, pid.gains
        sample = LoopSample(
            step=step,
            target=target,
            value=joint.velocity if by_velocity else joint.position,
            slope=0.0 if by_velocity else joint.velocity,
            error=error,
            seconds=seconds,
            command=joint.command,
            gains=(gains.p, gains.i, gains.d, gains.i_max),
            antiwindup=gains.antiwindup,
        )
        self.states.send(sample)


class JointStates(Controller):
    """Sends the states of the joints that have a transmission, or of those in `joints`.

    Parameters: publish_rate in Hz, joints, and extra_joints, whose states are given there.
    """

    kinds = {"joint_state_controller/JointStateController": STATES}

    def __init__(self, setup: ControllerSetup):
        super().__init__(setup)
        rate = setup.parameters.optional_number("publish_rate")
        if rate is None:
            raise ControlError(f"{setup.parameters.where}/publish_rate is missing")
        # As in ros_controllers, nothing is sent without a rate.
        self._schedule = setup.schedule(rate) if rate > 0.0 else None
        names = setup.parameters.names("joints") or tuple(setup.handles)
        missing = [name for name in names if name not in setup.handles]
        if missing:
            raise ControlError(f"no joint '{missing[0]}' has a transmission")
        self._read = [setup.handles[name] for name in names]
        self._extra = tuple(_extra_joints(setup.parameters, names))
        self._names = (*names, *(name for name, *_ in self._extra))
        self.states = Output(f"{setup.namespace}joint_states", JointSample)
        self.outputs = (self.states,)
        self._begun = False

    def starting(self, step: int) -> None:
        if not self._begun:
            self.reset(step)

    def reset(self, step: int) -> None:
        self._begun = False
        if self._schedule is not None:
            self._schedule.restart(step)

    def update(self, step: int, seconds: float) -> None:
        if self._schedule is None or (self._begun and step < self._schedule.next_step):
            return
        while self._schedule.next_step <= step:
            self._schedule.advance()
        self._begun = True
        if self.states.wanted:
            states = [(joint.position, joint.velocity, joint.effort) for joint in self._read]
            states += [state for _, *state in self._extra]
            self.states.send(JointSample(step, self._names, *zip(*states)))


def _extra_joints(
    parameters: ControlParameters, taken: Sequence[str]
) -> Iterator[Tuple[str, float, float, float]]:
    """Yield name, position, velocity and effort of each extra joint; ignore invalid entries."""
    extra = parameters.value("extra_joints")
    if extra is not None and not isinstance(extra, list):
        LOG.warning("%s/extra_joints is not a list; ignored", parameters.where)
        return
    for number, entry in enumerate(extra or ()):
        given = ControlParameters(entry, f"{parameters.where}/extra_joints[{number}]")
        name = given.text("name")
        if not name or name in taken:
            LOG.warning("%s: the name '%s' is missing or taken; ignored", given.where, name)
            continue
        yield (name, *(given.number(key, 0.0) for key in EXTRA_STATE))
