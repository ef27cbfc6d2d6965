#!/usr/bin/env bash
# Tries other people's programs, as they are, against the bridge: what docs/clients.md tells of.
#
# Usage: test/clients/try_clients.sh FOLDER [command_line|transforms|depth|teleop|bags|images|evo …]
#
# No part of the tests: it takes some minutes, and it wants these Debian packages, of which it
# names those that are missing: see PACKAGES. evo is taken from the virtual environment that EVO
# names, teleop_twist_keyboard from the script that TELEOP names; what is not named is left out.
# The folder gets a log of each client. Needs scripts/setup.sh first.
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/../../scripts/environment.sh"

# Debian has the descriptions of nodelets in the packages for developers.
PACKAGES=(ros-image-view image-transport-tools ros-image-proc libimage-proc-dev
  libdepth-image-proc-dev libnodeletlib-tools tf2-tools tf-tools topic-tools python3-rosbag
  pcl-ros-tools python3-roswtf ros-opencv-apps libopencv-apps-dev graphviz xvfb x11-apps)
BRIDGE=""
MASTER=""
SCREEN=""
FAILED=0

missing_packages() {
  local name
  for name in "${PACKAGES[@]}"; do
    dpkg-query -W -f '${Status}' "$name" 2>/dev/null | grep -q 'ok installed' || echo "$name"
  done
}

# check NAME PATTERN COMMAND…: the command's output has to match the pattern.
check() {
  local name=$1 pattern=$2 log=$OUT/$1.log found
  shift 2
  "$@" >"$log" 2>&1 </dev/null || true
  if found=$(grep -m 1 -E -- "$pattern" "$log"); then
    echo "$name: ok: $(tr -s '[:space:]' ' ' <<<"$found")"
  else
    echo "$name: FAILED, see $log"
    FAILED=$((FAILED + 1))
  fi
}

# for_a_while SECONDS COMMAND…: stopped by Ctrl-C, as a user would.
for_a_while() {
  local seconds=$1
  shift
  timeout --signal=INT --kill-after=5 "$seconds" "$@"
}

# in_background SECONDS COMMAND…
in_background() { for_a_while "$@" >"$OUT/background.log" 2>&1 </dev/null & }

start_master() {
  local port=$((20000 + RANDOM % 20000))
  export ROS_MASTER_URI=http://127.0.0.1:$port ROS_IP=127.0.0.1
  roscore -p "$port" >"$OUT/roscore.log" 2>&1 &
  MASTER=$!
  until rostopic list >/dev/null 2>&1; do sleep 0.2; done
}

end_process() {
  if [[ -n $1 ]]; then
    kill -INT "$1" 2>/dev/null || true
    wait "$1" 2>/dev/null || true
  fi
}

stop_master() {
  end_process "$BRIDGE"
  end_process "$MASTER"
  BRIDGE="" MASTER=""
}

stop() {
  stop_master
  end_process "$SCREEN"
}

# bridge WORLD ROBOT: in real time, with robot_state_publisher.
bridge() {
  local include=$LAB_ROOT/launch/include/bridge.launch.xml
  start_master
  roslaunch "$include" world:="$LAB_ROOT/worlds/$1.world" robot:="$LAB_ROOT/urdf/$2.urdf" \
    >"$OUT/bridge_$2.log" 2>&1 &
  BRIDGE=$!
  until rostopic list 2>/dev/null | grep -q '^/odom$'; do sleep 0.5; done
  rostopic echo -n 1 /odom >/dev/null
}

try_command_line() {
  check rostopic_hz 'average rate: (19\.9|20\.0)' for_a_while 9 rostopic hz /odom
  check rostopic_hz_scan 'average rate: (9\.9|10\.0)' for_a_while 9 rostopic hz /scan
  check rostopic_echo 'frame_id: "bumper_link"' rostopic echo -n 1 /bumper
  check rosservice_state 'success: True' \
    rosservice call /gazebo/get_model_state "{model_name: crate}"
  check rosservice_spawn 'success: True' rosservice call /gazebo/spawn_sdf_model \
    "{model_name: b, model_xml: '<sdf version=\"1.6\"><include><uri>model://beacon</uri></include></sdf>', initial_pose: {position: {x: -2.0}}}"
  check rosservice_delete 'success: True' rosservice call /gazebo/delete_model "{model_name: b}"
  check rosnode 'Publications' rosnode info /pybullet_bridge
  check roswtf 'No errors or warnings|Found [0-9]+ (error|warning)' roswtf
  check topic_tools_throttle 'average rate: (4\.|5\.0)' throttled_rate
}

throttled_rate() {
  in_background 14 rosrun topic_tools throttle messages /odom 5.0 /odom_slow
  sleep 3
  for_a_while 8 rostopic hz /odom_slow
}

try_transforms() {
  check tf_echo 'Translation: \[0\.000, 0\.000, 0\.125\]' for_a_while 5 \
    rosrun tf tf_echo odom laser_link
  check tf2_echo 'Translation|translation' for_a_while 5 rosrun tf2_tools echo.py odom laser_link
  check tf_monitor 'Frame: laser_link' for_a_while 6 rosrun tf tf_monitor
  (cd "$OUT" && check tf2_view_frames 'Generating|frames' for_a_while 20 \
    rosrun tf2_tools view_frames.py)
}

# A terminal of its own, in which the keys are pressed.
press_keys() {
  local before after
  before=$(rostopic echo -n 1 -p /odom/pose/pose/position/x | tail -n 1)
  (
    sleep 3
    for _ in $(seq 10); do
      printf i
      sleep 0.2
    done
    printf k
    sleep 1
    printf '\003'
  ) | ROS_PACKAGE_PATH=$(dirname "$TELEOP"):$ROS_PACKAGE_PATH \
    script -qec "python3 $TELEOP" /dev/null
  after=$(rostopic echo -n 1 -p /odom/pose/pose/position/x | tail -n 1)
  echo "x before: $before"
  echo "x after: $after"
  python3 -c "print('moved by', float('${after##*,}') - float('${before##*,}'), 'm')"
}

