"""What the parameters of a controller say, by paths such as "linear/x/max_velocity"."""

from __future__ import annotations

import logging
import math
from typing import Any, Mapping, Optional, Tuple

from bullet_lab.simulation.plugins.plugin import PluginError

LOG = logging.getLogger(__name__)


class ControlError(PluginError):
    """A controller that cannot be, or that cannot do what is asked of it."""


class ControlParameters:
    """A tree of parameters, as a parameter server has it below the namespace `where`.

    As in ROS, a value of the wrong type counts as none; it is named in a warning here.
    """

    def __init__(self, tree: Any, where: str):
        self._tree = tree if isinstance(tree, Mapping) else {}
        self.where = where

    def value(self, path: str) -> Any:
        """Return what is at a path; None where there is nothing."""
        found: Any = self._tree
        for key in path.strip("/").split("/"):
            if not isinstance(found, Mapping) or key not in found:
                return None
            found = found[key]
        return found

    def below(self, path: str) -> ControlParameters:
        """Return the parameters below a path."""
        return ControlParameters(self.value(path), f"{self.where}/{path}")

    def number(self, path: str, default: float) -> float:
        """Return a finite number."""
        found = self.optional_number(path)
        return default if found is None else found

    def optional_number(self, path: str) -> Optional[float]:
        """Return a finite number, or None."""
        found = self.value(path)
        if found is None or _is_number(found):
            return None if found is None else float(found)
        return self._pass_over(path, found, "a finite number")

    def boolean(self, path: str, default: bool) -> bool:
        """Return true or false."""
        found = self.value(path)
        if found is not None and not isinstance(found, bool):
            found = self._pass_over(path, found, "true or false")
        return default if found is None else found

    def text(self, path: str, default: str = "") -> str:
        """Return a text."""
        found = self.value(path)
        if found is not None and not isinstance(found, str):
            found = self._pass_over(path, found, "a text")
        return default if found is None else found

    def names(self, path: str) -> Optional[Tuple[str, ...]]:
        """Return the names in a list, or None where there is none; one text is a list of one."""
        found = self.value(path)
        listed = [found] if isinstance(found, str) else found
        if listed is None:
            return None
        if not isinstance(listed, list) or not all(isinstance(name, str) for name in listed):
            return self._pass_over(path, found, "a list of names")
        return tuple(listed)

    def required_names(self, path: str) -> Tuple[str, ...]:
        """Return the names in a list; raises ControlError where there are none."""
        found = self.names(path)
        if not found:
            raise ControlError(f"{self.where}/{path} names no joint")
        return found

    def numbers(self, path: str, count: int) -> Tuple[float, ...]:
        """Return so many finite numbers; raises ControlError without them."""
        found = self.value(path)
        if not isinstance(found, list) or len(found) != count or not all(map(_is_number, found)):
            raise ControlError(f"{self.where}/{path} has to be a list of {count} numbers")
        return tuple(map(float, found))

    def _pass_over(self, path: str, found: Any, expected: str) -> None:
        LOG.warning("%s/%s: %.80r is not %s: passed over", self.where, path, found, expected)


def _is_number(value: Any) -> bool:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return is_number and math.isfinite(value)
