"""Read XML and other files from strangers: size limits, no entities, checked values.

An invalid value is reported once and replaced by its default, or its element is left out.
"""

from __future__ import annotations

import contextlib
import logging
import math
import os
import re
import stat
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any, Callable, Iterable, Iterator, Match, Sequence
from xml.etree.ElementTree import Element, ParseError

import defusedxml.ElementTree
from defusedxml.common import DefusedXmlException

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.core.schedule import Schedule, ScheduleError
from bullet_lab.errors import LabError

LOG = logging.getLogger(__name__)

# A robot or a world is a text that people write; meshes are in files of their own.
MAXIMUM_BYTES = 20_000_000
COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
DECLARATION = re.compile(r"<\?xml\s.*?\?>", re.DOTALL)
# The part before the colon in the name of an element or an attribute.
PREFIX = re.compile(r"""(</?[\w.-]+|\s[\w.-]+(?=:[\w.-]+\s*=\s*["'])):""")
TAG = re.compile(r"<[^<>!?]+>")
# An attribute: its name, and its value with quotes or without.
VALUE = re.compile(r"""(\s[\w.:-]+\s*=\s*)(?:("[^"]*"|'[^']*')|([^\s"'>]*[^\s"'>/]))""")
# Squares and cubes of larger numbers would overflow. SDF writes 1e16 for "no limit".
LARGEST_NUMBER = 1e18
# A coefficient of friction at which nothing slips.
NO_SLIP = 1e6

# Logs a warning.
Report = Callable[[str], None]


class XmlError(LabError):
    """A document cannot be read, or its content is invalid."""


class ReportOnce:
    """Log each warning once."""

    def __init__(self) -> None:
        self._given: set[str] = set()

    def __call__(self, message: str, key: str = "") -> None:
        """Warn, unless the same warning, or one with the same key, was logged before."""
        key = key or message
        if key not in self._given:
            self._given.add(key)
            LOG.warning("%s", message)


@contextlib.contextmanager
def leaving_out(report: Report) -> Iterator[None]:
    """Report a LabError and continue without the part that caused it."""
    try:
        yield
    except LabError as error:
        report(f"{error}; it is left out")


def parse_text(text: str, source: str) -> Element:
    """Parse XML text; `source` names it in messages.

    Document types are refused: entities can read files and the network, and no robot needs them.
    Mistakes that Gazebo's parser ignores are ignored.

    Raises:
        XmlError: not well formed, too large, or with a document type.
    """
    if len(text) > MAXIMUM_BYTES:
        raise XmlError(f"{source}: larger than {MAXIMUM_BYTES} bytes")
    try:
        # As text, not as bytes: the encoding that the document declares does not matter.
        with contextlib.suppress(ParseError):
            return defusedxml.ElementTree.fromstring(text, forbid_dtd=True)
        return defusedxml.ElementTree.fromstring(_repaired(text), forbid_dtd=True)
    except ParseError as error:
        raise XmlError(f"{source}: not well-formed XML: {error}") from error
    except DefusedXmlException as error:
        raise XmlError(f"{source}: document types and entities are refused") from error
    except UnicodeError as error:
        raise XmlError(f"{source}: not Unicode text") from error


def _repaired(text: str) -> str:
    """Return a document without the mistakes that expat refuses and Gazebo's TinyXML ignores.

    These are any text in comments, a declaration that is not at the start, prefixes without a
    namespace, and values without quotes.

    >>> _repaired("<!-- -- --> <?xml version='1.0'?><a b:c='1'><d:e f=g/></a>").strip()
    "<a b.c='1'><d.e f='g'/></a>"
    """
    for ignored in (COMMENT, DECLARATION):
        # Line numbers in messages stay right.
        text = ignored.sub(lambda found: "\n" * found.group().count("\n"), text)
    text = PREFIX.sub(r"\1.", text)
    return TAG.sub(lambda tag: VALUE.sub(_quoted, tag.group()), text)


