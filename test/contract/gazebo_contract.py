#!/usr/bin/env python3
"""Run the program; see contract_program.py beside this file."""

from bullet_lab.entry import run

MAIN = "contract_program"

if __name__ == "__main__":
    run(MAIN)
