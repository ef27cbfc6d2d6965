# Sourced by the other scripts: paths, and functions that enter the lab's environment.
# shellcheck shell=bash disable=SC2034 # not all of them use all of it

# The workspace has a link to this folder; `cd -P` resolves it.
LAB_ROOT=$(cd -P "$(dirname "${BASH_SOURCE[0]}")" && cd .. && pwd)
# rosrun searches packages for executables, but not in build/.
LAB_DIR=$LAB_ROOT/build
LAB_VENV=$LAB_DIR/venv
LAB_WS=$LAB_DIR/ws
LAB_COURSE=$LAB_DIR/course
if [[ -e /opt/ros/noetic/setup.bash ]]; then
  LAB_ROS=/opt/ros/noetic
else
  LAB_ROS=/usr
fi

# ROS works only with the system's Python: removes another Python from PATH, PYTHONPATH and
# the user's site-packages.
use_lab_python() {
  unset PYTHONPATH PYTHONHOME
  export PYTHONNOUSERSITE=1
  PATH=$LAB_VENV/bin:$PATH
}

# The setup files of catkin read variables that may be unset.
source_setup_file() {
  # They write a temporary file, which stays if they are killed. The folder may be read-only.
  [[ ! -w $LAB_DIR ]] || local TMPDIR=$LAB_DIR
  set +u
  # shellcheck disable=SC1090
  source "$1"
  set -u
}

# Enter the built workspace and the virtual environment.
enter_lab() {
  local given_master=${ROS_MASTER_URI-} given_packages=${ROS_PACKAGE_PATH-}
  local workspace=$LAB_WS
  # The user has entered the packages of overlay.sh.
  [[ ${CMAKE_PREFIX_PATH-} != *"$LAB_DIR/overlay/devel"* ]] || workspace=$LAB_DIR/overlay
  use_lab_python
  source_setup_file "$workspace/devel/setup.bash"
  # They drop other folders from ROS_PACKAGE_PATH.
  if [[ -n $given_packages && $given_packages != "$ROS_PACKAGE_PATH" ]]; then
    export ROS_PACKAGE_PATH=$ROS_PACKAGE_PATH:$given_packages
  fi
  PATH=$LAB_VENV/bin:$PATH
  # With several threads, the last bit of a sum depends on the number of cores, and small
  # matrices take longer.
  export OPENBLAS_NUM_THREADS=${OPENBLAS_NUM_THREADS:-1}
  # catkin's files set a default, which would look like the user's choice.
  if [[ -z $given_master ]]; then
    unset ROS_MASTER_URI
  fi
}
