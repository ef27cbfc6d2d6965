#!/usr/bin/env bash
# Puts mistakes into the library, one at a time, and looks whether a unit test fails:
# scripts/mutants.sh [--count N] [--seed S] [--rooms core,noise,…] [--jobs N] [--known]
#   [--seconds S]
# --known takes which tests run which lines from the last run, and so starts at once.
# --seconds S: how long to run the tests of one mistake, the nearest and shortest first
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

"$LAB_ROOT/scripts/setup.sh" --with test
enter_lab
unset ROS_MASTER_URI
exec python "$LAB_ROOT/test/mutants/mutants.py" "$@"
