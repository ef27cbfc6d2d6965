#!/usr/bin/env bash
# Installs and builds what is missing; ends at once if nothing is missing.
#
# Usage: scripts/setup.sh [--least | --no-build] [--with rviz|test|course|browser|catkin] …
#        scripts/setup.sh --download DIR | --offline DIR [--with …] … | --remove | --renew-lock
#
# --download: collect all packages in a folder, for machines without internet and with the same
#   Debian. --offline: install from such a folder.
# --remove: delete build/, and name the Debian packages that were installed for it.
# --least: only what the job squares needs with its defaults.
# --no-build: you build the package yourself, in your own catkin workspace; installs a compiler.
# --renew-lock: take the newest versions that requirements*.txt allow into requirements*.lock.
# Debian packages are installed by apt-get (with sudo unless you are root), Python packages into
# build/venv; build/ws is a catkin workspace that was made without a compiler. If /opt/ros/noetic
# exists, it is used instead of Debian's ROS. Logs are in build/log.
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

# All clones of a user share it.
UV_FOLDER=${XDG_CACHE_HOME:-${HOME:-$LAB_DIR}/.cache}/bullet_lab/uv
UV=$UV_FOLDER/bin/uv
# A folder that --download has made, in place of the internet.
OFFLINE=
LEAST_MEGABYTES=2000

say() { printf 'setup: %s\n' "$*" >&2; }

fail() {
  say "$*"
  exit 1
}

# ---- Packages ----

debian_packages() {
  if [[ $LAB_ROS == /opt/ros/noetic ]]; then
    noetic_packages "$1"
    return
  fi
  case $1 in
    # What a program needs to be installed beside the other packages.
    first) echo ca-certificates python3 python3-venv ;;
    # What the job squares needs. workspace.py generates messages whose packages would bring compilers.
    base)
      echo rosout joint-state-publisher ros-robot-state-publisher python3-rosgraph \
        python3-roslaunch python3-rosmaster python3-rosparam python3-rospy python3-actionlib \
        python3-dynamic-reconfigure python3-genpy python3-message-filters
      printf 'ros-%s\n' {actionlib,diagnostic,geometry,move-base,nav,rosgraph,sensor,std}-msgs \
        {tf2,trajectory,visualization}-msgs std-srvs
      printf 'python3-%s\n' {actionlib,diagnostic,geometry,rosgraph,sensor,std,tf2}-msgs \
        {trajectory,visualization}-msgs std-srvs
      ;;
    # tf2, OpenGL, and the commands of ROS. rosmsg finds definitions, and roslaunch nodes of
    # topic_tools and tf, by the package.xml of -dev.
    more)
      echo rosbash topic-tools libtopic-tools-dev python3-rosbag python3-rosmsg python3-rosnode \
        python3-rosservice python3-rostopic python3-tf2-ros python3-nav-msgs python3-move-base-msgs \
        libegl1 libgl1 libgl1-mesa-dri
      printf 'lib%s-dev\n' {actionlib,diagnostic,geometry,move-base,nav,sensor,std,tf2}-msgs \
        {trajectory,visualization}-msgs ros-rosgraph-msgs std-srvs
      ;;
    catkin)
      echo g++ make cmake catkin ros-message-generation ros-message-runtime libroscpp-dev \
        libtf2-ros-dev libdynamic-reconfigure-config-init-mutex-dev python3-setuptools
      ;;
    rviz) echo rviz xvfb ;;
    test) echo shellcheck python3-rostest libxml2-utils xvfb "$(if_known sdformat-sdf)" ;;
    # Scripts of courses import these; Debian's OpenCV has windows and the old marker functions.
    course)
      echo python3-opencv python3-tf python3-tf-conversions python3-tf2-geometry-msgs \
        python3-image-geometry python3-matplotlib python3-tk python3-cv-bridge \
        tf-tools libtf-dev tf2-tools libnodeletlib-tools
      ;;
    browser) echo chromium ;;
  esac
}

