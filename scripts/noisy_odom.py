#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.nodes.noisy_odom."""

from bullet_lab.entry import run

MAIN = "bullet_lab.ros.nodes.noisy_odom:noisy_odom_node"

if __name__ == "__main__":
    run(MAIN)
