#!/usr/bin/env bash
# Checks other systems: bare Debians, and Ubuntu 20.04 with ROS in /opt/ros/noetic as far as others
# can: scripts/platform.sh [--sources DIR] [check …]; by default all checks, in build/platform.
#
#   debian11, debian12, debian13
#            a bare system by debootstrap, which needs root: an ordinary user runs the README's two
#            commands in a clone; the results of squares are those of this machine, to the byte
#   resolve  PyPI has all required packages for Python 3.8 and Ubuntu 20.04's glibc
#   newest   the unit tests pass with Python 3.8 and the newest packages for it
#   lowest   the same, with the lowest versions that requirements.txt allows
#   overlay  overlay.sh builds packages of test/overlay, and their nodes run
#   catkin   the build works in a ROS that has gazebo_msgs, gazebo_ros, xacro …
#
# Python 3.8 is $PYTHON38, or python3.8; uv downloads it if it is missing. Packages for the check
# `catkin` are copies of our stand-ins, except those with sources in DIR. docs/platforms.md lists
# what cannot be checked this way.
set -euo pipefail

# shellcheck source=scripts/setup.sh
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"

PLATFORM=$LAB_ROOT/build/platform
CHECKS=(debian11 debian12 debian13 resolve newest lowest overlay catkin)
GLIBC=2_31
# The Python packages that ROS's own packages import.
ROS_NEEDS=(catkin_pkg netifaces pycryptodomex python-gnupg PyYAML rospkg)
# These import tf2, whose C++ module fits only the system's Python.
NEED_TF2=(
  --ignore=test/unit/ros/gazebo/test_client.py
  --ignore=test/unit/ros/nodes/test_bad_parameters.py
  --ignore=test/unit/ros/nodes/test_dock_node.py
  --deselect=test/unit/jobs/test_declaration.py::test_every_shipped_job_has_the_common_arguments_and_sound_defaults
)

# ---- Bare Debians ----

check_debian11() { check_debian bullseye; }

check_debian12() { check_debian bookworm; }

check_debian13() { check_debian trixie; }

as_root() { if ((EUID)); then sudo "$@"; else "$@"; fi; }

# check_debian SUITE: make the system, and compare its results with this machine's.
check_debian() {
  local root=$PLATFORM/$1 file
  (cd "$PLATFORM" && "$LAB_ROOT/scripts/run.sh" squares)
  as_root rm -rf --one-file-system "$root"
  as_root debootstrap --variant=minbase --include=git,sudo,ca-certificates "$1" "$root"
  as_root chroot "$root" useradd --create-home --shell /bin/bash student
  echo "student ALL=(ALL) NOPASSWD: ALL" | as_root tee "$root/etc/sudoers.d/student" >/dev/null
  as_root git clone -q "$LAB_ROOT" "$root/home/student/lab"
  as_root chroot "$root" chown -R student: /home/student
  in_debian "$root" "cd lab && time scripts/run.sh squares && scripts/run.sh vision"
  for file in odom.tum noisy_odom.tum paths.csv paths.png; do
    cmp "$PLATFORM/results/squares/$file" "$root/home/student/lab/results/squares/$file"
  done
  in_debian "$root" "cd lab && scripts/test.sh"
}

# in_debian ROOT COMMAND: run a command as the ordinary user; its mounts end with it.
in_debian() {
  # shellcheck disable=SC2016
  as_root unshare --mount --fork bash -c '
    mount --rbind /dev "$0/dev" && mount --rbind /sys "$0/sys" && mount -t proc proc "$0/proc"
    cp -L /etc/resolv.conf /etc/hosts "$0/etc/"
    # Of a network with a certificate of its own.
    cp -L /etc/ssl/certs/ca-certificates.crt "$0/etc/ssl/certs/"
    exec chroot "$0" su --login student -c "$1"' "$1" "$2"
}

# ---- Python 3.8 ----

check_resolve() {
  get_uv
  "$UV" pip compile --quiet --no-header --no-annotate --python-version 3.8 \
    --python-platform "x86_64-manylinux_$GLIBC" "$LAB_ROOT"/requirements*.txt
}

check_newest() { test_with newest highest; }

check_lowest() { test_with lowest lowest-direct; }

# test_with NAME RESOLUTION: run the unit tests in a separate virtual environment.
test_with() {
  local venv=$PLATFORM/$1
  get_uv
  [[ -x $venv/bin/python ]] || "$UV" venv --quiet --python "${PYTHON38:-3.8}" "$venv"
  "$UV" pip install --quiet --python "$venv" --resolution "$2" -r "$LAB_ROOT/requirements.txt"
  "$UV" pip freeze --python "$venv" >"$PLATFORM/$1.txt"
  "$UV" pip install --quiet --python "$venv" -c "$PLATFORM/$1.txt" \
    pytest pytest-xdist psutil "${ROS_NEEDS[@]}"
  link_ros
  (
    cd "$LAB_ROOT"
    export PYTHONPATH=$LAB_WS/devel/lib/python3/dist-packages:$LAB_ROOT/src:$PLATFORM/ros
    export ROS_PACKAGE_PATH=$LAB_ROOT:$LAB_ROS/share ROS_IP=127.0.0.1 PYTHONNOUSERSITE=1
    export ROS_MASTER_URI=http://localhost:11311
    "$venv/bin/python" -m pytest -q -n "${PLATFORM_WORKERS:-auto}" --dist loadfile -m "not long" \
      -p no:cacheprovider "${NEED_TF2[@]}" test/unit
  )
}

