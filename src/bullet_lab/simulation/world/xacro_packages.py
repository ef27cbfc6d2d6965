"""Where xacro looks for ROS packages."""

from __future__ import annotations

import sys
import types

from bullet_lab.simulation.world.resources import ros_package_folder


def find_packages_of_ros1() -> None:
    """Have xacro's $(find package) look where package:// does: PyPI's xacro would ask ROS 2."""

    def share_folder(name: str) -> str:
        folder = ros_package_folder(name)
        if folder is None:
            raise LookupError(f"no ROS package '{name}'")
        return str(folder)

    packages = types.ModuleType("ament_index_python.packages")
    packages.get_package_share_directory = share_folder
    sys.modules["ament_index_python"] = types.ModuleType("ament_index_python")
    sys.modules["ament_index_python.packages"] = packages
