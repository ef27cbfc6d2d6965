"""Controllers of ros_control, on joints and without ROS: one class for each simulated kind.

All modules of this folder are imported, so that their controllers are known.
"""

from __future__ import annotations

import importlib
import logging
import math
import pkgutil
from typing import Any, Mapping

from bullet_lab.simulation.plugins import PluginError

LOG = logging.getLogger(__name__)

# What a parameter of a kind has to be.
EXPECTED = {float: "a finite number", bool: "true or false", str: "a text"}


class ControlError(PluginError):
    """A controller that cannot be made, or a request that it refuses."""


class ControlParameters:
    """A tree of parameters below the namespace `where`, read by paths such as "linear/x/max_jerk".

    As in ROS, a value of the wrong type is ignored; a warning names it.
    """

    def __init__(self, tree: Any, where: str):
        self._tree, self.where = tree, where

    def value(self, path: str) -> Any:
        """Return the value at a path, or None."""
        found: Any = self._tree
        for key in path.strip("/").split("/"):
            found = found.get(key) if isinstance(found, Mapping) else None
        return found

    def below(self, path: str) -> ControlParameters:
        """Return the parameters below a path."""
        return ControlParameters(self.value(path), f"{self.where}/{path}")

    def get(self, path: str, default: Any = None) -> Any:
        """Return a value of the default's type: a finite number, true or false, or a text.

        Without a default, it is a number.
        """
        found, kind = self.value(path), float if default is None else type(default)
        is_valid = _is_number(found) if kind is float else isinstance(found, kind)
        return kind(found) if is_valid else self._ignored(path, EXPECTED[kind], default)

    def names(self, path: str) -> tuple[str, ...] | None:
        """Return a list of names, or None; a text is a list of one name."""
        found = self.value(path)
        if isinstance(found, str):
            return (found,)
        if isinstance(found, list) and all(isinstance(name, str) for name in found):
            return tuple(found)
        return self._ignored(path, "a list of names", None)

    def required_names(self, path: str) -> tuple[str, ...]:
        """Return a list of names; raises ControlError if there are none."""
        found = self.names(path)
        if not found:
            raise ControlError(f"{self.where}/{path} is missing or empty; it must name joints")
        return found

    def numbers(self, path: str, count: int) -> tuple[float, ...]:
        """Return a list of `count` finite numbers; raises ControlError without one."""
        found = self.value(path)
        if not isinstance(found, list) or len(found) != count or not all(map(_is_number, found)):
            raise ControlError(f"{self.where}/{path} has to be a list of {count} numbers")
        return tuple(map(float, found))

    def _ignored(self, path: str, expected: str, default: Any) -> Any:
        """Return the default, with a warning if there is an invalid value at a path."""
        found = self.value(path)
        if found is not None:
            LOG.warning("%s/%s: %.80r is not %s; ignored", self.where, path, found, expected)
        return default


def _is_number(value: Any) -> bool:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return is_number and math.isfinite(value)


for _module in pkgutil.iter_modules(__path__, f"{__name__}."):
    importlib.import_module(_module.name)
