#!/usr/bin/env bash
# Runs the tests: linters, unit tests, fuzzing and rostests, in parallel. With --long, it also runs
# every job at its full length, and the faults. Status 0 only if all of them pass.
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

LOG=$LAB_DIR/log/test
export LAB_TALLY=$LOG/tally
ROSTEST_TIMEOUT=600
MUTANTS=564
FAULTS=200
# More than there are cores, because rostests mostly wait.
AT_ONCE=$(($(nproc) + 2))

# count PASSED FAILED: add a line to the tally.
count() { echo "$1 $2" >>"$LAB_TALLY"; }

# attribute NAME FILE: print a number from the first test suite of a JUnit file, or 0.
attribute() {
  local number
  number=$(grep -o '<testsuite [^>]*' "$2" 2>/dev/null | head -n 1 \
    | grep -o " $1=\"[0-9]*\"" | tr -cd '0-9') || true
  echo "${number:-0}"
}

# run_lint: print the output only if something is wrong.
run_lint() {
  local log=$LOG/lint.log start=$SECONDS
  "$LAB_ROOT/scripts/lint.sh" >"$log" 2>&1 || cat "$log"
  echo "lint: $((SECONDS - start)) s"
}

# run_pytest FOLDER [option ...]
run_pytest() {
  local folder=$1 name log results tests failed skipped status=0 start=$SECONDS
  shift
  name=$(basename "$folder")
  log=$LOG/$name.log results=$LOG/$name.xml
  rm -f "$results"
  python -m pytest "$@" "$folder" --junitxml="$results" >"$log" 2>&1 </dev/null || status=$?
  tests=$(attribute tests "$results")
  skipped=$(attribute skipped "$results")
  failed=$(($(attribute failures "$results") + $(attribute errors "$results")))
  # pytest itself may fail while no test does.
  if ((status && !failed)); then
    failed=1
    tests=$((tests + 1))
  fi
  ((!failed)) || cat "$log"
  echo "pytest $name: $((tests - failed - skipped)) passed, $failed failed, $((SECONDS - start)) s"
  count $((tests - failed - skipped)) "$failed"
}

# summary_of NAME LOG: print a number from the coloured summary of rostest, or 0.
summary_of() {
  local number
  number=$(sed -n "s/^[^ ]* \* $1: \([0-9]*\).*/\1/p" "$2" | tail -n 1)
  echo "${number:-0}"
}

# Every rostest starts its own master on a free port.
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

# run_fuzz: a few hundred mutants of every kind of input; scripts/fuzz.sh runs any number.
run_fuzz() {
  local log=$LOG/fuzz.log start=$SECONDS status=0
  python "$LAB_ROOT/test/fuzz/fuzz.py" --each 4 --mutants "$MUTANTS" --workers 1 \
    --out "$LOG/fuzz" >"$log" 2>&1 </dev/null || status=1
  ((!status)) || cat "$log"
  echo "fuzz: $MUTANTS mutants, status $status, $((SECONDS - start)) s"
  count $((1 - status)) "$status"
}

# run_faults: continues after a stop; scripts/faults.sh can use other seeds.
run_faults() {
  local log=$LOG/faults.log start=$SECONDS status=0
  [[ ! -e $LOG/faults/summary.json ]] || rm -rf "$LOG/faults"
  python "$LAB_ROOT/test/faults/faults.py" --count "$FAULTS" --out "$LOG/faults" \
    >"$log" 2>&1 </dev/null || status=1
  ((!status)) || cat "$log"
  echo "faults: $FAULTS faults, status $status, $((SECONDS - start)) s"
  count $((1 - status)) "$status"
}

# run_part NAME: the linters, the unit tests, the fuzzing, or the rostest in a file.
run_part() {
  case $1 in
    lint) run_lint ;;
    fuzz) run_fuzz ;;
    unit) run_pytest "$LAB_ROOT/test/unit" -q -n auto --dist loadfile -m "not long" ;;
    *) run_rostest "$1" ;;
  esac
}

# All parts, longest first, so that they end at about the same time.
parts() {
  printf '%s\n' unit lint fuzz
  grep -o 'time-limit="[0-9]*"' "$LAB_ROOT"/test/rostest/*.test | sort -t '"' -k 2 -nr | cut -d : -f 1
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
  "$LAB_ROOT/scripts/setup.sh" --with test --with course
  mkdir -p "$LOG"
  : >"$LAB_TALLY"
  enter_lab
  # The tests listen only on this machine.
  unset ROS_MASTER_URI ROS_HOSTNAME
  export ROS_IP=127.0.0.1
  # shellcheck disable=SC2016 # expanded by the shell that xargs starts
  parts | xargs -d '\n' -n 1 -P "$AT_ONCE" bash -c 'run_part "$1"' run_part
  if [[ $long ]]; then
    "$LAB_ROOT/scripts/setup.sh" --with browser
    run_pytest "$LAB_ROOT/test/unit" -q -n auto -m long
    run_pytest "$LAB_ROOT/test/long"
    run_faults
  fi
  read -r passed failed < <(awk '{p += $1; f += $2} END {print p + 0, f + 0}' "$LAB_TALLY")
  echo "$passed passed, $failed failed"
  ((passed && !failed))
}

export -f attribute count summary_of run_fuzz run_lint run_part run_pytest run_rostest
export LOG MUTANTS ROSTEST_TIMEOUT LAB_ROOT LAB_ROS
main "$@"