# Prints a package's name if this Debian has it.
if_known() { ! apt-cache show "$1" >/dev/null 2>&1 || echo "$1"; }

noetic_packages() {
  local name names=()
  case $1 in
    base)
      names=(actionlib actionlib-msgs control-msgs controller-manager-msgs diagnostic-msgs
        dynamic-reconfigure gazebo-msgs genpy geometry-msgs joint-state-publisher message-filters
        move-base-msgs nav-msgs nodelet robot-state-publisher rosbag rosbash rosgraph-msgs roslaunch
        rosmaster rosmsg rosnode rosout rosparam rospy rosservice rostopic sensor-msgs std-msgs
        std-srvs tf tf2-msgs tf2-ros topic-tools trajectory-msgs visualization-msgs)
      echo libegl1 libgl1 libgl1-mesa-dri
      ;;
    first) echo ca-certificates python3 python3-venv ;;
    catkin)
      names=(catkin message-generation message-runtime)
      echo g++ make cmake
      ;;
    rviz)
      names=(rviz)
      echo xvfb
      ;;
    test)
      names=(rostest)
      echo shellcheck sdformat-sdf libxml2-utils xvfb
      ;;
    course)
      names=(cv-bridge tf tf-conversions tf2-geometry-msgs image-geometry)
      echo python3-opencv python3-matplotlib python3-tk
      ;;
  esac
  for name in "${names[@]}"; do
    echo "ros-noetic-$name"
  done
}

# ---- Steps: a step is repeated if the checksum of its inputs changes ----

