#!/usr/bin/env python3
"""Run the program; see bullet_lab.ros.contract.program."""

from bullet_lab.entry import run

MAIN = "bullet_lab.ros.contract.program"

if __name__ == "__main__":
    run(MAIN)
