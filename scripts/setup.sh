#!/usr/bin/env bash
# Installs and builds what is missing; does nothing, quickly, when nothing is.
#
# Usage: scripts/setup.sh [--no-build] [--with rviz] [--with test] [--with course] [--with browser]
#
# --no-build leaves the building to you, in a catkin workspace of your own.
# Debian packages come by apt-get (through sudo where not root), Python packages into
# build/venv, the catkin workspace is built in build/ws. Where /opt/ros/noetic exists it
# is used instead of Debian's ROS. What ran is in build/log.
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

say() { printf 'setup: %s\n' "$*" >&2; }

fail() {
  say "$*"
  exit 1
}

# ---- What there is to install ----

debian_packages() {
  if [[ $LAB_ROS == /opt/ros/noetic ]]; then
    noetic_packages "$1"
    return
  fi
  case $1 in
    base)
      echo ca-certificates g++ make cmake python3 python3-venv catkin ros-core rosbash \
        python3-roslaunch python3-rosmaster python3-rospy \
        ros-message-generation ros-message-runtime \
        python3-actionlib python3-actionlib-msgs python3-cv-bridge python3-diagnostic-msgs \
        python3-geometry-msgs python3-message-filters python3-move-base-msgs python3-nav-msgs \
        python3-rosgraph-msgs python3-sensor-msgs python3-std-msgs python3-std-srvs python3-tf2-msgs python3-tf2-ros python3-visualization-msgs \
        python3-dynamic-reconfigure python3-trajectory-msgs libtrajectory-msgs-dev \
        libactionlib-msgs-dev libdiagnostic-msgs-dev \
        libgeometry-msgs-dev libnav-msgs-dev libsensor-msgs-dev libstd-msgs-dev \
        libstd-srvs-dev libtf2-ros-dev libvisualization-msgs-dev libroscpp-dev \
        ros-actionlib-msgs ros-diagnostic-msgs ros-geometry-msgs ros-move-base-msgs ros-nav-msgs \
        ros-rosgraph-msgs ros-sensor-msgs ros-std-msgs ros-std-srvs ros-tf2-msgs ros-trajectory-msgs ros-visualization-msgs \
        ros-robot-state-publisher libegl1 libgl1 libgl1-mesa-dri \
        joint-state-publisher tf-tools libnodeletlib-tools topic-tools
      ;;
    rviz) echo rviz xvfb ;;
    test) echo shellcheck python3-rostest iproute2 sdformat-sdf libxml2-utils xvfb ;;
    # What scripts of courses import; Debian's OpenCV has windows and the old calls for markers.
    course)
      echo python3-opencv python3-tf python3-tf-conversions python3-tf2-geometry-msgs \
        python3-image-geometry python3-matplotlib python3-tk
      ;;
    browser) echo chromium ;;
  esac
}

noetic_packages() {
  local name names=()
  case $1 in
    base)
      names=(actionlib actionlib-msgs catkin control-msgs controller-manager-msgs cv-bridge diagnostic-msgs dynamic-reconfigure gazebo-msgs geometry-msgs
        joint-state-publisher message-filters message-generation message-runtime move-base-msgs nav-msgs nodelet
        robot-state-publisher rosbag rosbash
        rosgraph-msgs roslaunch rosmaster rospy sensor-msgs std-msgs std-srvs tf tf2-msgs tf2-ros topic-tools trajectory-msgs visualization-msgs)
      echo ca-certificates g++ make cmake python3 python3-venv libegl1 libgl1 libgl1-mesa-dri
      ;;
    rviz)
      names=(rviz)
      echo xvfb
      ;;
    test)
      names=(rostest)
      echo shellcheck iproute2 sdformat-sdf libxml2-utils xvfb
      ;;
    course)
      names=(tf tf-conversions tf2-geometry-msgs image-geometry)
      echo python3-opencv python3-matplotlib python3-tk
      ;;
  esac
  for name in "${names[@]}"; do
    echo "ros-noetic-$name"
  done
}

# ---- Steps: each has its inputs; it is done again when their checksum changes ----

