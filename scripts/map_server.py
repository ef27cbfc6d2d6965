#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.nodes.map_server."""

from bullet_lab.entry import run

MAIN = "bullet_lab.ros.nodes.map_server"

if __name__ == "__main__":
    run(MAIN)
