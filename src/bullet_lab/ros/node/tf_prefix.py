"""The tf_prefix that keeps the frames of several robots apart, as the tf library finds it."""

from __future__ import annotations

from typing import Callable, Dict

import rosgraph
import rospy

from bullet_lab.simulation.world.description import Model

PARAMETER = "tf_prefix"


def tf_prefix_in(namespace: str) -> str:
    """Return the tf_prefix that holds in a namespace: its own, or that of one around it."""
    # The search begins in the namespace of whoever asks.
    master = rosgraph.Master(f"/{namespace.strip('/')}/robot".replace("//", "/"))
    try:
        found = master.searchParam(PARAMETER)
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


def own_tf_prefix() -> str:
    """Return what stands before the frames of the node that asks, with its slash, or nothing."""
    found = rospy.search_param(PARAMETER)
    prefix = str(rospy.get_param(found)).strip("/") if found else ""
    return f"{prefix}/" if prefix else ""


def own_frame(frame: str) -> str:
    """Return the full name of a frame that the node that asks means.

    As with the tf library, its tf_prefix goes before names that do not begin with a slash; a
    name that has it already stays.
    """
    prefix = own_tf_prefix()
    if not frame or frame.startswith(("/", prefix)):
        return frame.lstrip("/")
    return prefix + frame