inputs_of() {
  local name
  echo "$LAB_ROOT $LAB_ROS"
  case $1 in
    debian-*) debian_packages "${1#debian-}" ;;
    python-base)
      readlink -f /usr/bin/python3
      cat "$LAB_ROOT/requirements.txt"
      echo "$OWN_TOOLKITS"
      ;;
    python-*) cat "$LAB_ROOT/requirements.txt" "$LAB_ROOT/requirements-${1#python-}.txt" ;;
    build)
      package_entries
      ls "$LAB_ROOT"/{scripts/*.py,launch/*.launch}
      cat "$LAB_ROOT"/{CMakeLists.txt,package.xml,setup.py} "$LAB_ROOT"/{action,msg,srv}/*
      for name in $(stand_ins); do
        ls "$LAB_ROOT/stand_ins/$name"/*
        cat "$LAB_ROOT/stand_ins/$name"/{CMakeLists.txt,package.xml}
      done
      ;;
  esac
}

checksum_of() { inputs_of "$1" | sha256sum; }

is_done() {
  local stamp=$LAB_DIR/stamp/$1
  case $1 in
    debian-course) has_packages "$1" && [[ -x $LAB_COURSE/python ]] || return 1 ;;
    debian-*) has_packages "$1" || return 1 ;;
    python-*) [[ -x $LAB_VENV/bin/python ]] && are_all_there "$stamp.system" || return 1 ;;
    build) [[ -e $LAB_WS/devel/setup.bash ]] || return 1 ;;
  esac
  [[ -e $stamp && $(<"$stamp") == "$(checksum_of "$1")" ]]
}

# One may have been removed since. Without dpkg, the stamp has to do.
has_packages() {
  command -v dpkg-query >/dev/null || return 0
  local packages
  read -r -d '' -a packages < <(debian_packages "${1#debian-}") || true
  [[ -z $(missing_of "${packages[@]}") ]]
}

# Those that a file lists, one a line.
are_all_there() { xargs -r -d '\n' ls -d <"$1"; } >/dev/null 2>&1

mark_done() { checksum_of "$1" >"$LAB_DIR/stamp/$1"; }

describe() {
  case $1 in
    debian-base) echo "Debian packages" ;;
    debian-*) echo "Debian packages for ${1#debian-}" ;;
    python-base) echo "virtual environment" ;;
    python-*) echo "Python packages for ${1#python-}" ;;
    build) echo "catkin build" ;;
  esac
}

# ---- Running something quietly ----

# On a terminal, shows how long a step has taken and the last line of its log.
tick() {
  local title=$1 log=$2 start=$SECONDS line
  while sleep 1; do
    line=$(tail -n 1 "$log" 2>/dev/null | tr -cd '[:print:]' || true)
    printf '\rsetup: %s, %d s: %.60s\033[K' "$title" $((SECONDS - start)) "$line" >&2
  done
}

# run_quietly TITLE LOG COMMAND…: output goes to the log, which is shown on failure only.
run_quietly() {
  local title=$1 log=$2 ticker="" status=0
  shift 2
  if [[ -t 2 ]]; then
    tick "$title" "$log" 9>&- &
    ticker=$!
  fi
  # Nothing that is started may inherit the lock (fd 9) and hold it for longer than this.
  "$@" >>"$log" 2>&1 </dev/null 9>&- || status=$?
  if [[ -n $ticker ]]; then
    kill "$ticker" 2>/dev/null || true
    wait "$ticker" 2>/dev/null || true
    printf '\r\033[K' >&2
  fi
  if ((status)); then
    tail -n 40 "$log" >&2
    say "$title failed, the whole log is in $log"
  fi
  return "$status"
}

# ---- Debian packages ----

missing_of() {
  local installed
  installed=$(dpkg-query -W -f '${Package} ${db:Status-Status}\n' "$@" 2>/dev/null || true)
  comm -23 <(printf '%s\n' "$@" | sort -u) \
    <(awk '$2 == "installed" {print $1}' <<<"$installed" | sort -u)
}

# Fails rather than waits for a password where nobody can type one.
become_root() {
  ((EUID)) || return 0
  if command -v sudo >/dev/null; then
    if sudo -n true 2>/dev/null; then
      return 0
    fi
    if [[ -t 0 && -z ${CI-} ]]; then
      say "the password is for installing Debian packages: $*"
      sudo -v && return 0
    fi
  fi
  fail "Debian packages are missing; as root: apt-get install --no-install-recommends $*"
}

apt_get() {
  local command=(env DEBIAN_FRONTEND=noninteractive apt-get -y -o DPkg::Lock::Timeout=600)
  if ((EUID)); then
    command=(sudo -n "${command[@]}")
  fi
  "${command[@]}" "$@"
}

# Where course.sh finds Debian's Python, whatever stands first in PATH.
link_debians_python() {
  mkdir -p "$LAB_COURSE"
  ln -sfn /usr/bin/python3 "$LAB_COURSE/python3"
  ln -sfn /usr/bin/python3 "$LAB_COURSE/python"
}

# A list that cannot be refreshed may be one that is not needed: the installation tells.
apt_install() {
  apt_get update || true
  apt_get install --no-install-recommends "$@"
}

step_debian() {
  local title=$1 log=$2 part=$3 missing
  [[ $part != course ]] || link_debians_python
  read -r -d '' -a packages < <(debian_packages "$part") || true
  mapfile -t missing < <(missing_of "${packages[@]}")
  ((${#missing[@]})) || return 0
  command -v apt-get >/dev/null || fail "no apt-get here; install by hand: ${missing[*]}"
  say "$title: installing ${missing[*]}"
  become_root "${missing[@]}"
  run_quietly "$title" "$log" apt_install "${missing[@]}"
}

# ---- Python packages ----

pip_install() {
  PIP_USER=0 "$LAB_VENV/bin/python" -m pip install --disable-pip-version-check --no-input \
    --no-color --progress-bar off "$@"
}

# Debian's matplotlib, where it is installed, puts its own mpl_toolkits before those of ours, which
# they do not fit: here ours come first. site runs each line of a .pth as it is read.
OWN_TOOLKITS="import os, sys, types; \
sys.modules.setdefault('mpl_toolkits', types.ModuleType('mpl_toolkits')).__dict__\
.setdefault('__path__', []).append(os.path.join(sys._getframe(1).f_locals['sitedir'], 'mpl_toolkits'))"

put_own_toolkits_first() {
  local site
  site=$("$LAB_VENV/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
  echo "$OWN_TOOLKITS" >"$site/mpl_toolkits.pth"
}

# ROS's modules are the system's. An old pip knows too few kinds of wheels.
create_venv() {
  /usr/bin/python3 -m venv --system-site-packages "$LAB_VENV" \
    && pip_install 'pip>=21' \
    && pip_install -r "$LAB_ROOT/requirements.txt" \
    && put_own_toolkits_first
}

# Prints where the descriptions are of those of the system's packages that ours need.
SYSTEM_PACKAGES='
import re, sys
from importlib.metadata import distributions

def plain(name):
    return re.sub("[-_.]+", "-", name).lower()

found, seen = {}, set()
for one in distributions():
    found.setdefault(plain(one.metadata["Name"] or ""), one)
names = list(open(sys.argv[1]))
while names:
    name = re.match(r"[\w.-]*", names.pop())[0]
    one = found.get(plain(name))
    if one and one not in seen:
        seen.add(one)
        names += [line for line in one.requires or () if "extra ==" not in line]
        if not str(one._path).startswith(sys.prefix):
            print(one._path)
'

# note_system_packages STEP LIST: they may be removed or replaced later.
note_system_packages() {
  "$LAB_VENV/bin/python" -c "$SYSTEM_PACKAGES" "$2" >"$LAB_DIR/stamp/$1.system"
}

step_python() {
  local title=$1 log=$2 part=$3 list=$LAB_ROOT/requirements.txt
  unset PYTHONPATH PYTHONHOME
  export PYTHONNOUSERSITE=1
  if [[ $part == base ]]; then
    run_quietly "$title" "$log" create_venv
  else
    list=$LAB_ROOT/requirements-$part.txt
    run_quietly "$title" "$log" pip_install -r "$list"
  fi
  # What cannot be told of a strange installation is not looked after.
  note_system_packages "python-$part" "$list" 2>>"$log" || true
}

# ---- The catkin workspace ----

# Leaves out what the user's shell knows of Python and other workspaces: the build keeps it.
build_workspace() (
  unset CMAKE_PREFIX_PATH ROS_PACKAGE_PATH
  use_lab_python
  # Everything here is Python: messages in four more languages take most of the time.
  export ROS_LANG_DISABLE=gencpp:geneus:genlisp:gennodejs
  PATH=$LAB_VENV/bin:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
  if [[ $LAB_ROS != /usr ]]; then
    source_setup_file "$LAB_ROS/setup.bash"
  fi
  "$LAB_ROS/bin/catkin_make" -C "$LAB_WS" \
    -DPYTHON_EXECUTABLE="$LAB_VENV/bin/python" -DCATKIN_ENABLE_TESTING=OFF
)

# The top level of the package, less what running it leaves there.
package_entries() { ls --ignore=build --ignore=results "$LAB_ROOT"; }

# Links what is in the package one by one: with a link to the whole of it, rosrun would follow
# the link into this very workspace, round and round.
link_package() {
  local entry
  rm -rf "$1"
  mkdir -p "$1"
  for entry in $(package_entries); do
    ln -s "$LAB_ROOT/$entry" "$1/"
  done
}

# What was written for Gazebo names its packages: where the real ones are absent, ours are built
# beside us.
stand_ins() {
  local folder name
  for folder in "$LAB_ROOT"/stand_ins/*/; do
    name=$(basename "$folder")
    [[ -e $LAB_ROS/share/$name/package.xml ]] || echo "$name"
  done
}

