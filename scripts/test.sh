#!/usr/bin/env bash
# Runs the tests: linters, unit tests, rostests side by side; with --long, every job at its full
# length too. Status 0 only when all of them pass.
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

LOG=$LAB_DIR/log/test
export LAB_TALLY=$LOG/tally
ROSTEST_TIMEOUT=600
# Most of a rostest is waiting: for nodes that start, for steps of simulated time.
ROSTESTS_AT_ONCE=$(($(nproc) + 1))

# count PASSED FAILED: one line in the tally.
count() { echo "$1 $2" >>"$LAB_TALLY"; }

# attribute NAME FILE: a number from the first test suite of a JUnit file, 0 without one.
attribute() {
  local number
  number=$(grep -o '<testsuite [^>]*' "$2" 2>/dev/null | head -n 1 \
    | grep -o " $1=\"[0-9]*\"" | tr -cd '0-9') || true
  echo "${number:-0}"
}

# run_pytest FOLDER [option ...]
run_pytest() {
  local folder=$1 results tests failed skipped status=0
  shift
  results=$LOG/$(basename "$folder").xml
  rm -f "$results"
  python -m pytest "$@" "$folder" --junitxml="$results" || status=$?
  tests=$(attribute tests "$results")
  skipped=$(attribute skipped "$results")
  failed=$(($(attribute failures "$results") + $(attribute errors "$results")))
  # pytest itself may fail, without a test that does.
  if ((status && !failed)); then
    failed=1
    tests=$((tests + 1))
  fi
  count $((tests - failed - skipped)) "$failed"
}

# summary_of NAME LOG: a number from the summary that rostest prints, in colours; 0 without.
summary_of() {
  local number
  number=$(sed -n "s/^[^ ]* \* $1: \([0-9]*\).*/\1/p" "$2" | tail -n 1)
  echo "${number:-0}"
}

# Every rostest has a master of its own, on a free port.
run_rostest() {
  local file=$1 name start=$SECONDS log status=0 tests failed
  name=$(basename "$file" .test)
  log=$LOG/rostest-$name.log
  ROS_HOME=$LOG/ros ROS_LOG_DIR=$LOG/ros/log timeout "$ROSTEST_TIMEOUT" \
    python "$LAB_ROS/bin/rostest" --results-base-dir "$LOG/rostest" "$file" \
    >"$log" 2>&1 </dev/null || status=$?
  tests=$(summary_of TESTS "$log")
  failed=$(($(summary_of ERRORS "$log") + $(summary_of FAILURES "$log")))
  if ((status || failed || !tests)); then
    cat "$log"
    ((failed)) || failed=1
    ((tests >= failed)) || tests=$failed
    echo "rostest $name: FAILED, $((SECONDS - start)) s"
  else
    echo "rostest $name: $tests passed, $((SECONDS - start)) s"
  fi
  count $((tests - failed)) "$failed"
}

run_rostests() {
  # The longest first, so that none of them is left alone at the end.
  # shellcheck disable=SC2016 # expanded by the shell that xargs starts
  grep -o 'time-limit="[0-9]*"' "$LAB_ROOT"/test/rostest/*.test | sort -t '"' -k 2 -nr | cut -d : -f 1 \
    | xargs -r -d '\n' -n 1 -P "$ROSTESTS_AT_ONCE" bash -c 'run_rostest "$1"' run_rostest
}

main() {
  local passed failed long=
  case "${1:-}" in
    --long) long=yes ;;
    "") ;;
    *)
      echo "usage: scripts/test.sh [--long]" >&2
      exit 2
      ;;
  esac
  "$LAB_ROOT/scripts/setup.sh" --with test
  mkdir -p "$LOG"
  : >"$LAB_TALLY"
  "$LAB_ROOT/scripts/lint.sh" || true
  enter_lab
  # The tests are about this machine: nothing of theirs is to be seen from outside.
  unset ROS_MASTER_URI ROS_HOSTNAME
  export ROS_IP=127.0.0.1
  run_pytest "$LAB_ROOT/test/unit" -n auto
  run_rostests
  [[ -z $long ]] || run_pytest "$LAB_ROOT/test/long"
  read -r passed failed < <(awk '{p += $1; f += $2} END {print p + 0, f + 0}' "$LAB_TALLY")
  echo "$passed passed, $failed failed"
  ((passed && !failed))
}

export -f attribute count summary_of run_rostest
export LOG ROSTEST_TIMEOUT LAB_ROOT LAB_ROS
main "$@"
