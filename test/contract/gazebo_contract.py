#!/usr/bin/env python3
"""Run the program; see contract_program.py beside this file."""

import sys
from pathlib import Path

from bullet_lab.entry import run

# catkin runs this file by way of another one.
sys.path.insert(0, str(Path(__file__).resolve().parent))

MAIN = "contract_program"

if __name__ == "__main__":
    run(MAIN)
