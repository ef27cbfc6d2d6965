"""Services of /gazebo, which answer what is wrong instead of failing."""

from __future__ import annotations

import traceback
from functools import partial
from typing import Any, Callable, Dict

import rospy

from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.running_world import RunningWorld

# Fields of a response besides success and status_message.
Answer = Dict[str, Any]


def offer(
    name: str, kind: Any, answer: Callable[[Any], Answer], done: str = "", failed: str = ""
) -> rospy.Service:
    """Offer a service of /gazebo that answers errors with success=False and what was wrong.

    `answer` returns the fields of the response, and `done` is the status message where all went
    well; `failed` stands before an error, the type's name by default.
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


def offer_between_steps(
    world: RunningWorld,
    name: str,
    kind: Any,
    answer: Callable[[Any], Answer],
    done: str = "got properties",
) -> rospy.Service:
    """Offer a service that is answered between two steps; `done` follows the type's name."""

    def between_steps(request: Any) -> Answer:
        return world.do(partial(answer, request))

    return offer(name, kind, between_steps, done and f"{kind.__name__}: {done}")
