"""A simulation that runs while others ask about it and change it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Callable, List, Mapping

from bullet_lab.ros.bridge.device_topics import DeviceTopics
from bullet_lab.ros.bridge.stepper import Stepper
from bullet_lab.simulation.simulation import ModelInstance, Simulation


@dataclass
class RunningWorld:
    """A simulation that runs while services ask about it.

    Those in `changed` are called, in the thread that steps the simulation, after a model was
    added, taken away or put elsewhere, with its name; empty where many were.
    """

    stepper: Stepper
    topics: DeviceTopics
    changed: List[Callable[[str], None]] = field(default_factory=list)

    @property
    def simulation(self) -> Simulation:
        """The simulation itself, for the thread that steps it."""
        return self.stepper.simulation

    @property
    def models(self) -> Mapping[str, ModelInstance]:
        """All models by name, for the thread that steps the simulation."""
        return self.simulation.models

    def do(self, action: Callable[[], Any]) -> Any:
        """Have something done between two steps; return what it returns."""
        return self.stepper.do(action)

    def change(self, action: Callable[[], str]) -> None:
        """Have something changed between two steps, and tell those who show the world.

        Args:
            action: returns the name of the model that it has changed; empty for many.
        """

        def change() -> None:
            name = action()
            for listener in self.changed:
                listener(name)

        self.do(change)
