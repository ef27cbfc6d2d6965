#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.nodes.populate."""

from bullet_lab.entry import run

MAIN = "bullet_lab.ros.nodes.populate:place_beacon"

if __name__ == "__main__":
    run(MAIN)
