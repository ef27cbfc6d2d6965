"""Small parts of SDF documents that are written."""

from __future__ import annotations

from typing import Any, Iterable
from xml.etree.ElementTree import Element, SubElement

from bullet_lab.simulation.pose import Pose

INDENT = "  "


def numbers_text(values: Iterable[float]) -> str:
    """Return numbers with blanks between them, none rounded."""
    return " ".join(repr(float(value)) for value in values)


def add_text(parent: Element, tag: str, text: Any, **attributes: str) -> Element:
    """Add an element that holds a text."""
    element = SubElement(parent, tag, attributes)
    element.text = str(text)
    return element


def add_flag(parent: Element, tag: str, value: bool) -> None:
    """Add an element that says true or false."""
    add_text(parent, tag, "true" if value else "false")


def pose_text(pose: Pose) -> str:
    """Return x, y, z, roll, pitch and yaw."""
    return numbers_text((*pose.position, *pose.rpy()))


def add_pose(parent: Element, pose: Pose, **attributes: str) -> None:
    """Add a pose, in a `frame` if one is given."""
    add_text(parent, "pose", pose_text(pose), **attributes)


def indent(element: Element, level: int = 0) -> None:
    """Put each element that stands in others on a line of its own."""
    if not len(element):
        return
    inner = "\n" + INDENT * (level + 1)
    if not (element.text or "").strip():
        element.text = inner
    for child in element:
        indent(child, level + 1)
        if not (child.tail or "").strip():
            child.tail = inner
    element[-1].tail = "\n" + INDENT * level
