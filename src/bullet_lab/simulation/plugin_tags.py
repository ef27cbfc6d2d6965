"""Reading `<plugin>` tags, which URDF and SDF share."""

from __future__ import annotations

from typing import Iterator, Optional
from xml.etree.ElementTree import Element

from bullet_lab.simulation.description import Plugin


def plugins_in(parent: Element, link: str = "") -> Iterator[Plugin]:
    """Yield the plugins that stand in an element or in the sensors below it."""
    for element in parent.findall("plugin"):
        yield read_plugin(element, link)
    for sensor in parent.findall("sensor"):
        for element in sensor.findall("plugin"):
            yield read_plugin(element, link, sensor)


def read_plugin(element: Element, link: str = "", sensor: Optional[Element] = None) -> Plugin:
    """Return a `<plugin>` element as data."""
    tags = {child.tag: (child.text or "").strip() for child in element}
    filename, name = element.get("filename", ""), element.get("name", "")
    return Plugin(filename, name, tags, link, sensor, element)
