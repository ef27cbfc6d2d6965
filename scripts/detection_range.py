#!/usr/bin/env python3
"""Measure from where the marker is found; see bullet_lab.studies.detection_range.study."""

from bullet_lab.entry import run

MAIN = "bullet_lab.studies.detection_range.study"

if __name__ == "__main__":
    run(MAIN)
