#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.nodes.dock."""

from bullet_lab.entry import run

MAIN = "bullet_lab.ros.nodes.dock:dock"

if __name__ == "__main__":
    run(MAIN)
