#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.record.plots."""

from bullet_lab.entry import run

MAIN = "bullet_lab.ros.record.plots:plot_vision"

if __name__ == "__main__":
    run(MAIN)
