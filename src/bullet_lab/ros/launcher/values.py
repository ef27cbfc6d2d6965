"""Which values an argument of a job may have.

The bracket that ends the argument's ``doc`` in the launch file says it, so that the help
shows what is checked::

    [text]              anything; the same as no bracket
    [folder]            a path, relative to the caller's folder
    [true|false]        one of the words; two or more, or true or false alone
    [integer >= 0]      a whole number, with any number of bounds: > >= < <=
    [number > 0 <= 1]   a finite number, likewise
"""

from __future__ import annotations

import math
import operator
import re
from dataclasses import dataclass

from bullet_lab.errors import LabError

_BRACKET = re.compile(r"\[([^\[\]]+)\]\s*$")
_NUMERIC = re.compile(r"(number|integer)((?:\s*(?:>=|<=|>|<)\s*[-+.\deE]+)*)")
_BOUND = re.compile(r"(>=|<=|>|<)\s*([-+.\deE]+)")
_WORDS = re.compile(r"true|false|[\w.-]+(\|[\w.-]+)+")
_COMPARE = {">": operator.gt, ">=": operator.ge, "<": operator.lt, "<=": operator.le}


class UsageError(LabError):
    """The command line asks for something that does not exist or cannot be."""


@dataclass(frozen=True)
class Bound:
    """One comparison that a number has to pass."""

    sign: str
    limit: float

    def holds(self, number: float) -> bool:
        """Whether the number is on the right side of the limit."""
        return _COMPARE[self.sign](number, self.limit)


@dataclass(frozen=True)
class Values:
    """The values that an argument may have.

    Attributes:
        text: the bracket's content, as in the launch file.
        kind: "text", "folder", "words", "integer" or "number".
        words: the allowed words, when the kind is "words".
        bounds: the limits of a number.
    """

    text: str
    kind: str
    words: tuple[str, ...] = ()
    bounds: tuple[Bound, ...] = ()

    def check(self, name: str, value: str) -> None:
        """Raise UsageError, with one line that says what is allowed, for another value."""
        if not self._allows(value):
            raise UsageError(f"{name}:={value} is refused, it has to be [{self.text}]")

    def _allows(self, value: str) -> bool:
        if self.kind == "words":
            return value in self.words
        if self.kind == "folder":
            return bool(value)
        if self.kind in ("integer", "number"):
            number = _number(value, whole=self.kind == "integer")
            return number is not None and all(bound.holds(number) for bound in self.bounds)
        return True


def _number(value: str, whole: bool) -> float | None:
    """The finite number that the value spells in plain digits, None if there is none."""
    pattern = r"[-+]?\d+" if whole else r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?"
    if not re.fullmatch(pattern, value, re.ASCII):
        return None
    number = float(value)
    return number if math.isfinite(number) else None


def read_values(doc: str) -> Values:
    """What the bracket at the end of an argument's doc allows.

    Raises:
        UsageError: there is a bracket, but not one of the grammar.
    """
    bracket = _BRACKET.search(doc)
    text = bracket.group(1).strip() if bracket else "text"
    if text in ("text", "folder"):
        return Values(text, text)
    numeric = _NUMERIC.fullmatch(text)
    if numeric:
        bounds = tuple(Bound(sign, float(limit)) for sign, limit in _BOUND.findall(numeric[2]))
        return Values(text, numeric[1], bounds=bounds)
    if _WORDS.fullmatch(text):
        return Values(text, "words", words=tuple(text.split("|")))
    raise UsageError(f"the doc of an argument ends with an unknown kind of values: [{text}]")