step_build() {
  local title=$1 log=$2 name
  link_package "$LAB_WS/src/bullet_lab"
  find "$LAB_WS/src" -maxdepth 1 -lname "*/stand_ins/*" -delete
  for name in $(stand_ins); do
    ln -s "$LAB_ROOT/stand_ins/$name" "$LAB_WS/src/$name"
  done
  # What was built elsewhere, before the clone was moved, is of no use.
  if ! grep -qsxF "CMAKE_HOME_DIRECTORY:INTERNAL=$LAB_WS/src" "$LAB_WS/build/CMakeCache.txt"; then
    rm -rf "$LAB_WS/build" "$LAB_WS/devel"
  fi
  run_quietly "$title" "$log" build_workspace
}

# ---- Main ----

take_step() {
  local step=$1 number=$2 of=$3 start=$SECONDS title log
  title="[$number/$of] $(describe "$step")"
  log=$LAB_DIR/log/$step.log
  : >"$log"
  say "$title"
  case $step in
    build) step_build "$title" "$log" ;;
    *) "step_${step%-*}" "$title" "$log" "${step#*-}" ;;
  esac
  mark_done "$step"
  say "$title: done, $((SECONDS - start)) s"
}

# The steps of those named that are not done yet.
open_steps() {
  local step
  for step in "$@"; do
    is_done "$step" || echo "$step"
  done
}

