#!/bin/bash
# Drives ahead for 5 s of wall time, into the wall.
timeout 5 rostopic pub -r 10 cmd_vel geometry_msgs/Twist '{linear: {x: 0.3}}' || true
