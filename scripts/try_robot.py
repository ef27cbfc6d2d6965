#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.record.try_robot."""

from bullet_lab.entry import run

MAIN = "bullet_lab.ros.record.try_robot:try_robot"

if __name__ == "__main__":
    run(MAIN)
