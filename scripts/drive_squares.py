#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.nodes.drive_squares."""

from bullet_lab.entry import run

MAIN = "bullet_lab.ros.nodes.drive_squares:drive_squares"

if __name__ == "__main__":
    run(MAIN)
