#!/usr/bin/env python3
"""Run the program; see bullet_lab.ros.contract.program."""

from bullet_lab.entry import run

if __name__ == "__main__":
    run("bullet_lab.ros.contract.program")
