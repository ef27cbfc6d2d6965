#!/usr/bin/env python3
"""Run the campaign; see bullet_lab.studies.dock_campaign.study. No ROS master is needed."""

from bullet_lab.entry import run

MAIN = "bullet_lab.studies.dock_campaign.study"

if __name__ == "__main__":
    run(MAIN)
