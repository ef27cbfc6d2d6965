#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.nodes.track_robot."""

from bullet_lab.entry import run

MAIN = "bullet_lab.ros.nodes.track_robot:track_robot"

if __name__ == "__main__":
    run(MAIN)
