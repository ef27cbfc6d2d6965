#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.nodes.save_world."""

from bullet_lab.entry import run

MAIN = "bullet_lab.ros.nodes.save_world:save_world"

if __name__ == "__main__":
    run(MAIN)
