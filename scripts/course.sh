# Source this file to run unchanged scripts and launch files of a course on ROS and Gazebo:
#
#   source scripts/course.sh
#
# It provides `python3` and `python` as Debian's Python, with the libraries that such scripts import
# (tf, an OpenCV with windows and the old marker functions, matplotlib), this workspace, whose
# nodes use their own Python, and a `xacro` that works. It installs what is missing.
# shellcheck shell=bash

# A function, so that only the environment of the calling shell changes.
_lab_course() {
  local scripts root folder word words=() packages=${ROS_PACKAGE_PATH-} workspace=ws
  scripts=$(cd -P "$(dirname "${BASH_SOURCE[0]}")" && pwd) || return
  root=$(dirname "$scripts")
  words=(--with course)
  # Packages that scripts/overlay.sh has built on top of a build by catkin.
  if [[ -e $root/build/overlay/devel/setup.bash ]]; then
    workspace=overlay
    words+=(--with catkin)
  fi
  "$scripts/setup.sh" "${words[@]}" || return
  # Debian's Python cannot import modules of another Python.
  unset PYTHONPATH PYTHONHOME
  # shellcheck disable=SC1090,SC1091
  source "$root/build/$workspace/devel/setup.bash" || return
  [[ -z $packages || $packages == "$ROS_PACKAGE_PATH" ]] || ROS_PACKAGE_PATH+=:$packages
  # Before any virtual environment, which may have another OpenCV.
  folder=$root/build/course
  IFS=: read -r -a words <<<"$PATH"
  PATH=$folder:$root/build/ws/devel/bin
  for word in "${words[@]}"; do
    [[ :$PATH: == *":$word:"* ]] || PATH=$PATH:$word
  done
  # It restores names that OpenCV has removed since Noetic.
  export PYTHONPATH=$root/config/course${PYTHONPATH:+:$PYTHONPATH}
  hash -r
}

_lab_course
