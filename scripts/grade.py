#!/usr/bin/env python3
"""Grade submissions; see bullet_lab.ros.grade. No ROS master is needed."""

from bullet_lab.entry import run

MAIN = "bullet_lab.ros.grade"

if __name__ == "__main__":
    run(MAIN)
