# Sourced by whoever runs scripts and launch files of a course on ROS and Gazebo, as they are:
#
#   source scripts/course.sh
#
# Debian's Python with what such scripts import (tf, an OpenCV with windows and the old calls for
# markers, matplotlib), as `python3` and as `python`; this workspace, whose launch files and nodes
# bring their own Python along; a `xacro` that works. Installs what is missing.
# shellcheck shell=bash

# In a shell that is somebody else's, nothing is left behind but the environment.
_lab_course() {
  local scripts root folder word words=() packages=${ROS_PACKAGE_PATH-}
  scripts=$(cd -P "$(dirname "${BASH_SOURCE[0]}")" && pwd) || return
  "$scripts/setup.sh" --with course || return
  root=$(dirname "$scripts")
  # What another Python is told to import, Debian's could not.
  unset PYTHONPATH PYTHONHOME
  # shellcheck disable=SC1091
  source "$root/build/ws/devel/setup.bash" || return
  [[ -z $packages || $packages == "$ROS_PACKAGE_PATH" ]] || ROS_PACKAGE_PATH+=:$packages
  # A virtual environment of the lab, or of anybody, has an OpenCV of its own.
  folder=$root/build/course
  IFS=: read -r -a words <<<"$PATH"
  PATH=$folder:$root/build/ws/devel/bin
  for word in "${words[@]}"; do
    [[ :$PATH: == *":$word:"* ]] || PATH=$PATH:$word
  done
  # Names that OpenCV has lost since Noetic's.
  export PYTHONPATH=$root/config/course${PYTHONPATH:+:$PYTHONPATH}
  hash -r
}

_lab_course
