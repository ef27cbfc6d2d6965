"""Parameters: declared once, each with type, default, limits and a sentence.

The parameters of a node, a study or a model are the fields of one frozen dataclass, each made by
one of the functions below. Values are typed, or the text of a launch file or a command line. An
empty text means "not given", unless the parameter accepts it as a value. A value that is not
allowed is refused with one line that names the parameter, the value and what is allowed.

>>> @dataclass(frozen=True)
... class Parameters:
...     std: float = number(0.1, "noise per metre", minimum=0.0)
...     levels: Tuple[float, ...] = numbers((0.0, 0.5), "values of std")
>>> read_parameters(Parameters, {"~std": "0.3"}.get)
Parameters(std=0.3, levels=(0.0, 0.5))
>>> read_parameters(Parameters, {"~std": -1}.get)
Traceback (most recent call last):
bullet_lab.core.parameters.ParameterError: ~std is -1: it must be a number >= 0
"""

from __future__ import annotations

import argparse
import contextlib
import math
import re
from dataclasses import MISSING, Field, dataclass, field, fields
from typing import (
    Any,
    Callable,
    Dict,
    Mapping,
    NoReturn,
    Optional,
    Sequence,
    Tuple,
    Type,
    TypeVar,
)

from bullet_lab.errors import LabError

_WHOLE = re.compile(r"[-+]?\d+", re.ASCII)
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
# As roslaunch reads them.
_TRUTH = {"true": True, "1": True, "false": False, "0": False}
T = TypeVar("T")


class ParameterError(LabError):
    """A parameter has a value that is not allowed."""


@dataclass(frozen=True)
class Declaration:
    """A parameter as a dataclass field declares it.

    Attributes:
        name: of the parameter.
        default: its value if none is given; MISSING: it has none.
        doc: a sentence about it.
        allowed: what is allowed, in words.
        accept: returns a value converted, or raises ValueError or TypeError.
    """

    name: str
    default: Any
    doc: str
    allowed: str
    accept: Callable[[Any], Any]

    def read(self, value: Any, shown_name: str = "") -> Any:
        """Return a value converted; an empty text that is not allowed gives the default.

        Raises ParameterError for a value that is not allowed, with `shown_name` or the name.
        """
        try:
            return self.accept(value)
        except (ValueError, TypeError, LookupError, OverflowError) as error:
            if isinstance(value, str) and not value and self.default is not MISSING:
                return self.default
            shown = f"'{value}'" if isinstance(value, str) else str(value)
            name = shown_name or self.name
            raise ParameterError(f"{name} is {shown}: it must be {self.allowed}") from error

    @property
    def default_text(self) -> str:
        """The default as the text of a launch file or a command line."""
        return _as_text(self.default)


def declarations(kind: type) -> Dict[str, Declaration]:
    """Return the parameters that a dataclass declares, by name, without its other fields."""
    return {
        entry.name: declared(entry.name, entry)
        for entry in fields(kind)
        if "accept" in entry.metadata
    }


def part_of(kind: Type[T], parameters: Any) -> T:
    """Return the parameters that a dataclass declares, from another one that has them, too."""
    return kind(**{name: getattr(parameters, name) for name in declarations(kind)})


def declared(name: str, entry: Field) -> Declaration:
    """Return a parameter outside a dataclass, from the field that a function below returns."""
    factory: Any = entry.default_factory  # type: ignore[misc]
    default = entry.default if factory is MISSING else factory()
    return Declaration(name, default, **entry.metadata)


def checked(
    default: Any,
    doc: str,
    allowed: str,
    accept: Callable[[Any], Any],
    holds: Callable[[Any], bool] = lambda value: True,
) -> Any:
    """Declare a value that is allowed if `accept` converts it and `holds` is true for the result.

    Both may raise ValueError, TypeError, LookupError or OverflowError.
    """

    def accept_all(value: Any) -> Any:
        value = accept(value)
        if not holds(value):
            raise ValueError
        return value

    metadata = {"doc": doc, "allowed": allowed, "accept": accept_all}
    return field(default=default, metadata=metadata)


