"""Measures what a relay between a driver in lock step and the bridge costs; see scripts/bench.sh.

Drives squares as fast as it goes, with the commands on cmd_vel and through a relay by turns, and
prints the medians of the wall times. Starts a ROS master of its own.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import time
from pathlib import Path
from typing import List

import rospy

from bullet_lab.ros.launcher.supervision import prepare_master

# A run through a relay may take so many times as long as one without.
ASKED = 1.5
RUN = ("rosrun", "bullet_lab")
BRIDGE = (
    *RUN,
    "pybullet_bridge.py",
    "_robot:=package://bullet_lab/urdf/block_robot.urdf",
    "_rtf:=0",
    "_lock_step:=drive_squares",
)
# Debian's topic_tools is no package for rosrun.
PLACES = ("/usr/lib/topic_tools/relay", "/opt/ros/noetic/lib/topic_tools/relay")


def relay() -> List[str]:
    """Return the command of a relay from wish to cmd_vel."""
    for place in PLACES:
        if Path(place).exists():
            return [place, "wish", "cmd_vel"]
    raise SystemExit("topic_tools is not installed")


def seconds(sides: int, relayed: bool) -> float:
    """Return the wall time of a drive along so many sides of squares."""
    programs = (BRIDGE, relay()) if relayed else (BRIDGE,)
    helpers = [subprocess.Popen(words, stdout=subprocess.DEVNULL) for words in programs]
    try:
        rospy.wait_for_service("/bullet_lab/advance", 60.0)
        driver = [*RUN, "drive_squares.py", f"_sides:={sides}", "_lock_step:=true"]
        start = time.perf_counter()
        driver.append(f"_cmd_vel:={'wish' if relayed else 'cmd_vel'}")
        subprocess.run(driver, check=True, stdout=subprocess.DEVNULL)
        return time.perf_counter() - start
    finally:
        for helper in reversed(helpers):
            helper.terminate()
            helper.wait(20.0)


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="JSON file to write")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--sides", type=int, default=40)
    wanted = parser.parse_args()
    prepare_master()
    rospy.init_node("bench", disable_signals=True)
    rospy.set_param("/use_sim_time", True)
    direct: List[float] = []
    relayed: List[float] = []
    for _ in range(wanted.rounds):
        direct.append(seconds(wanted.sides, False))
        relayed.append(seconds(wanted.sides, True))
    without, through = statistics.median(direct), statistics.median(relayed)
    print(f"{wanted.sides} sides in {without:.2f} s, {through:.2f} s through a relay")
    print(f"times as long: {through / without:.2f} (asked: <= {ASKED:g})")
    wanted.out.parent.mkdir(parents=True, exist_ok=True)
    wanted.out.write_text(json.dumps({"direct_s": direct, "relayed_s": relayed}, indent=2) + "\n")


if __name__ == "__main__":
    main()
