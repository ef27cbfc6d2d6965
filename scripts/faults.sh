#!/usr/bin/env bash
# Runs each job again and again, does something bad to it, and looks at what becomes of it:
# scripts/faults.sh [--count N] [--seed S] [--first I | --only I] [--job JOB] [--kind KIND]
# What was tried is not tried again. A failure leaves its folder in results/faults and the
# command that repeats it; status 1 then.
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

"$LAB_ROOT/scripts/setup.sh" --with test
enter_lab
exec python "$LAB_ROOT/test/faults/faults.py" "$@"
