#!/usr/bin/env python3
"""Calibrate an odometry by paths with truth; see bullet_lab.studies.calibrate.study."""

from bullet_lab.entry import run

MAIN = "bullet_lab.studies.calibrate.study"

if __name__ == "__main__":
    run(MAIN)
