#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.record.plot_goals."""

from bullet_lab.entry import run

MAIN = "bullet_lab.ros.record.plot_goals:plot_goal"

if __name__ == "__main__":
    run(MAIN)
