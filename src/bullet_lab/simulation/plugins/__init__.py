"""Plugins of robots: one class for each plugin of Gazebo that is simulated.

All modules of this folder are imported, so that their plugins are known.
"""

import importlib
import pkgutil

from bullet_lab.simulation.plugins.plugin import (
    Input,
    Mount,
    Output,
    Plugin,
    PluginError,
    known_plugins,
    make_plugin,
    namespace_of,
)

__all__ = [
    "Input",
    "Mount",
    "Output",
    "Plugin",
    "PluginError",
    "known_plugins",
    "make_plugin",
    "namespace_of",
]

for _module in pkgutil.iter_modules(__path__, f"{__name__}."):
    importlib.import_module(_module.name)
