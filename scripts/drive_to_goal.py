#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.nodes.drive_to_goal."""

from bullet_lab.entry import run

MAIN = "bullet_lab.ros.nodes.drive_to_goal:drive_to_goal"

if __name__ == "__main__":
    run(MAIN)
