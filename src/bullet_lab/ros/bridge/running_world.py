"""A simulation that runs while others ask about it and change it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Callable, Dict, List, Mapping

import rosgraph

from bullet_lab.ros.bridge.device_topics import DeviceTopics
from bullet_lab.ros.bridge.stepper import Stepper
from bullet_lab.ros.node.node import TF_PREFIX
from bullet_lab.simulation.simulation import ModelInstance, Simulation
from bullet_lab.simulation.world.description import Model


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


def tf_prefix_in(namespace: str) -> str:
    """Return the tf_prefix that holds in a namespace: its own, or that of one around it."""
    # The search begins in the namespace of whoever asks.
    master = rosgraph.Master(f"/{namespace.strip('/')}/robot".replace("//", "/"))
    try:
        found = master.searchParam(TF_PREFIX)
        return str(master.getParam(found)) if found else ""
    except rosgraph.MasterException:
        # There is none.
        return ""


def tf_prefixes(model: Model, namespace: str) -> Callable[[str], str]:
    """Return what gives the tf_prefix for the robotNamespace of each of a model's plugins.

    Args:
        model: whose plugins they are.
        namespace: robotNamespace of those that name none.
    """
    spaces = {namespace, *(p.tags.get("robotNamespace", "") for p in model.plugins)}
    prefixes: Dict[str, str] = {space: tf_prefix_in(space) for space in spaces}
    return lambda space: prefixes.get(space, "")