def _quoted(value: Match[str]) -> str:
    before, quoted, bare = value.groups()
    return f"{before}{quoted}" if bare is None else f"{before}'{bare}'"


def file_bytes(path: Path, most: int, error_kind: type[LabError] = XmlError) -> bytes:
    """Return the content of a file; raise `error_kind` if it is missing or over `most` bytes.

    A pipe or a device is refused: reading it could block for ever.
    """
    try:
        with open(path, "rb", opener=_open_without_waiting) as file:
            found = os.fstat(file.fileno())
            if not stat.S_ISREG(found.st_mode):
                raise error_kind(f"{path}: not a file")
            if found.st_size > most:
                raise error_kind(f"{path}: larger than {most} bytes")
            return file.read()
    except OSError as error:
        raise error_kind(f"{path}: {error.strerror}") from error


def _open_without_waiting(name: str, flags: int) -> int:
    return os.open(name, flags | os.O_NONBLOCK)


def read_text(path: Path) -> str:
    """Return the text of a file; raise XmlError if it is missing, too large or not UTF-8."""
    try:
        return file_bytes(path, MAXIMUM_BYTES).decode()
    except UnicodeDecodeError as error:
        raise XmlError(f"{path}: not UTF-8 text") from error


def numbers(text: str | None, count: int, what: str) -> tuple[float, ...]:
    """Return the `count` finite numbers in a text; raise XmlError that begins with `what`."""
    parts = (text or "").split()
    values = finite(parts)
    if len(values) != count:
        expected = "a finite number" if count == 1 else f"{count} finite numbers"
        raise XmlError(f"{what}: '{' '.join(parts)[:80]}' is not {expected}")
    for value in values:
        if abs(value) > LARGEST_NUMBER:
            raise XmlError(f"{what}: {value:g} is not within ±{LARGEST_NUMBER:g}")
    return values


def finite(words: Iterable[str]) -> tuple[float, ...]:
    """Return the numbers in words; empty if one of them is not a finite number."""
    with contextlib.suppress(ValueError):
        found = tuple(float(word) for word in words)
        return found if all(map(math.isfinite, found)) else ()
    return ()