try_teleop() {
  [[ -n ${TELEOP-} ]] || return 0
  check teleop_twist_keyboard 'moved by [0-9]\.[0-9]+ m' press_keys
}

try_bags() {
  local bag=$OUT/drive.bag
  rm -f "$bag"
  in_background 12 rostopic pub -r 10 /cmd_vel geometry_msgs/Twist \
    '{linear: {x: 0.2}, angular: {z: 0.3}}'
  for_a_while 10 rosbag record --quiet -O "$bag" /odom /tf /tf_static /scan /imu /clock \
    >"$OUT/record.log" 2>&1 || true
  check rosbag_info '/odom +[0-9]+ msgs' rosbag info "$bag"
  stop_master
  start_master
  check rosbag_play 'average rate: (19\.|20\.)' play_bag
}

play_bag() {
  in_background 14 rosbag play --clock "$OUT/drive.bag"
  for_a_while 8 rostopic hz /odom
}

try_evo() {
  [[ -n ${EVO-} ]] || return 0
  local drive=$OUT/drive.bag results=$OUT/results
  "$LAB_ROOT/scripts/run.sh" squares out:="$results" >"$OUT/squares.log" 2>&1
  check evo_traj_bag 'infos|path length|poses' "$EVO/bin/evo_traj" bag "$drive" /odom --full_check
  check evo_traj_tum 'path length \(m\)' "$EVO/bin/evo_traj" tum "$results/odom.tum" \
    --ref "$results/noisy_odom.tum" --full_check
  check evo_ape 'rmse' "$EVO/bin/evo_ape" tum "$results/odom.tum" "$results/noisy_odom.tum"
  check evo_rpe 'rmse' "$EVO/bin/evo_rpe" tum "$results/odom.tum" "$results/noisy_odom.tum" \
    --delta 1 --delta_unit m
  grep -h -E '^ *rmse' "$OUT/evo_ape.log" | head -n 1
  grep -E '"ape_rmse_m"' "$results/summary.json"
}

try_images() {
  check list_transports 'image_transport/raw' rosrun image_transport list_transports
  (cd "$OUT" && check image_saver 'Saved image' saved_image)
  check image_view 'pixels of a window' view_image
  (cd "$OUT" && check extract_images 'Saved image' for_a_while 6 \
    rosrun image_view extract_images image:=/mycamera/image_raw _sec_per_frame:=0.5)
  ROS_NAMESPACE=mycamera in_background 18 rosrun image_proc image_proc
  sleep 4
  check image_proc 'average rate' for_a_while 8 rostopic hz /mycamera/image_rect_color
  in_background 14 rosrun nodelet nodelet standalone opencv_apps/edge_detection \
    __name:=edge_detection image:=/mycamera/image_raw _debug_view:=false
  sleep 4
  check opencv_apps 'average rate' for_a_while 8 rostopic hz /edge_detection/image
}

saved_image() {
  for_a_while 6 rosrun image_view image_saver image:=/mycamera/image_raw \
    _filename_format:=saved%04d.png
}

view_image() {
  in_background 12 rosrun image_view image_view image:=/mycamera/image_raw _autosize:=true
  sleep 7
  xwd -root -display "$DISPLAY" >"$OUT/image_view.xwd"
  python3 - "$OUT/image_view.xwd" <<'PYTHON'
import sys

data = open(sys.argv[1], "rb").read()
print(len(set(data[-1_000_000:])), "grey levels")
if len(set(data)) > 50:
    print("pixels of a window")
PYTHON
}

try_depth() {
  in_background 25 rosrun nodelet nodelet standalone depth_image_proc/point_cloud_xyz \
    image_rect:=/camera/depth/image_raw camera_info:=/camera/depth/camera_info points:=/my_points
  sleep 5
  check depth_image_proc 'average rate' for_a_while 10 rostopic hz /my_points
  (cd "$OUT" && check pointcloud_to_pcd 'Received [0-9]+ data points' for_a_while 6 \
    rosrun pcl_ros pointcloud_to_pcd input:=/camera/depth/points)
}

# for_group NAME FUNCTION: where the user has named that group, or none.
for_group() {
  if ((!${#WANTED[@]})) || [[ " ${WANTED[*]} " == *" $1 "* ]]; then
    "$2"
  fi
}

main() {
  local missing
  OUT=$(mkdir -p "$1" && cd "$1" && pwd)
  WANTED=("${@:2}")
  mapfile -t missing < <(missing_packages)
  if ((${#missing[@]})); then
    echo "try_clients.sh: to be installed: ${missing[*]}" >&2
    exit 1
  fi
  enter_lab
  set +u
  trap stop EXIT
  Xvfb :97 -screen 0 1024x768x24 -nolisten tcp >"$OUT/xvfb.log" 2>&1 &
  SCREEN=$!
  export DISPLAY=:97 LIBGL_ALWAYS_SOFTWARE=1
  bridge sensors sensor_robot
  for_group command_line try_command_line
  for_group transforms try_transforms
  for_group depth try_depth
  for_group teleop try_teleop
  for_group bags try_bags
  stop_master
  bridge docking camera_robot
  for_group images try_images
  stop_master
  unset ROS_MASTER_URI
  for_group evo try_evo
  echo "$FAILED failed"
  ((!FAILED))
}

: "${1:?usage: try_clients.sh FOLDER [GROUP …]}"
main "$@"