# Links only ROS's Python packages from a folder that has others, too.
link_ros() {
  local folder name
  rm -rf "$PLATFORM/ros"
  mkdir -p "$PLATFORM/ros"
  for folder in "$LAB_ROS"/lib/python3/dist-packages/*/; do
    name=$(basename "$folder")
    if [[ -e $LAB_ROS/share/$name/package.xml || -e $folder/msg || -e $folder/srv ]] \
      || [[ $name =~ ^(catkin|dynamic_reconfigure|genmsg|message_filters|ros.*|tf2_.*)$ ]]; then
      ln -s "$folder" "$PLATFORM/ros/$name"
    fi
  done
}

# ---- Packages of users ----

check_overlay() (
  local said
  said=$("$LAB_ROOT/scripts/overlay.sh" "$LAB_ROOT/test/overlay" 2>&1) && return 1
  echo "$said"
  grep -q 'course_lost: left out; it needs gmapping (Debian has none' <<<"$said"
  grep -q 'course_later: left out; it needs course_lost (left out)' <<<"$said"
  set +u
  # shellcheck source=/dev/null
  source "$LAB_ROOT/scripts/course.sh"
  said=$(ROS_MASTER_URI=http://localhost:11947 roslaunch course_client all.launch 2>&1)
  echo "$said"
  grep -q 'length 0.5 lap 2 in 2.0 s, goal 3 s' <<<"$said"
  rm -rf "$LAB_DIR/overlay"
)

# ---- A ROS that has all packages ----

# Installs the packages of our stand-ins in a prefix, as in a full ROS, without this package.
make_own_ros() {
  local prefix=$1 sources=$2 folder name
  rm -rf "$PLATFORM/own" "$prefix"
  mkdir -p "$PLATFORM/own/src" "$prefix/bin"
  for folder in "$LAB_ROOT"/stand_ins/*; do
    name=$(basename "$folder")
    if [[ -e $sources/$name/package.xml ]]; then
      cp -rL "$sources/$name" "$PLATFORM/own/src/"
    else
      cp -rL "$folder" "$PLATFORM/own/src/"
      sed -i '/bullet_lab<\/exec_depend>/d' "$PLATFORM/own/src/$name/package.xml"
    fi
  done
  "$LAB_ROS/bin/catkin_make" -C "$PLATFORM/own" install -DCMAKE_INSTALL_PREFIX="$prefix" \
    -DCATKIN_ENABLE_TESTING=OFF
  ln -s "$LAB_ROS/bin/catkin_make" "$prefix/bin/"
}

check_catkin() (
  use_lab_python
  unset CMAKE_PREFIX_PATH ROS_PACKAGE_PATH
  make_own_ros "$PLATFORM/noetic" "$SOURCES"
  mkdir -p "$PLATFORM/lab"
  ln -sfn "$LAB_VENV" "$PLATFORM/lab/venv"
  LAB_DIR=$PLATFORM/lab LAB_ROS=$PLATFORM/noetic
  # A step of setup.sh.
  step_catkin "catkin build" "$PLATFORM/lab/build.log"
  enter_lab
  [[ -z $(stand_ins) ]]
  python "$LAB_ROOT/test/platform/own_packages.py" "$PLATFORM/noetic" "$LAB_ROOT/stand_ins"
)

# ---- Main ----

try_check() {
  local name=$1 log=$PLATFORM/$1.log start=$SECONDS
  # In another shell: within a condition, `set -e` has no effect.
  if ! bash -c 'set -euo pipefail; source "$1"; SOURCES=$3; "check_$2"' check \
    "${BASH_SOURCE[0]}" "$name" "$SOURCES" >"$log" 2>&1; then
    tail -n 30 "$log" >&2
    echo "$name: FAILED, $((SECONDS - start)) s; all of it is in $log"
    return 1
  fi
  echo "$name: passed, $((SECONDS - start)) s"
}

platform() {
  local failed=0 name
  SOURCES=
  if [[ ${1-} == --sources ]]; then
    SOURCES=$(realpath -e "${2:?a folder}")
    shift 2
  fi
  "$LAB_ROOT/scripts/setup.sh" --with catkin
  mkdir -p "$PLATFORM"
  for name in "${@:-${CHECKS[@]}}"; do
    if [[ " ${CHECKS[*]} " != *" $name "* ]]; then
      echo "platform: there is no check '$name'; checks: ${CHECKS[*]}" >&2
      exit 2
    fi
    try_check "$name" || failed=1
  done
  return "$failed"
}

[[ ${BASH_SOURCE[0]} != "$0" ]] || platform "$@"
