#!/usr/bin/env bash
# Runs the tests: scripts/test.sh [option ...] [part ...]. Status 0 only if all of them pass.
#
# A part is lint, unit, fuzz, the name of a rostest such as drive_squares, a path of unit tests such
# as test/unit/core, or long, jobs, faults, which are run with --long. By default lint and unit come
# first, then all others.
# --long: also run every job at its full length, and the faults
# --coverage: count the lines and branches of the library that the tests and their nodes run
# --random-order: unit tests in another order each time; the seed is printed
# --random-seed S: in the order of that seed
# --repeat N: run them N times, and list the tests that did not pass each time
# --at-once M: M of these runs at the same time
# --load K: beside K processes that are always busy
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

# Runs at the same time have folders of their own.
LOG=${LAB_TEST_LOG:-$LAB_DIR/log/test}
export LAB_TALLY=$LOG/tally
# Words for the command that runs again what has failed.
AGAIN=$LOG/again
SUITE=$LAB_ROOT/test/suite
ROSTEST_TIMEOUT=2400
MUTANTS=564
FAULTS=200
# More than there are cores, because rostests mostly wait.
AT_ONCE=$(($(nproc) + 2))

usage() {
  sed -n '2,/^set/s/^# \{0,1\}//p' "${BASH_SOURCE[0]}"
}

# ---- Parts ----

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
  if ! "$LAB_ROOT/scripts/lint.sh" >"$log" 2>&1; then
    cat "$log"
    echo lint >>"$AGAIN"
  fi
  echo "lint: $((SECONDS - start)) s"
}

# run_pytest NAME PATH [option ...]: the name is that of the log and of the JUnit file.
run_pytest() {
  local name=$1 log=$LOG/$1.log results=$LOG/junit/$1.xml tests failed skipped status=0
  local start=$SECONDS
  shift
  rm -f "$results"
  # shellcheck disable=SC2086 # options
  python -m pytest $LAB_PYTEST_OPTIONS "$@" --junitxml="$results" >"$log" 2>&1 </dev/null \
    || status=$?
  tests=$(attribute tests "$results")
  skipped=$(attribute skipped "$results")
  failed=$(($(attribute failures "$results") + $(attribute errors "$results")))
  # pytest itself may fail while no test does.
  if ((status && !failed)); then
    failed=1
    tests=$((tests + 1))
    echo "$1" >>"$AGAIN"
  fi
  if ((failed)); then
    cat "$log"
    sed -n 's/^\(FAILED\|ERROR\) \([^[ ]*\).*/\2/p' "$log" | sort -u >>"$AGAIN"
  fi
  echo "pytest $name: $((tests - failed - skipped)) passed, $failed failed, $((SECONDS - start)) s"
  count $((tests - failed - skipped)) "$failed"
}

# summary_of NAME LOG: print a number from the coloured summary of rostest, or 0.
summary_of() {
  local number
  number=$(sed -n "s/^[^ ]* \* $1: \([0-9]*\).*/\1/p" "$2" | tail -n 1)
  echo "${number:-0}"
}

# run_rostest NAME: with a master of its own on a free port.
run_rostest() {
  local name=$1 start=$SECONDS log=$LOG/rostest-$1.log status=0 tests failed
  ROS_HOME=$LOG/ros ROS_LOG_DIR=$LOG/ros/log timeout "$ROSTEST_TIMEOUT" \
    python "$LAB_ROS/bin/rostest" --results-base-dir "$LOG/junit" \
    "$LAB_ROOT/test/rostest/$name.test" >"$log" 2>&1 </dev/null || status=$?
  tests=$(summary_of TESTS "$log")
  failed=$(($(summary_of ERRORS "$log") + $(summary_of FAILURES "$log")))
  if ((status || failed || !tests)); then
    cat "$log"
    ((failed)) || failed=1
    ((tests >= failed)) || tests=$failed
    echo "$name" >>"$AGAIN"
    echo "rostest $name: FAILED, $((SECONDS - start)) s"
  else
    echo "rostest $name: $tests passed, $((SECONDS - start)) s"
  fi
  count $((tests - failed)) "$failed"
}

# run_program NAME WHAT COMMAND …: a program that counts as one test.
run_program() {
  local name=$1 what=$2 log=$LOG/$1.log start=$SECONDS status=0
  "${@:3}" >"$log" 2>&1 </dev/null || status=1
  if ((status)); then
    cat "$log"
    echo "$name" >>"$AGAIN"
  fi
  echo "$name: $what, status $status, $((SECONDS - start)) s"
  count $((1 - status)) "$status"
}

# run_fuzz: a few hundred mutants of every kind of input; scripts/fuzz.sh runs any number.
run_fuzz() {
  run_program fuzz "$MUTANTS mutants" python "$LAB_ROOT/test/fuzz/fuzz.py" --each 4 \
    --mutants "$MUTANTS" --workers 1 --out "$LOG/fuzz"
}

# run_faults: continues after a stop; scripts/faults.sh can use other seeds.
run_faults() {
  [[ ! -e $LOG/faults/summary.json ]] || rm -rf "$LOG/faults"
  run_program faults "$FAULTS faults" python "$LAB_ROOT/test/faults/faults.py" \
    --count "$FAULTS" --out "$LOG/faults"
}

