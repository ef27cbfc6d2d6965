#!/usr/bin/env python3
"""Run the study; see bullet_lab.ros.verify. No ROS master is needed."""

from bullet_lab.entry import run

MAIN = "bullet_lab.ros.verify"

if __name__ == "__main__":
    run(MAIN)