inputs_of() {
  local name folders=() manifests=()
  echo "$LAB_ROOT $LAB_ROS"
  case $1 in
    debian-*) debian_packages "${1#debian-}" ;;
    python-base)
      readlink -f /usr/bin/python3
      cat "$LAB_ROOT/requirements.lock"
      echo "$OWN_TOOLKITS"
      ;;
    python-*) cat "$LAB_ROOT/requirements.lock" "$LAB_ROOT/requirements-${1#python-}.lock" ;;
    build | catkin)
      package_entries
      for name in $(stand_ins); do
        folders+=("$LAB_ROOT/stand_ins/$name"/*)
        manifests+=("$LAB_ROOT/stand_ins/$name"/{CMakeLists.txt,package.xml})
      done
      ls "$LAB_ROOT"/{scripts/*.py,launch/*.launch} "${folders[@]}"
      cat "$LAB_ROOT"/{scripts/setup/workspace.py,CMakeLists.txt,package.xml,setup.py} \
        "$LAB_ROOT"/{action,msg,srv}/* "${manifests[@]}"
      ;;
  esac
}

checksum_of() { inputs_of "$1" | sha256sum; }

is_done() {
  local stamp=$LAB_DIR/stamp/$1
  case $1 in
    debian-course) has_packages "$1" && [[ -x $LAB_COURSE/python ]] || return 1 ;;
    debian-*) has_packages "$1" || return 1 ;;
    python-*) [[ -x $LAB_VENV/bin/python ]] || return 1 ;;
    build) [[ -e $LAB_WS/devel/setup.bash ]] || return 1 ;;
  esac
  [[ -e $stamp && $(<"$stamp") == "$(checksum_of "$1")" ]]
}

# A package may have been removed since. Without dpkg, only the stamp is checked.
has_packages() {
  command -v dpkg-query >/dev/null || return 0
  local packages
  read -r -d '' -a packages < <(debian_packages "${1#debian-}") || true
  [[ -z $(missing_of "${packages[@]}") ]]
}

mark_done() { checksum_of "$1" >"$LAB_DIR/stamp/$1"; }

describe() {
  case $1 in
    debian-first) echo "Debian packages for Python" ;;
    debian-base) echo "Debian packages of ROS" ;;
    debian-more) echo "Debian packages of tf2 and OpenGL" ;;
    debian-*) echo "Debian packages for ${1#debian-}" ;;
    python-base) echo "virtual environment" ;;
    python-*) echo "Python packages for ${1#python-}" ;;
    build) echo "messages and workspace" ;;
    catkin) echo "catkin build" ;;
  esac
}

# ---- Commands whose output goes to a log ----

# download_in LOG: print the size of apt-get's download, if it has begun one.
download_in() { sed -n 's/^Need to get \([^ ]* [kM]*B\).*/, \1/p' "$1" | tail -n 1; }

# Shows the duration of a step, the size of its download and the last line of its log, on a terminal.
tick() {
  local title=$1 log=$2 start=$SECONDS line
  while sleep 1; do
    line=$(tail -n 1 "$log" 2>/dev/null | tr -cd '[:print:]' || true)
    printf '\rsetup: %s, %d s%s: %.60s\033[K' \
      "$title" $((SECONDS - start)) "$(download_in "$log")" "$line" >&2
  done
}

# run_quietly TITLE LOG COMMAND…: write the output to the log; print the log only on failure.
run_quietly() {
  local title=$1 log=$2 ticker="" status=0
  shift 2
  if [[ -t 2 ]]; then
    tick "$title" "$log" 9>&- &
    ticker=$!
  fi
  # A process that inherits the lock (fd 9) could hold it for longer than this script.
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
  local states name
  (($#)) || return 0
  states=$(dpkg-query -W -f '${Package} ${db:Status-Status}\n' "$@" 2>/dev/null || true)
  for name in "$@"; do
    [[ $'\n'$states$'\n' == *$'\n'"$name installed"$'\n'* ]] || echo "$name"
  done
}

# Fails instead of waiting for a password if there is no terminal.
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
  if [[ -n $OFFLINE ]]; then
    command+=(--no-download -o Dir::Etc="$OFFLINE/apt"
      -o Dir::State::lists="$OFFLINE/lists" -o Dir::Cache::archives="$OFFLINE/debs")
  fi
  if ((EUID)); then
    command=(sudo -n "${command[@]}")
  fi
  "${command[@]}" "$@"
}

# course.sh puts these links first in PATH, so that Debian's Python is found.
link_debians_python() {
  mkdir -p "$LAB_COURSE"
  ln -sfn /usr/bin/python3 "$LAB_COURSE/python3"
  ln -sfn /usr/bin/python3 "$LAB_COURSE/python"
}

# A failed update may concern a list that is not needed; if not, the installation fails. Users who
# do this at the same time wait for each other: apt-get itself waits only for dpkg.
apt_install() (
  exec 8</var/lib/apt/lists
  flock 8
  [[ -n $OFFLINE ]] || apt_get update 8<&- || true
  apt_get install --no-install-recommends "$@" 8<&-
)

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
  printf '%s\n' "${missing[@]}" >>"$LAB_DIR/installed"
}

# ---- Python packages ----

# uv installs them in a tenth of pip's time, and its cache serves all clones of a user.
get_uv() (
  from=() made=""
  [[ ! -x $UV ]] || return 0
  [[ -z $OFFLINE ]] || from=(--no-index --find-links "$OFFLINE/wheels")
  mkdir -p "${UV_FOLDER%/*}" || return 1
  # Also after Ctrl-C.
  trap 'rm -rf "$made"' EXIT
  made=$(mktemp -d "$UV_FOLDER.XXXX") || return 1
  # Another clone may do the same now: the second one's stays unused.
  ! debians_pip install "${from[@]}" --only-binary :all: --target "$made" uv \
    || mv -T "$made" "$UV_FOLDER" || true
  [[ -x $UV ]]
)

# pip as python3-venv brings it, without a virtual environment.
debians_pip() {
  local pip=(/usr/share/python-wheels/pip-*.whl)
  PYTHONPATH=${pip[0]} /usr/bin/python3 -m pip --disable-pip-version-check --no-input --no-color \
    --quiet "$@"
}

# python_install OPTION…: install packages into the virtual environment, by uv or else by pip.
python_install() {
  local from=()
  [[ -z $OFFLINE ]] || from=(--no-index --find-links "$OFFLINE/wheels")
  if [[ -x $UV ]]; then
    UV_SYSTEM_CERTS=1 "$UV" --no-progress --no-config pip install --python "$LAB_VENV" \
      "${from[@]}" "$@"
  else
    PIP_USER=0 "$LAB_VENV/bin/python" -m pip install --disable-pip-version-check --no-input \
      --no-color --progress-bar off "${from[@]}" "$@"
  fi
}

# Debian's matplotlib, if it is installed, puts its mpl_toolkits before the ones in build/venv,
# and they do not fit our matplotlib. This line, which site runs, puts ours first.
OWN_TOOLKITS="import os, sys, types; \
sys.modules.setdefault('mpl_toolkits', types.ModuleType('mpl_toolkits')).__dict__\
.setdefault('__path__', []).append(os.path.join(sys._getframe(1).f_locals['sitedir'], 'mpl_toolkits'))"

put_own_toolkits_first() {
  local site
  site=$("$LAB_VENV/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
  echo "$OWN_TOOLKITS" >"$site/mpl_toolkits.pth"
}

# ROS's modules are in the system's packages. An old pip does not know newer kinds of wheels.
create_venv() {
  rm -rf "$LAB_VENV"
  if get_uv; then
    "$UV" --no-config venv --quiet --system-site-packages --python /usr/bin/python3 "$LAB_VENV"
  else
    /usr/bin/python3 -m venv --system-site-packages "$LAB_VENV" && python_install 'pip>=21'
  fi && python_install --require-hashes -r "$LAB_ROOT/requirements.lock" && put_own_toolkits_first
}

step_python() {
  local title=$1 log=$2 part=$3
  unset PYTHONPATH PYTHONHOME
  export PYTHONNOUSERSITE=1
  if [[ $part == base ]]; then
    run_quietly "$title" "$log" create_venv
  else
    run_quietly "$title" "$log" \
      python_install --require-hashes -r "$LAB_ROOT/requirements-$part.lock"
  fi
}

# The newest versions that all supported Pythons on Linux can have, with their hashes.
renew_lock() {
  local part lists=(requirements requirements-test requirements-browser)
  get_uv
  for part in "${lists[@]}"; do
    (
      cd "$LAB_ROOT"
      UV_SYSTEM_CERTS=1 "$UV" pip compile --quiet --upgrade --universal --python-version 3.8 \
        --generate-hashes --no-header --no-annotate -c constraints.txt "$part.txt" -o "$part.lock"
    )
  done
}

# ---- The catkin workspace ----

make_workspace() (
  use_lab_python
  if [[ $LAB_ROS != /usr ]]; then
    source_setup_file "$LAB_ROS/setup.bash"
  fi
  /usr/bin/python3 "$LAB_ROOT/scripts/setup/workspace.py" "$LAB_WS" "$LAB_ROS" \
    "$LAB_VENV/bin/python"
)

# Without the user's Python and other workspaces: catkin would store them in the build.
build_workspace() (
  unset CMAKE_PREFIX_PATH ROS_PACKAGE_PATH
  use_lab_python
  # Python, and C++ for nodes of overlay.sh; messages for three other languages take time.
  export ROS_LANG_DISABLE=geneus:genlisp:gennodejs
  PATH=$LAB_VENV/bin:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
  if [[ $LAB_ROS != /usr ]]; then
    source_setup_file "$LAB_ROS/setup.bash"
  fi
  "$LAB_ROS/bin/catkin_make" -C "$LAB_WS" \
    -DPYTHON_EXECUTABLE="$LAB_VENV/bin/python" -DCATKIN_ENABLE_TESTING=OFF
)

# The files of the package, without build/ and results/.
package_entries() { ls --ignore=build --ignore=results "$LAB_ROOT"; }

# Links the entries of the package one by one: through a link to the whole package, rosrun would
# follow build/ into this workspace again and again.
link_package() {
  local entry
  rm -rf "$1"
  mkdir -p "$1"
  for entry in $(package_entries); do
    ln -s "$LAB_ROOT/$entry" "$1/"
  done
}

# Launch files for Gazebo name its packages: stand-ins are built for those that are missing.
stand_ins() {
  local folder name
  for folder in "$LAB_ROOT"/stand_ins/*/; do
    name=${folder%/} name=${name##*/}
    [[ -e $LAB_ROS/share/$name/package.xml ]] || echo "$name"
  done
}

# link_packages FOLDER: make links to this package, and to stand-ins for what ROS has not.
link_packages() {
  local name
  link_package "$1/bullet_lab"
  find "$1" -maxdepth 1 -lname "*/stand_ins/*" -delete
  for name in $(stand_ins); do
    ln -s "$LAB_ROOT/stand_ins/$name" "$1/$name"
  done
}

# old_names WORKSPACE: nodes under their names of before Noetic.
old_names() {
  local folder=lib/robot_state_publisher name
  mkdir -p "$1/devel/$folder"
  # roslaunch looks no further once it has found such a folder.
  for name in robot_state_publisher state_publisher; do
    ln -sfn "$LAB_ROS/$folder/robot_state_publisher" "$1/devel/$folder/$name"
  done
}

step_build() {
  link_packages "$LAB_WS/src"
  run_quietly "$1" "$2" make_workspace
  old_names "$LAB_WS"
}

# The same workspace, by catkin_make, for tests of CMakeLists.txt and for those who extend it.
step_catkin() {
  LAB_WS=$LAB_DIR/catkin
  link_packages "$LAB_WS/src"
  # A build from before the clone was moved cannot be used.
  if ! grep -qsxF "CMAKE_HOME_DIRECTORY:INTERNAL=$LAB_WS/src" "$LAB_WS/build/CMakeCache.txt"; then
    rm -rf "$LAB_WS/build" "$LAB_WS/devel"
  fi
  run_quietly "$1" "$2" build_workspace
  old_names "$LAB_WS"
}

# ---- Rooms without internet ----

# download DIR: everything that a bare machine with this Debian needs, with all tests.
download() {
  local folder part packages=()
  mkdir -p "$1"/{debs/partial,lists/partial,wheels}
  folder=$(realpath "$1")
  become_root "the list of packages"
  apt_get update
  # Debian's pip downloads the wheels.
  read -r -d '' -a packages < <(debian_packages first) || true
  mapfile -t packages < <(missing_of "${packages[@]}")
  ((!${#packages[@]})) || apt_get install --no-install-recommends "${packages[@]}"
  rm -rf "$folder/apt"
  cp -r /etc/apt "$folder/apt"
  cp /var/lib/apt/lists/*_{Packages,InRelease}* "$folder/lists/"
  # As on a machine that has nothing, and part by part: what apt chooses depends on the others.
  : >"$folder/none"
  for part in first base more rviz test course; do
    mapfile -t packages < <(debian_packages "$part" | xargs -n 1 | sort -u)
    apt-get -y --download-only --no-install-recommends -o Dir::State::status="$folder/none" \
      -o Dir::Cache::archives="$folder/debs" -o Debug::NoLocking=1 install "${packages[@]}"
  done
  debians_pip download --only-binary :all: --dest "$folder/wheels" uv
  for part in "" -test; do
    debians_pip download --only-binary :all: --no-deps --require-hashes --dest "$folder/wheels" \
      -r "$LAB_ROOT/requirements$part.lock"
  done
  say "$folder: $(du -sh "$folder" | cut -f 1); on the other machines: scripts/setup.sh --offline DIR"
}

remove() {
  local packages=()
  mapfile -t packages < <(sort -u "$LAB_DIR/installed" 2>/dev/null)
  rm -rf "$LAB_DIR"
  say "build/ is deleted"
  ((${#packages[@]} == 0)) \
    || say "Debian packages that were installed for it: sudo apt-get autoremove ${packages[*]}"
}

# ---- Main ----

# What would fail after minutes.
look_ahead() {
  local free
  if ! getent hosts localhost >/dev/null; then
    fail "ROS needs the name localhost: add the line '127.0.0.1 localhost' to /etc/hosts"
  fi
  free=$(df --output=avail -BM "$LAB_DIR" | tr -dc '0-9')
  ((free > LEAST_MEGABYTES)) \
    || fail "$LAB_DIR: $free MB are free; $LEAST_MEGABYTES MB are needed, and as much in /usr"
  if [[ -z $OFFLINE ]] && ! grep -hqv '^Iface\|^lo\| lo$' /proc/net/{route,ipv6_route}; then
    fail "there is no network; without one: scripts/setup.sh --offline DIR"
  fi
}

take_step() {
  local step=$1 number=$2 of=$3 start=$SECONDS title log
  title="[$number/$of] $(describe "$step")"
  log=$LAB_DIR/log/$step.log
  : >"$log"
  say "$title"
  case $step in
    build | catkin) "step_$step" "$title" "$log" ;;
    *) "step_${step%-*}" "$title" "$log" "${step#*-}" ;;
  esac
  mark_done "$step"
  say "$title: done, $((SECONDS - start)) s$(download_in "$log")"
}

# open_steps STEP…: print the steps that are not done yet.
open_steps() {
  local step
  for step in "$@"; do
    is_done "$step" || echo "$step"
  done
}

steps_of() {
  printf '%s\n' debian-first debian-base python-base
  case ${1-} in
    --least) echo build ;;
    --no-build) printf '%s\n' debian-catkin debian-more ;;
    *) printf '%s\n' build debian-more ;;
  esac
  [[ ${1-} != --least && ${1-} != --no-build ]] || shift
  while (($#)); do
    case "$1 ${2-}" in
      "--with rviz") echo debian-rviz ;;
      "--with test") printf '%s\n' debian-test python-test ;;
      "--with course") echo debian-course ;;
      "--with browser") printf '%s\n' debian-browser python-browser ;;
      "--with catkin") printf '%s\n' debian-catkin catkin ;;
      *) fail "unknown argument '$*'; usage: setup.sh [--least | --no-build] [--with rviz|test|course|browser|catkin] …" ;;
    esac
    shift 2
  done
}

# Only the owner of a clone can set it up.
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
  local wanted steps i beside=''
  case ${1-} in
    --renew-lock | --remove | --download)
      take_lock
      wanted=${1#--}
      "${wanted//-/_}" "${@:2}"
      return
      ;;
    --offline)
      OFFLINE=$(realpath -e "${2:?a folder that --download has made}")
      shift 2
      ;;
  esac
  wanted=$(steps_of "$@") || exit 2
  # shellcheck disable=SC2086
  [[ -n $(open_steps $wanted) ]] || return 0
  if [[ $LAB_ROOT =~ [[:space:]] ]]; then
    fail "catkin cannot build in a folder with a space in its name: $LAB_ROOT"
  fi
  take_lock "$@"
  look_ahead
  [[ -x $LAB_VENV/bin/python ]] || say "a new machine needs a minute or two"
  # shellcheck disable=SC2086
  mapfile -t steps < <(open_steps $wanted)
  for i in "${!steps[@]}"; do
    if [[ ${steps[i]} == debian-base && ${steps[i + 1]-} == python-base ]]; then
      # PyPI's packages come while Debian's are unpacked.
      take_step python-base $((i + 2)) ${#steps[@]} 2>"$LAB_DIR/log/beside.log" &
      beside=$!
    fi
    if [[ ${steps[i]} == python-base && -n $beside ]]; then
      wait "$beside" || fail "$(<"$LAB_DIR/log/beside.log")"
      tail -n 1 "$LAB_DIR/log/beside.log" >&2
    else
      take_step "${steps[i]}" $((i + 1)) ${#steps[@]}
    fi
  done
  # PyPI's xacro needs ROS 2, and would hide the one that works.
  rm -f "$LAB_VENV/bin/xacro"
}

# platform.sh sources this file for single steps.
[[ ${BASH_SOURCE[0]} != "$0" ]] || main "$@"
