#!/usr/bin/env python3
"""Run the study; see bullet_lab.studies.noise_study.study. No ROS master is needed."""

from bullet_lab.entry import run

MAIN = "bullet_lab.studies.noise_study.study"

if __name__ == "__main__":
    run(MAIN)
