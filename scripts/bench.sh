#!/usr/bin/env bash
# Measures how fast the lab is:
#   scripts/bench.sh [bridge|noise|laser|camera|aruco|detectors|world|dock|robots|models|relay|view|processors] [option …]
#   bridge (default)  the bridge, against the bare engine: --rounds N, --seconds S
#   noise             thousands of noisy paths, against the per-message loop: --rounds N, --paths N
#   camera            frames, against bare rendering; 30 Hz with aruco.py: --frames N, --seconds S
#   aruco             from image to pose, against OpenCV's detector: --rounds N
#   detectors         detections, corners and poses, against OpenCV and AprilTag: --scenes N, --crops N
#   laser             scans, and fleets of robots with lasers: --rounds N, --seconds S (simulated)
#   world             spawning, deleting and saving many models: --models N, --camera
#   dock              a campaign of dockings on all cores: --dockings N
#   robots            speed against the number of robots: --rounds N, --seconds S (simulated)
#   models            speed against the number of models: same options
#   relay             squares in lock step with and without a relay in between: --rounds N, --sides N
#   processors        which results have other bits on an older processor
#   view              cost of the view in a browser: --robots N, --seconds S, --rounds N
# Prints a table and writes results/bench/bench.json, noise.json and so on. Not part of the tests.
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

main() {
  local bench=bridge out=bench
  case ${1-} in
    bridge) shift ;;
    noise)
      bench=noise out=noise
      shift
      ;;
    aruco)
      bench=aruco out=aruco
      shift
      ;;
    detectors)
      bench=detectors out=detectors
      shift
      ;;
    laser)
      bench=laser out=laser
      shift
      ;;
    camera)
      bench=camera out=camera
      shift
      ;;
    world)
      bench=world out=world
      shift
      ;;
    dock)
      bench=dock out=dock
      shift
      ;;
    relay)
      bench=relay out=relay
      shift
      ;;
    processors)
      bench=processors out=processors
      shift
      ;;
    view)
      bench=view out=view
      shift
      ;;
    robots | models)
      bench=scaling out=$1
      shift
      ;;
    -* | "") ;;
    *)
      echo "bench.sh: there is no bench '$1'; benches: bridge, noise, laser, camera, aruco," \
        "detectors, world, dock, robots, models, relay, view, processors" >&2
      exit 2
      ;;
  esac
  "$LAB_ROOT/scripts/setup.sh" --with test
  enter_lab
  exec python "$LAB_ROOT/test/bench/bench_$bench.py" "results/bench/$out.json" "$@"
}

main "$@"
