"""Saying what of an SDF document is not simulated, once each by name."""

from __future__ import annotations

import logging
from typing import Iterator, Set
from xml.etree.ElementTree import Element

from bullet_lab.simulation.world.xml import child_text

LOG = logging.getLogger(__name__)

# The elements that are looked into, and what is read of each.
READ = {
    "sdf": {"world", "model", "light", "include"},
    "world": {"model", "light", "include", "gravity", "scene", "state", "physics"},
    "model": {"link", "joint", "plugin", "pose", "static", "frame", "include", "model"},
    "link": {"pose", "inertial", "visual", "collision", "sensor", "plugin", "self_collide"},
    "visual": {"geometry", "pose", "material", "cast_shadows"},
    "collision": {"geometry", "pose", "surface"},
    "joint": {"parent", "child", "pose", "axis", "axis2"},
    "surface": {"friction", "contact"},
    "physics": set(),
}
# What Gazebo writes into every world that it saves, or what changes nothing that can be seen here.
QUIET = {
    "world": {"gui", "atmosphere", "wind", "magnetic_field", "spherical_coordinates", "audio"},
    "model": {"allow_auto_disable"},
    "link": {"must_be_base_link"},
    "visual": {"meta", "laser_retro"},
    "collision": {"max_contacts", "laser_retro"},
    "joint": {"physics", "sensor"},
    # How Gazebo's engines compute is their own business.
    "physics": {"ode", "bullet", "simbody", "dart", "max_contacts", "real_time_factor"},
}
# Texts that ask for what happens anyway.
AS_IT_IS = {
    "gravity": ("1", "true"),
    "kinematic": ("0", "false"),
    "enable_wind": ("0", "false"),
    "self_collide": ("0", "false"),
    "transparency": ("0", "0.0"),
    "max_step_size": ("0.001", "1e-3", "1e-03"),
    "real_time_update_rate": ("1000", "1000.0"),
}


def report_unknown(root: Element, source: str, reported: Set[str]) -> None:
    """Warn of each kind of tag that is not simulated.

    Args:
        root: the <sdf>.
        source: names the document in messages.
        reported: what was said already; it grows.
    """
    for text in _unknown(root):
        message = f"{source}: {text}"
        if message not in reported:
            reported.add(message)
            LOG.warning("%s", message)


def _unknown(element: Element) -> Iterator[str]:
    read, quiet = READ[element.tag], QUIET.get(element.tag, ())
    for child in element:
        if child.tag in READ and child.tag in read:
            yield from _unknown(child)
        elif child.tag not in read and child.tag not in quiet and _asks_for_something(child):
            yield f"<{element.tag}>: {_name(child)} is not simulated"


def _asks_for_something(element: Element) -> bool:
    if element.tag == "bounce":
        return child_text(element, "restitution_coefficient", "0") not in ("0", "0.0")
    return (element.text or "").strip() not in AS_IT_IS.get(element.tag, ())


def _name(element: Element) -> str:
    if element.tag == "plugin":
        return f"plugin '{element.get('name', '')}' ({element.get('filename', '')})"
    return f"<{element.tag}>"
