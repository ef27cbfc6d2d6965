#!/usr/bin/env bash
# Has a lab live for hours of simulated time and looks whether it takes more and more of the machine:
# scripts/soak.sh [--hours H] [--seed S] [--out FOLDER]
# Leaves soak.png, samples.csv and summary.json in results/soak; with those of a soak that was
# stopped, or was shorter, it goes on. Status 1 where something grows, or a node ends.
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

"$LAB_ROOT/scripts/setup.sh" --with test
enter_lab
exec python "$LAB_ROOT/test/soak/soak.py" "$@"
