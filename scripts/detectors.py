#!/usr/bin/env python3
"""Run the detectors on a picture; see bullet_lab.studies.detectors. No ROS master is needed."""

from bullet_lab.entry import run

MAIN = "bullet_lab.studies.detectors"

if __name__ == "__main__":
    run(MAIN)
