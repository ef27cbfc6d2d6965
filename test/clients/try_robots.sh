#!/usr/bin/env bash
# Tries other people's robots and worlds, as they are: what docs/clients.md tells of.
#
# Usage: test/clients/try_robots.sh FOLDER COPIES [CASE …]
#
# COPIES holds the repositories turtlebot3, turtlebot3_simulations, husky and mir_robot, each at
# its branch for Noetic; what is not there is left out. Each case is a run of the job robot on a
# launch file, whose results are in a folder of its own. Packages that Husky's description includes
# for what is not mounted by default are stood in for by empty files. No part of the tests: it takes
# some minutes. Needs scripts/setup.sh first.
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/../../scripts/environment.sh"

# Of packages that Husky includes and does not use.
EMPTY=(fath_pivot_mount_description/urdf/lockmount.urdf.xacro
  flir_camera_description/urdf/flir_blackflys.urdf.xacro lms1xx/urdf/sick_lms1xx.urdf.xacro
  velodyne_description/urdf/VLP-16.urdf.xacro)

stand_in_for_missing() {
  local file package folder
  for file in "${EMPTY[@]}"; do
    package=${file%%/*} folder=$OUT/stand_ins/${file%%/*}
    rospack find "$package" >/dev/null 2>&1 && continue
    mkdir -p "$OUT/stand_ins/$(dirname "$file")"
    echo "<robot name=\"$package\"/>" >"$OUT/stand_ins/$file"
    echo "<package><name>$package</name></package>" >"$folder/package.xml"
    echo "an empty file stands in for $file"
  done
}

# NAME LAUNCH_FILE [word …]
cases() {
  local model world folder=turtlebot3_simulations/turtlebot3_gazebo/launch place
  for world in empty_world world house stage_1 stage_2 stage_3 stage_4; do
    place=""
    # Where it is put by default, a wall is 0.8 m ahead.
    [[ $world != stage_4 ]] || place="x_pos:=-1.8 y_pos:=1.0"
    for model in burger waffle waffle_pi; do
      echo "${model}_$world $folder/turtlebot3_$world.launch model:=$model $place"
    done
  done
  echo "husky_empty husky/husky_gazebo/launch/empty_world.launch"
  echo "mir_empty mir_robot/mir_gazebo/launch/mir_empty_world.launch"
}

# verdict SUMMARY: one line, and whether it is as it should be.
verdict() {
  python - "$1" <<'PYTHON'
import json
import sys

MOST_PERCENT = 2.0
# Their wheels slip as they turn: docs/contact_model.md says by how much.
SLIPPING_PERCENT = {"husky": 10.0}


def percent(leg):
    error = leg["odometry_error_percent"]
    return "?" if error is None else f"{error:.2f} %"


summary = json.load(open(sys.argv[1]))
metre, turn = (summary["drive"].get(leg, {}) for leg in ("metre", "turn"))
wrong = [f"silent: {' '.join(summary['silent'])}"] if summary["silent"] else []
wrong += [f"off their rate: {' '.join(summary['off_rate'])}"] if summary["off_rate"] else []
for name, leg in (("metre", metre), ("turn", turn)):
    error = leg.get("odometry_error_percent")
    slipping = SLIPPING_PERCENT.get(summary["robot"]["name"], MOST_PERCENT)
    if not leg.get("moved"):
        wrong.append(f"{name}: did not move")
    elif error is None or error > (slipping if name == "turn" else MOST_PERCENT):
        wrong.append(f"{name}: odometry off by {error} %")
if summary["tilt_deg"] > 5.0:
    wrong.append(f"tilted by {summary['tilt_deg']:.0f} deg")
images = {t: c["messages"] for t, c in summary["topics"].items() if c["type"] == "sensor_msgs/Image"}
wrong += [f"no picture on {topic}" for topic, count in images.items() if not count]
if metre and turn:
    print(
        f"{metre['truth']['ahead_m']:.3f} m, turned by {metre['truth']['turned_deg']:+.2f} deg, "
        f"odometry {percent(metre)} off; turn {turn['truth']['turned_deg']:.1f} "
        f"deg, odometry {percent(turn)} off; {len(images)} cameras; "
        f"{len(summary['topics'])} topics; left out: {', '.join(summary['left_out']) or 'nothing'}"
    )
print("; ".join(wrong) or "ok")
sys.exit(bool(wrong))
PYTHON
}

try() {
  local name=$1 file=$2 out=$OUT/$1
  shift 2
  if [[ ! -e $COPIES/$file ]]; then
    echo "$name: left out, there is no $file"
  elif ! timeout --signal=INT 300 "$LAB_ROOT/scripts/run.sh" robot urdf:="$COPIES/$file" \
    args:="$*" out:="$out" >"$out.log" 2>&1 </dev/null; then
    echo "$name: FAILED, see $out.log: $(grep -v '^ ' "$out.log" | tail -n 1)"
    FAILED=$((FAILED + 1))
  else
    verdict "$out/summary.json" >"$out.verdict" || FAILED=$((FAILED + 1))
    echo "$name: $(tr '\n' ' ' <"$out.verdict")"
  fi
}

main() {
  local name words
  OUT=$(mkdir -p "$1" && cd "$1" && pwd) COPIES=$(cd "$2" && pwd) FAILED=0
  shift 2
  enter_lab
  set +u
  export ROS_PACKAGE_PATH=$ROS_PACKAGE_PATH:$COPIES:$OUT/stand_ins
  # Its launch files want it even where an argument names the model.
  export TURTLEBOT3_MODEL=burger
  stand_in_for_missing
  while read -r name words; do
    if ((!$#)) || [[ " $* " == *" $name "* ]]; then
      # shellcheck disable=SC2086
      try "$name" $words
    fi
  done < <(cases)
  echo "$FAILED failed"
  ((!FAILED))
}

: "${2:?usage: try_robots.sh FOLDER COPIES [CASE …]}"
main "$@"
