"""Reading XML that comes from outside, without letting it reach anything else."""

from __future__ import annotations

import contextlib
import math
import os
import re
import stat
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Callable, Match, Optional, Sequence, Tuple, Type
from xml.etree.ElementTree import Element, ParseError

import defusedxml.ElementTree
from defusedxml.common import DefusedXmlException

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.errors import LabError

# A description of a robot or a world is text for people; meshes are files of their own.
MAXIMUM_BYTES = 20_000_000
COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
DECLARATION = re.compile(r"<\?xml\s.*?\?>", re.DOTALL)
# Before a colon, in the name of an element or of an attribute.
PREFIX = re.compile(r"""(</?[\w.-]+|\s[\w.-]+(?=:[\w.-]+\s*=\s*["'])):""")
TAG = re.compile(r"<[^<>!?]+>")
# Of an attribute: its name, and its value with quotes or without.
VALUE = re.compile(r"""(\s[\w.:-]+\s*=\s*)(?:("[^"]*"|'[^']*')|([^\s"'>]*[^\s"'>/]))""")
# Squares and cubes of larger ones would overflow; SDF writes 1e16 for "no limit".
LARGEST_NUMBER = 1e18
# A coefficient of friction that nothing slips at.
NO_SLIP = 1e6


class XmlError(LabError):
    """A document cannot be read or does not say what it must."""


def parse_text(text: str, source: str) -> Element:
    """Parse XML text; `source` names it in messages.

    Document types are refused altogether: entities can read files and the network, and no
    robot needs them. What Gazebo's parser passes over is passed over.

    Raises:
        XmlError: not well formed, too large, or with a document type.
    """
    if len(text) > MAXIMUM_BYTES:
        raise XmlError(f"{source}: larger than {MAXIMUM_BYTES} bytes")
    try:
        with contextlib.suppress(ParseError):
            return _parsed(text)
        return _parsed(_as_gazebo_has_it(text))
    except ParseError as error:
        raise XmlError(f"{source}: not well-formed XML: {error}") from error
    except DefusedXmlException as error:
        raise XmlError(f"{source}: document types and entities are refused") from error
    except UnicodeError as error:
        raise XmlError(f"{source}: not Unicode text") from error


def _parsed(text: str) -> Element:
    # Given as text, not as bytes: whatever encoding the document declares is passed over.
    return defusedxml.ElementTree.fromstring(text, forbid_dtd=True)


def _as_gazebo_has_it(text: str) -> str:
    """Return a document without what expat refuses and Gazebo's parser, TinyXML, does not mind.

    That is whatever stands in comments, a declaration that is not the first of all, prefixes of
    names without a namespace, and values without quotes.

    >>> _as_gazebo_has_it("<!-- -- --> <?xml version='1.0'?><a b:c='1'><d:e f=g/></a>").strip()
    "<a b.c='1'><d.e f='g'/></a>"
    """
    for passed_over in (COMMENT, DECLARATION):
        # Lines keep their numbers, for messages.
        text = passed_over.sub(lambda found: "\n" * found.group().count("\n"), text)
    text = PREFIX.sub(r"\1.", text)
    return TAG.sub(lambda tag: VALUE.sub(_quoted, tag.group()), text)


def _quoted(value: Match[str]) -> str:
    before, quoted, bare = value.groups()
    return f"{before}{quoted}" if bare is None else f"{before}'{bare}'"


def file_bytes(path: Path, most: int, error_kind: Type[LabError] = XmlError) -> bytes:
    """Return what is in a file; raises `error_kind` if that is missing or over `most` bytes.

    A pipe or a device is refused: a simulation would wait for whoever writes into it.
    """
    try:
        with open(path, "rb", opener=_open_at_once) as file:
            found = os.fstat(file.fileno())
            if not stat.S_ISREG(found.st_mode):
                raise error_kind(f"{path}: not a file")
            if found.st_size > most:
                raise error_kind(f"{path}: larger than {most} bytes")
            return file.read()
    except OSError as error:
        raise error_kind(f"{path}: {error.strerror}") from error


def _open_at_once(name: str, flags: int) -> int:
    return os.open(name, flags | os.O_NONBLOCK)


def read_text(path: Path) -> str:
    """Return the text of a file; raises XmlError if that is missing, too large or not UTF-8."""
    try:
        return file_bytes(path, MAXIMUM_BYTES).decode()
    except UnicodeDecodeError as error:
        raise XmlError(f"{path}: not UTF-8 text") from error


def numbers(text: Optional[str], count: int, what: str) -> Tuple[float, ...]:
    """Return the `count` finite numbers in a text; raises XmlError that names the place, `what`."""
    parts = (text or "").split()
    try:
        values = tuple(float(part) for part in parts)
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        expected = "a finite number" if count == 1 else f"{count} finite numbers"
        raise XmlError(f"{what}: '{' '.join(parts)[:80]}' is not {expected}")
    for value in values:
        if abs(value) > LARGEST_NUMBER:
            raise XmlError(f"{what}: {value:g} is out of all proportion")
    return values


def number(text: Optional[str], what: str) -> float:
    """Return the one finite number in a text; raises XmlError."""
    return numbers(text, 1, what)[0]


def child_text(element: Element, tag: str, default: str = "") -> str:
    """Return the stripped text of a child, or the default where it is missing or empty."""
    child = element.find(tag)
    text = (child.text or "").strip() if child is not None else ""
    return text or default


