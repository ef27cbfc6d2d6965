#!/usr/bin/env bash
# Builds ROS packages of yours on top of the lab: messages, services, actions, C++ nodes, settings.
#
# Usage: scripts/overlay.sh FOLDER …
#
# A FOLDER is a package, or has packages below it, as the src of a catkin workspace has. They are
# built in the workspace build/overlay, which has a link to each of them, in place of those that
# were there. Afterwards, `source scripts/course.sh` enters it. A package that misses another one is
# left out, and so are those that need it; the status is then 1. The log is build/log/overlay.log.
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

OVERLAY=$LAB_DIR/overlay
BASE=$LAB_DIR/catkin/devel
LOG=$LAB_DIR/log/overlay.log

say() { printf 'overlay: %s\n' "$*" >&2; }

# Prints the command that builds the packages.
link_packages() (
  enter_lab
  python "$LAB_ROOT/scripts/setup/overlay.py" "$OVERLAY" "$BASE" "$@"
)

# build COMMAND: by Debian's Python, as in scripts/course.sh.
build() (
  unset CMAKE_PREFIX_PATH ROS_PACKAGE_PATH PYTHONPATH PYTHONHOME
  PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
  source_setup_file "$BASE/setup.bash"
  export ROS_LANG_DISABLE=geneus:genlisp:gennodejs
  cd "$OVERLAY"
  "$LAB_ROS/bin/$1" --force-cmake -DPYTHON_EXECUTABLE=/usr/bin/python3 -DCATKIN_ENABLE_TESTING=OFF
)

# Prints the lines of a log that say why a build has failed.
reasons() {
  grep -A 2 -E 'CMake Error|error:|Could not find a package configuration|Error [0-9]+$' "$1" \
    | grep -v '^--$' | head -n 12 || tail -n 12 "$1"
}

main() {
  local said tool status=0
  if ((!$#)) || [[ $1 == -* ]]; then
    sed -n '2,/^set/s/^# \{0,1\}//p' "${BASH_SOURCE[0]}"
    exit 2
  fi
  "$LAB_ROOT/scripts/setup.sh" --with catkin
  mkdir -p "$OVERLAY"
  said=$(mktemp)
  tool=$(link_packages "$@" 2> >(tee "$said" >&2))
  [[ ! -s $said ]] || status=1
  rm "$said"
  [[ -n $tool ]] || exit 1
  # A build by the other command cannot be continued.
  if [[ $(cat "$OVERLAY/built_by" 2>/dev/null) != "$tool" ]]; then
    rm -rf "$OVERLAY"/{build,build_isolated,devel,devel_isolated}
    echo "$tool" >"$OVERLAY/built_by"
  fi
  local packages=("$OVERLAY"/src/*)
  say "$tool: ${packages[*]##*/}"
  if ! build "$tool" >"$LOG" 2>&1 </dev/null; then
    reasons "$LOG" >&2
    say "$tool failed; the whole log is in $LOG. A package with an empty file CATKIN_IGNORE is left out"
    exit 1
  fi
  say "done; in each terminal: source $LAB_ROOT/scripts/course.sh"
  return "$status"
}

main "$@"
