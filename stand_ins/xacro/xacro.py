#!/usr/bin/env python3
"""Expand a xacro file, as `rosrun xacro xacro FILE`."""

import sys

# In this folder, xacro.py is a command as well, and not the library.
del sys.path[0]

from bullet_lab.simulation.world.xacro_child import command  # noqa: E402

if __name__ == "__main__":
    command()
