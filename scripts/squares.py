#!/usr/bin/env python3
"""Drive squares without ROS; see bullet_lab.studies.squares."""

from bullet_lab.entry import run

MAIN = "bullet_lab.studies.squares"

if __name__ == "__main__":
    run(MAIN)
