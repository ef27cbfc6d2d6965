#!/usr/bin/env bash
# Runs jobs, injects a fault into each, and checks how it ends:
# scripts/faults.sh [--count N] [--seed S] [--first I | --only I] [--job JOB] [--kind KIND]
# Faults that were tried before are skipped. A failure leaves its folder in results/faults, with
# the command that repeats it; status 1.
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

"$LAB_ROOT/scripts/setup.sh" --with test
enter_lab
exec python "$LAB_ROOT/test/faults/faults.py" "$@"
