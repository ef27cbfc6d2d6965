#!/usr/bin/env bash
# Plays the same scenarios as were played on a Gazebo 11, compares, and prints a table:
# scripts/beside_gazebo.sh [--only slide,husky] [--headings 0,30,45,90] [--record FILE] [--help]
# On the simulator of the ROS master, or on a bridge that it starts; --direct: without ROS.
# Status 1 if a figure is farther from Gazebo's than is allowed.
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

"$LAB_ROOT/scripts/setup.sh" --with test >/dev/null
enter_lab
exec python "$LAB_ROOT/test/gazebo/beside_gazebo.py" "$@"
