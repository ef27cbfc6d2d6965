"""Measures what a relay between a driver in lock step and the bridge costs; scripts/bench.sh relay.

Drives squares as fast as it goes, with the commands on cmd_vel and through a relay by turns, and
prints the medians of the wall times.
--rounds N. --sides N: of squares, in each drive.
"""

from __future__ import annotations

import statistics
import subprocess
import time
from pathlib import Path

from common import Bridge, options, start_ros, write
from lab_nodes import Node, end_all

# A run through a relay may take so many times as long as one without.
ASKED = 1.5
# Debian's topic_tools is no package for rosrun.
PLACES = ("/usr/lib/topic_tools/relay", "/opt/ros/noetic/lib/topic_tools/relay")


def relay() -> subprocess.Popen:
    """Start a relay from wish to cmd_vel."""
    found = [place for place in PLACES if Path(place).exists()]
    if not found:
        raise SystemExit("topic_tools is not installed")
    return subprocess.Popen([found[0], "wish", "cmd_vel"], stdout=subprocess.DEVNULL)


def seconds(sides: int, relayed: bool) -> float:
    """Return the wall time of a drive along so many sides of squares."""
    robot = "_robot:=package://bullet_lab/urdf/block_robot.urdf"
    bridge = Bridge(robot, "_rtf:=0", "_lock_step:=drive_squares")
    helper = relay() if relayed else None
    start = time.perf_counter()
    topic = f"_cmd_vel:={'wish' if relayed else 'cmd_vel'}"
    driver = Node("drive_squares", f"_sides:={sides}", "_lock_step:=true", topic)
    status = driver.process.wait()
    taken = time.perf_counter() - start
    if helper:
        helper.kill()
    end_all(bridge)
    if status:
        raise SystemExit(f"drive_squares ended with status {status}")
    return taken


def main() -> None:
    """Measure, print and write."""
    wanted = options(__doc__, rounds=5, sides=40)
    start_ros(sim_time=True)
    direct, relayed = [], []
    for _ in range(wanted.rounds):
        direct.append(seconds(wanted.sides, False))
        relayed.append(seconds(wanted.sides, True))
    without, through = statistics.median(direct), statistics.median(relayed)
    print(f"{wanted.sides} sides in {without:.2f} s, {through:.2f} s through a relay")
    print(f"times as long: {through / without:.2f} (asked: <= {ASKED:g})")
    write(wanted.out, {"direct_s": direct, "relayed_s": relayed})


if __name__ == "__main__":
    main()
