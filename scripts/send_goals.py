#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.nodes.send_goals."""

from bullet_lab.entry import run

MAIN = "bullet_lab.ros.nodes.send_goals:send_goals"

if __name__ == "__main__":
    run(MAIN)
