"""What the services of /gazebo share: how they answer, and what they answer about."""

from __future__ import annotations

import traceback
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, List, Mapping

import rospy

from bullet_lab.errors import LabError
from bullet_lab.ros.stepper import Stepper
from bullet_lab.ros.wiring import Wiring
from bullet_lab.simulation.simulation import ModelInstance, Simulation


@dataclass
class RunningWorld:
    """A simulation that runs while services ask about it.

    Those in `changed` are called, in the thread that steps the simulation, after a model was
    added, taken away or put elsewhere, with its name; empty where many were.
    """

    stepper: Stepper
    wiring: Wiring
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


# Fields of a response besides success and status_message.
Answer = Dict[str, Any]


def offer(
    name: str,
    kind: Any,
    answer: Callable[[Any], Answer],
    done: str = "",
    failed: str = "",
) -> rospy.Service:
    """Offer a service of /gazebo that answers errors with success=False and what was wrong.

    Args:
        name: without /gazebo.
        kind: its type.
        answer: returns the fields of the response; raises LabError.
        done: the status message where all went well.
        failed: what stands before an error; the type's name by default.
    """
    fields = kind._response_class.__slots__
    prefix = failed or f"{kind.__name__}: "

    def handle(request: Any) -> Any:
        values: Answer = {"success": True, "status_message": done}
        try:
            values.update(answer(request))
        except LabError as error:
            values = {"success": False, "status_message": f"{prefix}{error}"}
        except rospy.ROSInterruptException:
            raise
        except Exception as error:
            # Whatever a client sends, it gets an answer, and the others' simulation goes on.
            rospy.logerr("/gazebo/%s: %s", name, traceback.format_exc())
            values = {"success": False, "status_message": f"{prefix}{error!r}"}
        if not values["success"] and "success" not in fields:
            rospy.logwarn("%s", values["status_message"])
        known = {key: value for key, value in values.items() if key in fields}
        return kind._response_class(**known)

    return rospy.Service(f"/gazebo/{name}", kind, handle)
