#!/usr/bin/env python3
"""Run the experiment; see bullet_lab.studies.published_noise.study."""

from bullet_lab.entry import run

if __name__ == "__main__":
    run("bullet_lab.studies.published_noise.study")
