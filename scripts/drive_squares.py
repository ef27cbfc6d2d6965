#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.drive_squares."""

from bullet_lab.ros.drive_squares import main

if __name__ == "__main__":
    main()
