#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.record.plot_vision."""

from bullet_lab.entry import run

MAIN = "bullet_lab.ros.record.plot_vision:plot_vision"

if __name__ == "__main__":
    run(MAIN)
