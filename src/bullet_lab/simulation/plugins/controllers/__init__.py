"""Controllers of ros_control, on joints and without ROS: one class for each simulated kind.

All modules of this folder are imported, so that their controllers are known.
"""

import importlib
import pkgutil

for _module in pkgutil.iter_modules(__path__, f"{__name__}."):
    importlib.import_module(_module.name)
