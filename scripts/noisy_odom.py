#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.noisy_odom."""

from bullet_lab.ros.noisy_odom import main

if __name__ == "__main__":
    main()