class TagReader(ABC):
    """What a tag says, by the names of what it holds; raises XmlError where that makes no sense.

    Where there is a default, `doubt` decides whether it counts instead.
    """

    @abstractmethod
    def text(self, key: str, default: str = "") -> str:
        """Return a text, or the default where there is none."""

    @abstractmethod
    def where(self, key: str) -> str:
        """Name the place of a text in messages."""

    def doubt(self, error: LabError) -> None:
        """Take note of what makes no sense, and return for its default to count; or raise it."""
        raise error

    def numbers(self, key: str, count: int, default: str = "") -> Tuple[float, ...]:
        """Return `count` finite numbers."""
        return self._checked(key, count, default, lambda values: "")

    def number(self, key: str, default: float) -> float:
        """Return a finite number."""
        return self.numbers(key, 1, repr(default))[0]

    def bound(self, key: str) -> float:
        """Return a number that bounds something; LARGEST_NUMBER for what is larger or infinite.

        >>> class Said(TagReader):
        ...     def text(self, key, default=""):
        ...         return {"upper": "1.79769e+308", "lower": "-inf", "effort": "3"}[key]
        >>> [Said().bound(key) for key in ("upper", "lower", "effort")]
        [1e+18, -1e+18, 3.0]
        """
        with contextlib.suppress(ValueError):
            said = float(self.text(key))
            if abs(said) > LARGEST_NUMBER:
                return math.copysign(LARGEST_NUMBER, said)
        return self.number(key, 0.0)

    def coefficient(self, key: str, default: float) -> float:
        """Return a number that is not negative."""

        def check(values: Tuple[float, ...]) -> str:
            return f"{values[0]:g} is negative" if values[0] < 0.0 else ""

        return self._checked(key, 1, repr(default), check)[0]

    def friction(self, key: str, default: float) -> float:
        """Return a coefficient of friction: NO_SLIP for what is larger, or negative, as in ODE.

        >>> class Said(TagReader):
        ...     def text(self, key, default=""):
        ...         return {"mu": "0.5", "mu2": "-1", "grip": "inf"}.get(key, default)
        >>> [Said().friction(key, 1.0) for key in ("mu", "mu2", "grip", "none")]
        [0.5, 1000000.0, 1000000.0, 1.0]
        """
        try:
            said = float(self.text(key, repr(default)))
        except ValueError:
            said = math.nan
        if math.isnan(said):
            return self.number(key, default)
        return said if 0.0 <= said < NO_SLIP else NO_SLIP

    def sizes(self, key: str, count: int, default: str = "") -> Tuple[float, ...]:
        """Return `count` positive numbers."""

        def check(values: Tuple[float, ...]) -> str:
            return f"{min(values):g} is not positive" if min(values) <= 0.0 else ""

        return self._checked(key, count, default, check)

    def positive(self, key: str, default: float) -> float:
        """Return a positive number."""
        return self.sizes(key, 1, repr(default))[0]

    def scale(self, key: str) -> Vector:
        """Return three factors, all 1 by default; negative ones mirror."""

        def check(values: Tuple[float, ...]) -> str:
            return "a scale of 0 leaves nothing" if 0.0 in values else ""

        return self._checked(key, 3, "1 1 1", check)

    def direction(self, key: str, default: str) -> Vector:
        """Return a unit vector."""

        def check(values: Tuple[float, ...]) -> str:
            return "" if _length(values) > 0.0 else "a zero vector has no direction"

        values = self._checked(key, 3, default, check)
        return tuple(value / _length(values) for value in values)

    def choice(self, key: str, known: Sequence[str]) -> str:
        """Return one of several words, the first of them by default."""
        word = self.text(key, known[0])
        if word in known:
            return word
        self.doubt(XmlError(f"{self.where(key)}: '{word}' is not one of {', '.join(known)}"))
        return known[0]

    def boolean(self, key: str, default: bool) -> bool:
        """Return the truth value of true, false, 1 or 0."""
        text = self.text(key, repr(default))
        lowered = text.strip().lower()
        if lowered in ("true", "1", "false", "0"):
            return lowered in ("true", "1")
        self.doubt(XmlError(f"{self.where(key)}: '{text}' is not true or false"))
        return default

    def _checked(
        self, key: str, count: int, default: str, check: Callable[[Tuple[float, ...]], str]
    ) -> Tuple[float, ...]:
        """Return finite numbers that `check` says nothing about."""
        try:
            values = numbers(self.text(key, default), count, self.where(key))
            trouble = check(values)
            if trouble:
                raise XmlError(f"{self.where(key)}: {trouble}")
            return values
        except XmlError as error:
            if not default:
                raise
            self.doubt(error)
            return numbers(default, count, self.where(key))


def _length(values: Sequence[float]) -> float:
    return math.sqrt(sum(value * value for value in values))


class ElementReader(TagReader):
    """What the elements below one say, by their paths such as "ray/range/max".

    `source` names the element in messages.
    """

    def __init__(self, element: Element, source: str):
        self.element = element
        self.source = source

    def text(self, key: str, default: str = "") -> str:  # noqa: D102
        return child_text(self.element, key, default)

    def where(self, key: str) -> str:  # noqa: D102
        return f"{self.source}: <{key.rpartition('/')[2]}>"

    def pose(self) -> Pose:
        """Return the `<pose>` in it, in its own frame; raises XmlError."""
        values = self.numbers("pose", 6, "0 0 0 0 0 0")
        return Pose.from_rpy(values[:3], values[3:])
