"""Parameters that are changed while a node runs, through dynamic_reconfigure.

Where python3-dynamic-reconfigure is not installed, none are offered.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from types import SimpleNamespace
from typing import Any, Callable, Dict, Sequence, Tuple

import rospy

from bullet_lab.errors import LabError

try:
    from dynamic_reconfigure.server import Server
except ImportError:
    Server = None

KINDS = {bool: "bool", int: "int", float: "double", str: "str"}
# What a server calls its first configuration, which nobody has asked for.
AT_START = -1

Values = Dict[str, Any]


@dataclass(frozen=True)
class Setting:
    """A parameter: its default, whose type is its own, and its limits; `choices` of a text."""

    name: str
    default: Any
    description: str
    min: Any = ""
    max: Any = ""
    choices: Tuple[str, ...] = ()

    def described(self) -> Dict[str, Any]:
        """Return it as dynamic_reconfigure has it."""
        kind = KINDS[type(self.default)]
        entries = [
            {"name": choice, "value": choice, "type": kind, "description": choice}
            for choice in self.choices
        ]
        method = str({"enum": entries, "enum_description": self.description}) if entries else ""
        return {**asdict(self), "type": kind, "level": 1, "edit_method": method}


class Reconfigurable:
    """Offers settings below a namespace; nothing where dynamic_reconfigure is missing.

    `change(values)` is called, in the thread of whoever changes something, with all that is asked
    for, and returns what holds. Where a number is not finite, or `change` raises LabError, all
    stays as it is.
    """

    def __init__(
        self, namespace: str, settings: Sequence[Setting], change: Callable[[Values], Values]
    ):
        self._namespace, self._change = namespace, change
        self._held: Values = {}
        self._server = Server and _server_of_one_group()(_type_of(settings), self._take, namespace)

    def shutdown(self) -> None:
        """Offer it no longer."""
        if self._server:
            self._server.set_service.shutdown()
            self._server.descr_topic.unregister()
            self._server.update_topic.unregister()

    def _take(self, values: Values, level: int) -> Values:
        if level != AT_START:
            try:
                values.update(self._change(_finite(values)))
            except LabError as error:
                rospy.logwarn("%s: %s; nothing is changed", self._namespace, error)
                values.update(self._held)
        self._held = dict(values)
        return values


class SettingError(LabError):
    """A setting that cannot be."""


def _finite(values: Values) -> Values:
    """Return a copy of settings; raises SettingError for a number that is not finite."""
    for name, value in values.items():
        if isinstance(value, float) and not math.isfinite(value):
            raise SettingError(f"{name} is {value}, which is not finite")
    return dict(values)


def _server_of_one_group() -> Any:
    class OneGroup(Server):
        """Passes over what a call says of groups: there is one, and the library fails without."""

        def _set_callback(self, request: Any) -> Any:
            request.config.groups = []
            return super()._set_callback(request)

    return OneGroup


def _type_of(settings: Sequence[Setting]) -> Any:
    """Return what the generator of dynamic_reconfigure would make of settings."""
    group = {"name": "Default", "type": "", "state": True, "id": 0, "parent": 0, "groups": []}
    parts = {
        "defaults": {setting.name: setting.default for setting in settings},
        "min": {setting.name: _limit(setting, setting.min, False) for setting in settings},
        "max": {setting.name: _limit(setting, setting.max, True) for setting in settings},
    }
    listed = [setting.described() for setting in settings]
    return SimpleNamespace(config_description={**group, "parameters": listed}, **parts)


def _limit(setting: Setting, limit: Any, of_a_switch: bool) -> Any:
    return of_a_switch if isinstance(setting.default, bool) else limit
