#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.plot_noise."""

from bullet_lab.ros.plot_noise import main

if __name__ == "__main__":
    main()
