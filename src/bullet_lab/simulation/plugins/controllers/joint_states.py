"""joint_state_controller: says where the joints are."""

from __future__ import annotations

import logging
from typing import Any, Iterator, Tuple

from bullet_lab.simulation.plugins.controllers.controller import (
    STATES,
    Controller,
    ControllerSetup,
)
from bullet_lab.simulation.plugins.controllers.parameters import ControlError, ControlParameters
from bullet_lab.simulation.plugins.plugin import Output
from bullet_lab.simulation.plugins.samples import JointSample

LOG = logging.getLogger(__name__)


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
        # As in ros_controllers, it is silent without a rate.
        self._schedule = setup.schedule(rate) if rate > 0.0 else None
        known = setup.hardware.joints
        names = setup.parameters.names("joints") or tuple(known)
        missing = [name for name in names if name not in known]
        if missing:
            raise ControlError(f"no joint '{missing[0]}' has a transmission")
        self._read = [known[name] for name in names]
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
            states = [(j.position, j.velocity, j.effort) for j in self._read]
            states += [state for _, *state in self._extra]
            self.states.send(JointSample(step, self._names, *zip(*states)))


def _extra_joints(
    parameters: ControlParameters, taken: Tuple[str, ...]
) -> Iterator[Tuple[str, float, float, float]]:
    """Yield name, position, velocity and effort of each; what makes no sense is left out."""
    extra: Any = parameters.value("extra_joints")
    for number, entry in enumerate(extra if isinstance(extra, list) else ()):
        told = ControlParameters(entry, f"{parameters.where}/extra_joints[{number}]")
        name = told.text("name")
        if not name or name in taken:
            LOG.warning("%s: the name '%s' is missing or taken: left out", told.where, name)
            continue
        yield (name, *(told.number(key, 0.0) for key in ("position", "velocity", "effort")))
    if extra is not None and not isinstance(extra, list):
        LOG.warning("%s/extra_joints is no list: left out", parameters.where)
