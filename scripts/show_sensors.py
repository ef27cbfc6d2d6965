#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.nodes.show_sensors."""

from bullet_lab.entry import run

MAIN = "bullet_lab.ros.nodes.show_sensors:show_sensors"

if __name__ == "__main__":
    run(MAIN)
