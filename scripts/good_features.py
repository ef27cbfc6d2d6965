#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.nodes.image_node."""

from bullet_lab.entry import run

MAIN = "bullet_lab.ros.nodes.image_node:good_features"

if __name__ == "__main__":
    run(MAIN)
