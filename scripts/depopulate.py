#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.nodes.spawn."""

from bullet_lab.entry import run

MAIN = "bullet_lab.ros.nodes.spawn:depopulate"

if __name__ == "__main__":
    run(MAIN)
