"""Settings that clients change while a node runs, through dynamic_reconfigure.

Without python3-dynamic-reconfigure, no settings are offered.
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

TYPES = {bool: "bool", int: "int", float: "double", str: "str"}
# Level of a server's first configuration, which no client has requested.
AT_START = -1

Values = Dict[str, Any]


class SettingError(LabError):
    """A setting has an invalid value."""


@dataclass(frozen=True)
class Setting:
    """A setting with its default, which has the setting's type, limits, and choices of a text."""

    name: str
    default: Any
    description: str
    min: Any = ""
    max: Any = ""
    choices: Tuple[str, ...] = ()

    def described(self) -> Dict[str, Any]:
        """Return the description of the setting for dynamic_reconfigure."""
        kind = TYPES[type(self.default)]
        entries = [
            {"name": choice, "value": choice, "type": kind, "description": choice}
            for choice in self.choices
        ]
        method = str({"enum": entries, "enum_description": self.description}) if entries else ""
        return {**asdict(self), "type": kind, "level": 1, "edit_method": method}


class Reconfigurable:
    """Offers settings in a namespace; does nothing without dynamic_reconfigure.

    `change(values)` is called with all requested values, in the thread of the service, and returns
    the resulting ones. If a number is not finite or `change` raises LabError, nothing is changed.
    """

    def __init__(
        self, namespace: str, settings: Sequence[Setting], change: Callable[[Values], Values]
    ):
        self._namespace, self._change = namespace, change
        self._values: Values = {}
        self._server = Server and _server_class()(_type_of(settings), self._take, namespace)

    def shutdown(self) -> None:
        """Shut down the service and the topics."""
        if self._server:
            self._server.set_service.shutdown()
            self._server.descr_topic.unregister()
            self._server.update_topic.unregister()

    def _take(self, values: Values, level: int) -> Values:
        if level != AT_START:
            try:
                _check_finite(values)
                values.update(self._change(dict(values)))
            except LabError as error:
                rospy.logwarn("%s: %s; nothing is changed", self._namespace, error)
                values.update(self._values)
        self._values = dict(values)
        return values


def _check_finite(values: Values) -> None:
    for name, value in values.items():
        if isinstance(value, float) and not math.isfinite(value):
            raise SettingError(f"{name} is {value}, which is not finite")


def _server_class() -> Any:
    class OneGroup(Server):
        """Ignores the groups of a request, which make the library fail: there is one group."""

        def _set_callback(self, request: Any) -> Any:
            request.config.groups = []
            return super()._set_callback(request)

    return OneGroup


def _type_of(settings: Sequence[Setting]) -> Any:
    """Return the module that dynamic_reconfigure would generate for the settings."""
    group = {"name": "Default", "type": "", "state": True, "id": 0, "parent": 0, "groups": []}
    booleans = [setting for setting in settings if isinstance(setting.default, bool)]
    return SimpleNamespace(
        config_description={**group, "parameters": [setting.described() for setting in settings]},
        defaults={setting.name: setting.default for setting in settings},
        min={s.name: False if s in booleans else s.min for s in settings},
        max={s.name: True if s in booleans else s.max for s in settings},
    )
