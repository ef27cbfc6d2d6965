#!/usr/bin/env bash
# Runs a lab for hours of simulated time and checks that memory, threads and files do not grow:
# scripts/soak.sh [--hours H] [--seed S] [--out FOLDER]
# Writes soak.png, samples.csv and summary.json to results/soak, and continues a soak that was
# stopped or was shorter. Status 1 if something grows or a node ends.
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

"$LAB_ROOT/scripts/setup.sh" --with test
enter_lab
exec python "$LAB_ROOT/test/soak/soak.py" "$@"
