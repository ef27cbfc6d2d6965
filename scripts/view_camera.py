#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.nodes.image_node."""

from bullet_lab.entry import run

if __name__ == "__main__":
    run("bullet_lab.ros.nodes.image_node:view_camera")
