"""Parameters of nodes: declared once, with type, default, limits and a sentence each.

A node's parameters are the fields of one frozen dataclass, each made by one of the functions
below. `read_parameters` reads them from the node's private names and refuses what is not
allowed with one line that names the parameter, the value and what is allowed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any, Callable, Mapping, Optional, Sequence, Tuple, Type, TypeVar

from bullet_lab.errors import LabError

_CHECK = "check"
T = TypeVar("T")


class ParameterError(LabError):
    """A parameter has a value that is not allowed."""


@dataclass(frozen=True)
class Check:
    """What a value has to be: `accept` returns it converted, or raises ValueError."""

    doc: str
    allowed: str
    accept: Callable[[Any], Any]


def number(
    default: float,
    doc: str,
    minimum: float = -math.inf,
    above: float = -math.inf,
    maximum: float = math.inf,
) -> Any:
    """Declare a finite number within [minimum, maximum] and greater than `above`."""

    def accept(value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ValueError
        if not math.isfinite(value) or not (minimum <= value <= maximum and value > above):
            raise ValueError
        return float(value)

    return _declare(default, doc, "a number" + _limits(minimum, above, maximum), accept)


def integer(default: int, doc: str, minimum: int = -(2**31), maximum: int = 2**31 - 1) -> Any:
    """Declare a whole number within [minimum, maximum]."""

    def accept(value: Any) -> int:
        whole = isinstance(value, int) and not isinstance(value, bool)
        if not whole or not minimum <= value <= maximum:
            raise ValueError
        return value

    return _declare(default, doc, f"a whole number from {minimum} to {maximum}", accept)


def odd(default: int, doc: str, minimum: int, maximum: int) -> Any:
    """Declare an odd whole number within [minimum, maximum]."""

    def accept(value: Any) -> int:
        whole = isinstance(value, int) and not isinstance(value, bool)
        if not whole or value % 2 == 0 or not minimum <= value <= maximum:
            raise ValueError
        return value

    return _declare(default, doc, f"an odd number from {minimum} to {maximum}", accept)


def boolean(default: bool, doc: str) -> Any:
    """Declare true or false."""

    def accept(value: Any) -> bool:
        if not isinstance(value, bool):
            raise ValueError
        return value

    return _declare(default, doc, "true or false", accept)


def choice(default: str, doc: str, options: Sequence[str]) -> Any:
    """Declare one word of several."""

    def accept(value: Any) -> str:
        if value not in options:
            raise ValueError
        return value

    return _declare(default, doc, "one of " + ", ".join(options), accept)


def text(default: str, doc: str) -> Any:
    """Declare any text."""

    def accept(value: Any) -> str:
        if isinstance(value, (dict, list)):
            raise ValueError
        return str(value)

    return _declare(default, doc, "text", accept)


def name_list(doc: str) -> Any:
    """Declare names with spaces between them; none by default."""

    def accept(value: Any) -> Tuple[str, ...]:
        if isinstance(value, tuple):
            return value
        if not isinstance(value, str):
            raise ValueError
        return tuple(value.split())

    return _declare((), doc, "names with spaces between them", accept)


def number_list(default: Sequence[float], doc: str) -> Any:
    """Declare exactly as many finite numbers as the default has, with spaces between them."""

    def accept(value: Any) -> Tuple[float, ...]:
        parts = value.split() if isinstance(value, str) else list(value)
        values = tuple(float(part) for part in parts)
        if len(values) != len(default) or not all(map(math.isfinite, values)):
            raise ValueError
        return values

    return _declare(tuple(default), doc, f"{len(default)} finite numbers", accept)


def mapping(doc: str) -> Any:
    """Declare a dictionary; empty by default."""

    def accept(value: Any) -> Mapping[str, Any]:
        if not isinstance(value, dict):
            raise ValueError
        return value

    return _declare(None, doc, "a dictionary", accept, factory=dict)


def checked(default: Any, doc: str, allowed: str, accept: Callable[[Any], Any]) -> Any:
    """Declare a value with a check of its own; `accept` raises ValueError or TypeError."""
    return _declare(default, doc, allowed, accept)


def read_parameters(
    kind: Type[T], get: Callable[[str, Any], Any], given: Optional[Mapping[str, Any]] = None
) -> T:
    """Read all parameters of a node.

    Args:
        kind: the dataclass that declares them.
        get: `get(name, default)`, such as rospy.get_param; called with "~name".
        given: what is set below the node's private name, to find misspelt names in.

    Raises:
        ParameterError: a value that is not allowed, or a name that is not declared.
    """
    declared = {entry.name for entry in fields(kind)}
    unknown = sorted(set(given or ()) - declared)
    if unknown:
        known = ", ".join(f"~{name}" for name in sorted(declared))
        raise ParameterError(f"there is no parameter ~{unknown[0]}: known are {known}")
    return kind(**{entry.name: _read(entry, get) for entry in fields(kind)})


def _read(entry: Any, get: Callable[[str, Any], Any]) -> Any:
    check: Check = entry.metadata[_CHECK]
    missing = object()
    value = get(f"~{entry.name}", missing)
    if value is missing:
        if callable(entry.default_factory):
            return entry.default_factory()
        return entry.default
    try:
        return check.accept(value)
    except (ValueError, TypeError, OverflowError) as error:
        shown = f"'{value}'" if isinstance(value, str) else str(value)
        raise ParameterError(f"~{entry.name} is {shown}: it must be {check.allowed}") from error


def _declare(default: Any, doc: str, allowed: str, accept: Callable, factory: Any = None) -> Any:
    metadata = {_CHECK: Check(doc, allowed, accept)}
    if factory is not None:
        return field(default_factory=factory, metadata=metadata)
    return field(default=default, metadata=metadata)


def _limits(minimum: float, above: float, maximum: float) -> str:
    limits = []
    if minimum > -math.inf:
        limits.append(f">= {minimum:g}")
    if above > -math.inf:
        limits.append(f"> {above:g}")
    if maximum < math.inf:
        limits.append(f"<= {maximum:g}")
    return " " + " and ".join(limits) if limits else ""