def number(
    default: float,
    doc: str,
    minimum: float = -math.inf,
    above: float = -math.inf,
    maximum: float = math.inf,
) -> Any:
    """Declare a finite number within [minimum, maximum] and greater than `above`."""
    allowed = f"a number{_limits(minimum, above, maximum)}"
    return checked(default, doc, allowed, _float, lambda v: minimum <= v <= maximum and v > above)


def integer(default: int, doc: str, minimum: int = -(2**31), maximum: int = 2**31 - 1) -> Any:
    """Declare a whole number within [minimum, maximum]."""
    allowed = f"a whole number from {minimum} to {maximum}"
    return checked(default, doc, allowed, _integer, lambda v: minimum <= v <= maximum)


def odd(default: int, doc: str, minimum: int, maximum: int) -> Any:
    """Declare an odd whole number within [minimum, maximum]."""
    allowed = f"an odd number from {minimum} to {maximum}"
    return checked(
        default, doc, allowed, _integer, lambda v: minimum <= v <= maximum and v % 2 == 1
    )


def boolean(default: bool, doc: str) -> Any:
    """Declare true or false."""

    def accept(value: Any) -> bool:
        return value if isinstance(value, bool) else _TRUTH[str.strip(value).lower()]

    return checked(default, doc, "true or false", accept)


def choice(default: str, doc: str, options: Sequence[str]) -> Any:
    """Declare one word of several."""
    allowed = "one of " + ", ".join(options)
    return checked(default, doc, allowed, lambda value: value, lambda value: value in options)


def choices(default: Sequence[str], doc: str, options: Sequence[str]) -> Any:
    """Declare one or more different words of several."""
    allowed = "different words of " + ", ".join(options)
    return _different(default, doc, allowed, _words, lambda word: word in options)


def text(default: str, doc: str) -> Any:
    """Declare any text."""

    def accept(value: Any) -> str:
        if isinstance(value, (dict, list)):
            raise TypeError
        return str(value)

    return checked(default, doc, "text", accept)


def name_list(doc: str) -> Any:
    """Declare names with spaces between them; none by default."""

    def accept(value: Any) -> Tuple[str, ...]:
        return value if isinstance(value, tuple) else tuple(str.split(value))

    return checked((), doc, "names with spaces between them", accept)


def number_list(default: Sequence[float], doc: str) -> Any:
    """Declare exactly as many finite numbers as the default has, with spaces between them."""
    count = len(default)
    return checked(
        tuple(default), doc, f"{count} finite numbers", _floats, lambda v: len(v) == count
    )


def numbers(
    default: Sequence[float],
    doc: str,
    minimum: float = -math.inf,
    above: float = -math.inf,
    maximum: float = math.inf,
) -> Any:
    """Declare one or more different finite numbers within limits as of `number`."""
    allowed = f"different numbers{_limits(minimum, above, maximum)}"
    return _different(
        default, doc, allowed, _floats, lambda v: minimum <= v <= maximum and v > above
    )


def mapping(doc: str, *kinds: type) -> Any:
    """Declare a dictionary; empty by default.

    The parameters of the dataclasses `kinds` may be among the entries, as the text of a launch
    file. It is read as that of the parameter, so an empty text means the default.
    """

    def accept(value: Any) -> Mapping[str, Any]:
        if not isinstance(value, dict):
            raise TypeError
        known = {name: entry for kind in kinds[::-1] for name, entry in declarations(kind).items()}
        entries = dict(value)
        for name in known.keys() & entries.keys():
            # An entry that is not allowed is that of another node, with the same name.
            with contextlib.suppress(ParameterError):
                if isinstance(entries[name], str):
                    entries[name] = known[name].read(entries[name])
        return entries

    metadata = {"doc": doc, "allowed": "a dictionary", "accept": accept}
    return field(default_factory=dict, metadata=metadata)