steps_of() {
  printf '%s\n' debian-base python-base
  if [[ ${1-} == --no-build ]]; then
    shift
  else
    echo build
  fi
  while (($#)); do
    case "$1 ${2-}" in
      "--with rviz") echo debian-rviz ;;
      "--with test") printf '%s\n' debian-test python-test ;;
      "--with course") echo debian-course ;;
      "--with browser") printf '%s\n' debian-browser python-browser ;;
      *) fail "unknown argument '$*'; usage: setup.sh [--no-build] [--with rviz|test|course|browser] …" ;;
    esac
    shift 2
  done
}

# Another user's clone is set up by its owner.
take_lock() {
  local owner
  if ! mkdir -p "$LAB_DIR"/{log,stamp} 2>/dev/null || [[ ! -w $LAB_DIR ]]; then
    owner=$(stat -c %U "$LAB_DIR" 2>/dev/null || stat -c %U "$LAB_ROOT")
    fail "something is missing, and you may not write to $LAB_DIR; its owner, $owner, has to run:" \
      "$LAB_ROOT/scripts/setup.sh${*:+ $*}"
  fi
  exec 9>"$LAB_DIR/setup.lock"
  if ! flock -n 9; then
    say "waiting for another setup.sh"
    flock 9
  fi
}

main() {
  local wanted steps i
  wanted=$(steps_of "$@") || exit 2
  # shellcheck disable=SC2086
  [[ -n $(open_steps $wanted) ]] || return 0
  if [[ $LAB_ROOT =~ [[:space:]] ]]; then
    fail "catkin cannot build in a folder with a space in its name: $LAB_ROOT"
  fi
  take_lock "$@"
  # shellcheck disable=SC2086
  mapfile -t steps < <(open_steps $wanted)
  for i in "${!steps[@]}"; do
    take_step "${steps[i]}" $((i + 1)) ${#steps[@]}
  done
  # PyPI's command of this name needs ROS 2, and would hide the one that works.
  rm -f "$LAB_VENV/bin/xacro"
}

# platform.sh takes single steps.
[[ ${BASH_SOURCE[0]} != "$0" ]] || main "$@"
