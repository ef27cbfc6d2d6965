#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.view.node."""

from bullet_lab.entry import run

MAIN = "bullet_lab.ros.view.node:view"

if __name__ == "__main__":
    run(MAIN)
