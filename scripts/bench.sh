#!/usr/bin/env bash
# Measures the bridge beside the bare engine: scripts/bench.sh [--rounds N] [--seconds S]
# Prints a table and writes results/bench/bench.json. No part of the tests.
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

"$LAB_ROOT/scripts/setup.sh" --with test
enter_lab
exec python "$LAB_ROOT/test/bench/bench_bridge.py" results/bench/bench.json "$@"
