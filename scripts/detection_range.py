#!/usr/bin/env python3
"""Measure from where the marker is found; see bullet_lab.studies.detection_range.study."""

from bullet_lab.entry import run

if __name__ == "__main__":
    run("bullet_lab.studies.detection_range.study")