def read_parameters(
    kind: Type[T], get: Callable[[str, Any], Any], given: Optional[Mapping[str, Any]] = None
) -> T:
    """Read all parameters of a node.

    Args:
        kind: the dataclass that declares them.
        get: `get(name, default)`, such as rospy.get_param; called with "~name".
        given: all that is set below the node's private name, to find misspelt names.

    Raises:
        ParameterError: a value that is not allowed, or a name that is not declared.
    """
    found = declarations(kind)
    unknown = sorted(set(given or ()) - set(found))
    if unknown:
        known = ", ".join(f"~{name}" for name in sorted(found))
        raise ParameterError(f"there is no parameter ~{unknown[0]}: known are {known}")
    values = {}
    for name, declaration in found.items():
        value = get(f"~{name}", MISSING)
        if value is not MISSING:
            values[name] = declaration.read(value, f"~{name}")
    return kind(**values)


def check_parameters(parameters: Any) -> None:
    """Check the values of a dataclass that was made in Python; raises ParameterError."""
    for name, declaration in declarations(type(parameters)).items():
        value = getattr(parameters, name)
        if isinstance(value, str) and not isinstance(declaration.default, str):
            # Text of launch files has been converted before.
            allowed = declaration.allowed
            raise ParameterError(f"{name} is '{value}': it must be {allowed}, not a text")
        if value != declaration.default:
            declaration.read(value)


def add_options(parser: argparse.ArgumentParser, kind: type) -> None:
    """Add an option for each parameter: `--every-light` for every_light, `--std 0.3`.

    Lists are given as words, or as one: `--levels 0 0.1` or `--levels='0 0.1'`; true and false
    as words, or true by the option alone. `read_options` reads the values that the parser finds.
    """
    for name, declaration in declarations(kind).items():
        allowed, shown = declaration.allowed, declaration.default_text
        parser.add_argument(
            "--" + name.replace("_", "-"),
            nargs="*" if isinstance(declaration.default, (tuple, bool)) else None,
            metavar=name.upper(),
            help=f"{declaration.doc}: {allowed}; by default {shown or 'none'}".replace("%", "%%"),
        )


def read_options(kind: Type[T], values: Mapping[str, Any]) -> T:
    """Return the parameters from the values of a parser with `add_options`, such as `vars(…)`.

    Raises ParameterError for a value that is not allowed.
    """
    read = {}
    for name, declaration in declarations(kind).items():
        found = values.get(name)
        if found is None:
            continue
        if found == [] and isinstance(declaration.default, bool):
            found = "true"
        words = found if isinstance(found, str) else " ".join(found)
        read[name] = declaration.read(words, "--" + name.replace("_", "-"))
    return kind(**read)


class ArgumentsError(LabError):
    """A command line is invalid."""


class ArgumentParser(argparse.ArgumentParser):
    """Raises ArgumentsError instead of printing the usage and exiting."""

    def error(self, message: str) -> NoReturn:  # noqa: D102 - inherited
        raise ArgumentsError(message)


def _as_text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (tuple, list)):
        return " ".join(map(_as_text, value))
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return str(int(value))
    return "" if value is None else str(value)


def _float(value: Any) -> float:
    """Return a finite number; a text may have digits, a sign, a point and an exponent only."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    found = float(value if is_number or _NUMBER.fullmatch(value) else "nan")
    if not math.isfinite(found):
        raise ValueError
    return found


def _integer(value: Any) -> int:
    if isinstance(value, str) and _WHOLE.fullmatch(value):
        return int(value)
    if not isinstance(value, int) or isinstance(value, bool):
        raise TypeError
    return value


def _words(value: Any) -> Tuple[Any, ...]:
    return tuple(value.split() if isinstance(value, str) else value)


def _floats(value: Any) -> Tuple[float, ...]:
    return tuple(map(_float, _words(value)))


def _different(
    default: Sequence[Any], doc: str, allowed: str, accept: Callable, holds: Callable[[Any], bool]
) -> Any:
    """Declare one or more different values, for each of which `holds` is true."""
    return checked(
        tuple(default),
        doc,
        allowed,
        accept,
        lambda values: 0 < len(set(values)) == len(values) and all(map(holds, values)),
    )


def _limits(minimum: float, above: float, maximum: float) -> str:
    """Return the limits of a number in words, with a space before them; empty without limits."""
    signs = ((">=", minimum), (">", above), ("<=", maximum))
    limits = [f"{sign} {limit:g}" for sign, limit in signs if math.isfinite(limit)]
    return " " + " and ".join(limits) if limits else ""
