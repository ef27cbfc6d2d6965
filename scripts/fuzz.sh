#!/usr/bin/env bash
# Mutates files, arguments and parameters, reads them, and checks how errors are reported:
# scripts/fuzz.sh [--minutes N | --mutants N] [--seed S] [--way WAY [--first K]]
# scripts/fuzz.sh --live [--messages N] [--seed S]: random messages and calls to a running bridge
# A failure leaves its input in results/fuzz, with the command that repeats it; status 1.
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

"$LAB_ROOT/scripts/setup.sh" --with test
enter_lab
if [[ ${1-} == --live ]]; then
  shift
  exec python "$LAB_ROOT/test/fuzz/live.py" "$@"
fi
exec python "$LAB_ROOT/test/fuzz/fuzz.py" "$@"
