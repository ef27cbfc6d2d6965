#!/usr/bin/env bash
# Mutates files, words and parameters that come from outside and looks at what becomes of them:
# scripts/fuzz.sh [--minutes N | --mutants N] [--seed S] [--way WAY [--first K]]
# A failure leaves its input in results/fuzz and the command that repeats it; status 1 then.
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

"$LAB_ROOT/scripts/setup.sh" --with test
enter_lab
exec python "$LAB_ROOT/test/fuzz/fuzz.py" "$@"
