#!/usr/bin/env python3
"""Expand a xacro file, as `rosrun xacro xacro FILE`."""

import sys

# In this folder, xacro.py is a command as well, and not the library.
del sys.path[0]

from xacro import main  # noqa: E402

from bullet_lab.simulation.world.xacro_child import find_packages_of_ros1  # noqa: E402

if __name__ == "__main__":
    find_packages_of_ros1()
    main()
