"""Calling the services of a running simulator, this package's or Gazebo."""

from __future__ import annotations

import re
from typing import Any, Iterable, List

import rospy

from bullet_lab.ros.node.node import NodeError, wait_until


def call(service: str, kind: type, *arguments: Any) -> Any:
    """Call a service once it is there.

    Raises:
        NodeError: it does not answer, or answers that it has not succeeded.
        ROSInterruptException: ROS shuts down first.
    """
    wait_until(lambda: _is_offered(service), service)
    try:
        answer = rospy.ServiceProxy(service, kind)(*arguments)
    except rospy.ServiceException as error:
        raise NodeError(f"{service}: {error}") from error
    if not answer.success:
        raise NodeError(f"{service}: {answer.status_message}")
    return answer


def _is_offered(service: str) -> bool:
    try:
        rospy.wait_for_service(service, 0.2)
    except rospy.ROSInterruptException:
        raise
    except rospy.ROSException:
        return False
    return True


def numbered(names: Iterable[str], name: str) -> List[str]:
    """Return those names that are `name`, an underscore and a number."""
    wanted = re.compile(rf"{re.escape(name)}_\d+")
    return [found for found in names if wanted.fullmatch(found)]
