"""Reading XML that comes from outside, without letting it reach anything else."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Iterator, Optional, Tuple
from xml.etree.ElementTree import Element, ParseError

import defusedxml.ElementTree
from defusedxml.common import DefusedXmlException

from bullet_lab.errors import LabError
from bullet_lab.simulation.world.description import Plugin

# A description of a robot or a world is text for people; meshes are files of their own.
MAXIMUM_BYTES = 20_000_000
# Squares and cubes of larger ones would overflow; SDF writes 1e16 for "no limit".
LARGEST_NUMBER = 1e18


class XmlError(LabError):
    """A document cannot be read or does not say what it must."""


def parse_text(text: str, source: str) -> Element:
    """Parse XML text; `source` names it in messages.

    Document types are refused altogether: entities can read files and the network, and no
    robot needs them.

    Raises:
        XmlError: not well formed, too large, or with a document type.
    """
    if len(text) > MAXIMUM_BYTES:
        raise XmlError(f"{source}: larger than {MAXIMUM_BYTES} bytes")
    try:
        # Given as text, not as bytes: whatever encoding the document declares is passed over.
        return defusedxml.ElementTree.fromstring(text, forbid_dtd=True)
    except ParseError as error:
        raise XmlError(f"{source}: not well-formed XML: {error}") from error
    except DefusedXmlException as error:
        raise XmlError(f"{source}: document types and entities are refused") from error
    except UnicodeError as error:
        raise XmlError(f"{source}: not Unicode text") from error


def read_text(path: Path) -> str:
    """Return the text of a file.

    Raises:
        XmlError: the file is missing, unreadable, too large or not UTF-8.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAXIMUM_BYTES + 1)
        if len(data) > MAXIMUM_BYTES:
            raise XmlError(f"{path}: larger than {MAXIMUM_BYTES} bytes")
        return data.decode()
    except OSError as error:
        raise XmlError(f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise XmlError(f"{path}: not UTF-8 text") from error


def numbers(text: Optional[str], count: int, what: str) -> Tuple[float, ...]:
    """Return the `count` finite numbers in a text.

    Raises:
        XmlError: other than `count` finite numbers; `what` names the place.
    """
    parts = (text or "").split()
    try:
        values = tuple(float(part) for part in parts)
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        wanted = "a finite number" if count == 1 else f"{count} finite numbers"
        raise XmlError(f"{what}: '{' '.join(parts)[:80]}' is not {wanted}")
    for value in values:
        if abs(value) > LARGEST_NUMBER:
            raise XmlError(f"{what}: {value:g} is out of all proportion")
    return values


def number(text: Optional[str], what: str) -> float:
    """Return the one finite number in a text.

    Raises:
        XmlError: no finite number; `what` names the place.
    """
    return numbers(text, 1, what)[0]


def direction(text: Optional[str], what: str) -> Tuple[float, float, float]:
    """Return the unit vector along the three numbers in a text.

    Raises:
        XmlError: other than three finite numbers, or a zero vector.
    """
    values = numbers(text, 3, what)
    length = math.sqrt(sum(value * value for value in values))
    if length == 0.0:
        raise XmlError(f"{what}: a zero vector has no direction")
    return tuple(value / length for value in values)


def sizes(text: Optional[str], count: int, what: str) -> Tuple[float, ...]:
    """Return the `count` positive numbers in a text; raises XmlError."""
    values = numbers(text, count, what)
    if min(values) <= 0.0:
        raise XmlError(f"{what}: {min(values):g} is not positive")
    return values


def mesh_scale(text: Optional[str], what: str) -> Tuple[float, float, float]:
    """Return the three factors in a text, negative ones mirror; raises XmlError for a zero."""
    values = numbers(text, 3, what)
    if 0.0 in values:
        raise XmlError(f"{what}: a scale of 0 leaves nothing")
    return values


def friction(text: Optional[str], what: str) -> float:
    """Return a coefficient of friction; raises XmlError for a negative one."""
    value = number(text, what)
    if value < 0.0:
        raise XmlError(f"{what}: {value:g} is negative")
    return value


def child_text(element: Element, tag: str, default: str = "") -> str:
    """Return the stripped text of a child, or the default where it is missing or empty."""
    child = element.find(tag)
    text = (child.text or "").strip() if child is not None else ""
    return text or default


def boolean(text: str, what: str) -> bool:
    """Return the truth value of true, false, 1 or 0.

    Raises:
        XmlError: any other text.
    """
    lowered = text.strip().lower()
    if lowered in ("true", "1"):
        return True
    if lowered in ("false", "0"):
        return False
    raise XmlError(f"{what}: '{text}' is not true or false")


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
