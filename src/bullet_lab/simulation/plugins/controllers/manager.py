"""Loads, starts, stops and unloads a robot's controllers, as ros_control's controller_manager."""

from __future__ import annotations

from typing import Dict, Iterable, List, Mapping, Sequence

from bullet_lab.simulation.plugins.controllers.controller import (
    Controller,
    ControllerSetup,
    make_controller,
)
from bullet_lab.simulation.plugins.controllers.hardware import RobotHardware
from bullet_lab.simulation.plugins.controllers.parameters import ControlError, ControlParameters


class ControllerManager:
    """The controllers of one robot.

    Attributes:
        hardware: their joints.
        step: the present simulated time.
    """

    def __init__(self, hardware: RobotHardware, namespace: str):
        self.hardware, self.step = hardware, 0
        self._namespace = namespace
        self._loaded: Dict[str, Controller] = {}

    @property
    def controllers(self) -> Mapping[str, Controller]:
        """All that are loaded, by name."""
        return self._loaded

    def load(self, name: str, parameters: ControlParameters) -> Controller:
        """Make a controller by its parameters, and return it; it does not run yet.

        Raises:
            ControlError: it is loaded already, its type is not simulated, or it cannot be.
        """
        if name in self._loaded:
            raise ControlError(f"controller '{name}' is loaded already")
        kind = parameters.text("type")
        if not kind:
            raise ControlError(f"controller '{name}': {parameters.where}/type is missing")
        setup = ControllerSetup(name, kind, self._namespace, parameters, self.hardware)
        try:
            self._loaded[name] = make_controller(setup)
        except ControlError as error:
            raise ControlError(f"controller '{name}': {error}") from error
        return self._loaded[name]

    def unload(self, name: str) -> Controller:
        """Forget a controller, and return it; raises ControlError for one that runs or is not."""
        if name not in self._loaded:
            raise ControlError(f"no controller '{name}' is loaded")
        if self._loaded[name].running:
            raise ControlError(f"controller '{name}' is running: it has to be stopped first")
        return self._loaded.pop(name)

    def switch(self, start: Sequence[str], stop: Sequence[str], strict: bool = True) -> None:
        """Stop some controllers and start others, between two steps.

        What cannot be is passed over where it is not `strict`, less a conflict: two controllers
        that run at once command no joint both.

        Raises:
            ControlError: something cannot be; nothing is changed.
        """
        for name in set(start) & set(stop) & set(self._loaded):
            raise ControlError(f"controller '{name}' cannot be started and stopped at once")
        to_stop = self._chosen(stop, True, strict)
        to_start = self._chosen(start, False, strict)
        running = [c for c in self._loaded.values() if c.running and c not in to_stop]
        self._refuse_conflicts(running + to_start)
        for controller in to_stop:
            controller.stop()
        for controller in to_start:
            controller.start(self.step)

    def restart(self) -> None:
        """Stop and start again all that run."""
        names = [controller.name for controller in self._loaded.values() if controller.running]
        for name in names:
            self._loaded[name].stop()
            self._loaded[name].start(self.step)

    def update(self, seconds: float) -> None:
        """Let all that run read and command their joints, `seconds` after the last time."""
        for controller in self._loaded.values():
            if controller.running:
                controller.update(self.step, seconds)

    def placed(self) -> None:
        """Take note that the robot was put somewhere else."""
        self.hardware.read()
        self.hardware.placed()
        for controller in self._loaded.values():
            controller.placed()

    def reset(self, step: int) -> None:
        """Begin anew after the robot was put back; simulated time is now `step`."""
        self.step = step
        self.hardware.read()
        for controller in self._loaded.values():
            controller.reset(step)

    def _chosen(self, names: Iterable[str], running: bool, strict: bool) -> List[Controller]:
        """Return the controllers of those names that run, or that do not."""
        chosen: List[Controller] = []
        for name in dict.fromkeys(names):
            controller = self._loaded.get(name)
            if controller is not None and controller.running is running:
                chosen.append(controller)
            elif strict and controller is None:
                raise ControlError(f"no controller '{name}' is loaded")
            elif strict:
                state = "not running" if running else "running already"
                raise ControlError(f"controller '{name}' is {state}")
        return chosen

    @staticmethod
    def _refuse_conflicts(controllers: Iterable[Controller]) -> None:
        owners: Dict[str, str] = {}
        for controller in controllers:
            for joint in controller.joints:
                owner = owners.setdefault(joint.name, controller.name)
                if owner != controller.name:
                    both = f"'{owner}' and '{controller.name}'"
                    raise ControlError(f"{both} would both command the joint '{joint.name}'")