class TagReader(ABC):
    """Reads and checks the values in a tag by their keys.

    An invalid value raises XmlError. If there is a default, `doubt` decides: it raises the error,
    or it returns and the default is used.
    """

    @abstractmethod
    def text(self, key: str, default: str = "") -> str:
        """Return a text, or the default if it is missing."""

    @abstractmethod
    def where(self, key: str) -> str:
        """Return the place of a value, for messages."""

    def doubt(self, error: LabError) -> None:
        """Raise the error of an invalid value; subclasses may log it instead."""
        raise error

    def numbers(
        self,
        key: str,
        count: int,
        default: str = "",
        is_wrong: Callable[[tuple[float, ...]], bool] = lambda values: False,
        reason: str = "",
    ) -> tuple[float, ...]:
        """Return finite numbers that are not wrong; `reason` is formatted with the least one."""
        try:
            values = numbers(self.text(key, default), count, self.where(key))
            if is_wrong(values):
                raise XmlError(f"{self.where(key)}: {reason.format(min(values))}")
            return values
        except XmlError as error:
            if not default:
                raise
            self.doubt(error)
            return numbers(default, count, self.where(key))

    def number(self, key: str, default: float = 0.0) -> float:
        """Return a finite number."""
        return self.numbers(key, 1, repr(default))[0]

    def bound(self, key: str) -> float:
        """Return a limit; larger or infinite ones become LARGEST_NUMBER.

        >>> class Example(TagReader):
        ...     def text(self, key, default=""):
        ...         return {"upper": "1.79769e+308", "lower": "-inf", "effort": "3"}[key]
        ...     def where(self, key):
        ...         return key
        >>> [Example().bound(key) for key in ("upper", "lower", "effort")]
        [1e+18, -1e+18, 3.0]
        """
        return max(-LARGEST_NUMBER, min(LARGEST_NUMBER, self._any_number(key, 0.0)))

    def coefficient(self, key: str, default: float = 0.0) -> float:
        """Return a number that is not negative."""
        return self.numbers(key, 1, repr(default), lambda v: v[0] < 0.0, "{:g} is negative")[0]

    def friction(self, key: str) -> float:
        """Return a coefficient of friction; larger or negative ones become NO_SLIP, as in ODE."""
        value = self._any_number(key, 1.0)
        return value if 0.0 <= value < NO_SLIP else NO_SLIP

    def _any_number(self, key: str, default: float) -> float:
        """Return a number, which may be infinite."""
        with contextlib.suppress(ValueError):
            value = float(self.text(key, repr(default)))
            if not math.isnan(value):
                return value
        return self.number(key, default)

    def sizes(self, key: str, count: int, default: str = "") -> tuple[float, ...]:
        """Return `count` positive numbers."""
        return self.numbers(key, count, default, lambda v: min(v) <= 0.0, "{:g} is not positive")

    def positive(self, key: str, default: float) -> float:
        """Return a positive number."""
        return self.sizes(key, 1, repr(default))[0]

    def scale(self, key: str) -> Vector:
        """Return three factors, by default 1; negative ones mirror."""
        reason = "a scale of 0 leaves nothing"
        return self.numbers(key, 3, "1 1 1", lambda v: 0.0 in v, reason)

    def direction(self, key: str, default: str) -> Vector:
        """Return a unit vector."""
        reason = "a zero vector has no direction"
        values = self.numbers(key, 3, default, lambda v: _length(v) == 0.0, reason)
        return tuple(value / _length(values) for value in values)

    def friction_direction(self, key: str) -> Vector | None:
        """Return a unit vector; None for a zero vector or none."""
        return self.direction(key, "") if any(self.numbers(key, 3, "0 0 0")) else None

    def choice(self, key: str, known: Sequence[str]) -> str:
        """Return one of several words, by default the first."""
        word = self.text(key, known[0])
        if word in known:
            return word
        self.doubt(XmlError(f"{self.where(key)}: '{word}' is not one of {', '.join(known)}"))
        return known[0]

    def colour(self, key: str, default: Any) -> Any:
        """Return red, green, blue and alpha, alpha 1 by default; or the default if missing."""
        text = self.text(key)
        if not text:
            return default
        try:
            return numbers(f"{text} 1" if len(text.split()) == 3 else text, 4, self.where(key))
        except XmlError as error:
            self.doubt(error)
            return default

    def schedule(
        self, key: str, default: float, kind: Callable[[float], Schedule] = Schedule
    ) -> Schedule:
        """Return the schedule for a rate (Hz, 0: every step)."""
        try:
            return kind(self.number(key, default))
        except ScheduleError as error:
            self.doubt(XmlError(f"{self.where(key)}: {error}"))
            return kind(default)

    def boolean(self, key: str, default: bool) -> bool:
        """Return the truth value of true, false, 1 or 0."""
        text = self.text(key, repr(default))
        lowered = text.strip().lower()
        if lowered in ("true", "1", "false", "0"):
            return lowered in ("true", "1")
        self.doubt(XmlError(f"{self.where(key)}: '{text}' is not true or false"))
        return default


def _length(values: Sequence[float]) -> float:
    return math.sqrt(sum(value * value for value in values))


class ElementReader(TagReader):
    """Reads the texts of the elements below one by their paths, such as "ray/range/max".

    `source` names the element in messages.
    """

    def __init__(self, element: Element, source: str):
        self.element = element
        self.source = source

    def text(self, key: str, default: str = "") -> str:  # noqa: D102
        return (self.element.findtext(key) or "").strip() or default

    def where(self, key: str) -> str:  # noqa: D102
        return f"{self.source}: <{key.rpartition('/')[2]}>"

    def pose(self) -> Pose:
        """Return the `<pose>` in it, in the frame that it is given in; raise XmlError."""
        values = self.numbers("pose", 6, "0 0 0 0 0 0")
        return Pose.from_rpy(values[:3], values[3:])
