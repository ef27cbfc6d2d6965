#!/usr/bin/env python3
"""Make a marker; see bullet_lab.markers. No ROS is needed."""

from bullet_lab.entry import run

MAIN = "bullet_lab.markers"

if __name__ == "__main__":
    run(MAIN)