# run_part NAME
run_part() {
  case $1 in
    lint | fuzz | faults) "run_$1" ;;
    unit) run_pytest unit "$LAB_ROOT/test/unit" -n auto --dist loadfile -m "not long" ;;
    long) run_pytest long "$LAB_ROOT/test/unit" -n auto -m long ;;
    jobs) run_pytest jobs "$LAB_ROOT/test/long" ;;
    */*) run_pytest "${1//[^[:alnum:]_]/-}" "$1" ;;
    *) run_rostest "$1" ;;
  esac
}

# The rostests and what else does not come first, longest first, so that they end together.
rostests() {
  echo fuzz
  (cd "$LAB_ROOT/test/rostest" && grep -o 'time-limit="[0-9]*"' ./*.test) \
    | sort -t '"' -k 2 -nr | sed 's#^\./\(.*\)\.test:.*#\1#'
}

# run_parts AT_ONCE: those whose names come in.
run_parts() {
  # shellcheck disable=SC2016 # expanded by the shell that xargs starts
  xargs -d '\n' -r -n 1 -P "$1" bash -c 'run_part "$1"' run_part
}

# ---- Runs ----

# run_once [part ...]: status 0 if all passed.
run_once() {
  local passed failed
  rm -rf "$LOG/junit" "$AGAIN"
  mkdir -p "$LOG/junit"
  : >"$LAB_TALLY"
  if (($#)); then
    printf '%s\n' "$@" | run_parts 1
  else
    printf '%s\n' unit lint | run_parts 2
    rostests | run_parts "$AT_ONCE"
    if [[ $long ]]; then
      "$LAB_ROOT/scripts/setup.sh" --with browser
      printf '%s\n' long jobs faults | run_parts 1
    fi
  fi
  [[ ! $coverage ]] || python "$SUITE/coverage_summary.py" "$LAB_ROOT" "$LOG/coverage"
  read -r passed failed < <(awk '{p += $1; f += $2} END {print p + 0, f + 0}' "$LAB_TALLY")
  if [[ -s $AGAIN ]]; then
    echo "again: scripts/test.sh $(sort -u "$AGAIN" | sed "s#^$LAB_ROOT/##" | paste -s -d ' ')"
  fi
  echo "$passed passed, $failed failed"
  ((passed && !failed))
}

# run_number NUMBER SEED [argument ...]: one run of several; the seed may be empty.
run_number() {
  local number=$1 order=()
  set -o pipefail
  [[ ! $2 ]] || order=(--random-seed $(($2 + number)))
  LAB_TEST_LOG=$LOG/runs/$number "$LAB_ROOT/scripts/test.sh" "${order[@]}" "${@:3}" 2>&1 \
    | sed -u "s/^/$number: /"
}

# count_coverage: in every Python process that is started from here; coverage's .pth file asks for
# this variable.
count_coverage() {
  rm -rf "$LOG/coverage"
  mkdir -p "$LOG/coverage"
  export COVERAGE_PROCESS_START=$LAB_ROOT/pyproject.toml COVERAGE_FILE=$LOG/coverage/data
}

# be_busy NUMBER: until this script ends.
be_busy() {
  local busy=()
  while ((${#busy[@]} < $1)); do
    (while :; do :; done) &
    busy+=($!)
  done
  # shellcheck disable=SC2064 # as they are now
  trap "kill ${busy[*]}" EXIT
}

main() {
  local long='' coverage='' load=0 repeat=1 at_once=1 seed='' parts=() status=0
  while (($#)); do
    case $1 in
      --long) long=yes ;;
      --coverage) coverage=yes ;;
      --random-order) seed=$RANDOM ;;
      --random-seed | --repeat | --at-once | --load)
        [[ ${2-} =~ ^[0-9]+$ ]] || { usage >&2 && exit 2; }
        case $1 in
          --random-seed) seed=$2 ;;
          --repeat) repeat=$2 ;;
          --at-once) at_once=$2 ;;
          --load) load=$2 ;;
        esac
        shift
        ;;
      -*) usage >&2 && exit 2 ;;
      *) parts+=("$1") ;;
    esac
    shift
  done
  export LAB_PYTEST_OPTIONS=-q
  "$LAB_ROOT/scripts/setup.sh" --with test --with course
  mkdir -p "$LOG"
  enter_lab
  # The tests listen only on this machine.
  unset ROS_MASTER_URI ROS_HOSTNAME
  export ROS_IP=127.0.0.1
  [[ ! $coverage ]] || count_coverage
  ((!load)) || be_busy "$load"
  if ((repeat > 1)); then
    rm -rf "$LOG/runs"
    # shellcheck disable=SC2016,SC2086 # expanded by the shell that xargs starts; options
    seq "$repeat" | xargs -P "$at_once" -I {} bash -c 'run_number "$@"' run_number {} "$seed" \
      ${long:+--long} ${coverage:+--coverage} "${parts[@]}" || status=1
    python "$SUITE/outcomes.py" "$LOG/runs" || status=1
    return "$status"
  fi
  if [[ $seed ]]; then
    echo "order of the unit tests: --random-seed $seed"
    LAB_PYTEST_OPTIONS="-q --random-order --random-order-seed=$seed"
  fi
  run_once "${parts[@]}"
}

export -f attribute count summary_of run_faults run_fuzz run_lint run_number run_part run_program
export -f run_pytest run_rostest
export AGAIN LOG MUTANTS FAULTS ROSTEST_TIMEOUT LAB_ROOT LAB_ROS
main "$@"
