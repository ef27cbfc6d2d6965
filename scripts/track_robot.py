#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.track_robot."""

from bullet_lab.ros.track_robot import main

if __name__ == "__main__":
    main()
