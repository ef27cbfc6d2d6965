#!/usr/bin/env python3
"""Map a world; see bullet_lab.studies.map. No ROS master is needed."""

from bullet_lab.entry import run

MAIN = "bullet_lab.studies.map"

if __name__ == "__main__":
    run(MAIN)
