#!/usr/bin/env python3
"""Run the experiment; see bullet_lab.studies.published_noise.study."""

from bullet_lab.entry import run

MAIN = "bullet_lab.studies.published_noise.study"

if __name__ == "__main__":
    run(MAIN)
