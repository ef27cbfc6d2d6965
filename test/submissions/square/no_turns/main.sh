#!/bin/bash
# Drives ahead only.
timeout 2 rostopic pub -r 10 cmd_vel geometry_msgs/Twist '{linear: {x: 0.3}}'
exit 0
