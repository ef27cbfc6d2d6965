#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.nodes.place_beacon."""

from bullet_lab.entry import run

MAIN = "bullet_lab.ros.nodes.place_beacon:place_beacon"

if __name__ == "__main__":
    run(MAIN)
