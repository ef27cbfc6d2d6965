#!/usr/bin/env bash
# Measures how fast the lab is:
#   scripts/bench.sh [bridge|noise|laser|camera|aruco|detectors|world|dock|robots|models|view|processors] [option …]
#   bridge (default)  the bridge, against the bare engine: --rounds N, --seconds S
#   noise             thousands of noisy paths, against the per-message loop: --rounds N, --paths N
#   camera            frames, against bare rendering; 30 Hz with aruco.py: --frames N, --seconds S
#   aruco             from image to pose, against OpenCV's detector: --rounds N
#   detectors         detections, corners and poses, against OpenCV and AprilTag: --scenes N, --crops N
#   laser             scans, and the engine alone with 20 robots: --rounds N, --seconds S (simulated)
#   world             spawning, deleting and saving many models: --models N, --camera
#   dock              a campaign of dockings on all cores: --dockings N
#   robots            speed against the number of robots: --rounds N, --seconds S (simulated)
#   models            speed against the number of models: same options
#   processors        which results have other bits on an older processor
#   view              cost of the view in a browser: --robots N, --seconds S, --rounds N
# Prints a table and writes results/bench/bridge.json, noise.json and so on. Not part of the tests.
# --flame as the first option: py-spy looks 100 times a second in which functions all processes are,
# and draws bridge.svg and so on beside the JSON. The table's figures are somewhat worse then.
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

bench=bridge
if [[ ${1-} && ${1-} != -* ]]; then
  bench=$1
  shift
fi
case $bench in
  robots | models) program=scaling ;;
  scaling) program= ;;
  *) program=$bench ;;
esac
program=$LAB_ROOT/test/bench/bench_$program.py
if [[ ! -f $program ]]; then
  echo "bench.sh: there is no bench '$bench'; benches: bridge, noise, laser, camera, aruco," \
    "detectors, world, dock, robots, models, view, processors" >&2
  exit 2
fi
"$LAB_ROOT/scripts/setup.sh" --with test
enter_lab
watch=()
if [[ ${1-} == --flame ]]; then
  shift
  mkdir -p results/bench
  watch=(py-spy record --subprocesses --nonblocking --function -o "results/bench/$bench.svg" --)
fi
exec "${watch[@]}" python "$program" "results/bench/$bench.json" "$@"
