"""Controllers of ros_control: one class for each kind that is simulated, on joints, without ROS.

Every module of this folder is imported, and with that its controllers are known.
"""

import importlib
import pkgutil

for _module in pkgutil.iter_modules(__path__, f"{__name__}."):
    importlib.import_module(_module.name)
