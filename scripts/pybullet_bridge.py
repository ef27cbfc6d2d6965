#!/usr/bin/env python3
"""Run the node; see bullet_lab.ros.bridge."""

from bullet_lab.ros.bridge import main

if __name__ == "__main__":
    main()
