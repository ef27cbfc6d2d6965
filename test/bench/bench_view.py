"""Measures what the view in a browser costs; run it with scripts/bench.sh view.

Robots with odometry drive in circles at real time, and the view sends 30 pictures a second to
somebody who speaks viser's protocol and draws nothing. The processor time is the view's own: with
nobody there, with somebody, and with one more robot's camera image of 10 Hz. Prints a table and
writes JSON. Starts a ROS master of its own.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Dict, List, Sequence

import psutil
import rospkg
import rospy
from geometry_msgs.msg import Point, Pose, Quaternion, Twist, Vector3

from bullet_lab.ros.launcher.supervision import prepare_master
from bullet_lab.ros.messages.gazebo_types import srv

PACKAGE = Path(rospkg.RosPack().get_path("bullet_lab"))
sys.path.insert(0, str(PACKAGE / "test" / "rostest"))
from view_looker import Looker, wait_for_url  # noqa: E402

# m between robots, as in the job fleet.
SPACING = 2.5
PER_ROW = 8
# Most of a core that may be used, in percent.
ALLOWED = {"nobody": 1.0, "somebody": 15.0, "with an image": 25.0}
SETTLE_SECONDS = 5.0


class Robots:
    """A bridge, and robots that drive in circles."""

    def __init__(self, number: int):
        script = PACKAGE / "scripts" / "pybullet_bridge.py"
        command = [sys.executable, str(script), "_publish_world_tf:=true"]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        rospy.wait_for_service("/gazebo/spawn_urdf_model", 60.0)
        self._spawn = rospy.ServiceProxy("/gazebo/spawn_urdf_model", srv.SpawnModel)
        # Each says where it is as often as pictures are sent.
        block = (PACKAGE / "urdf" / "block_robot.urdf").read_text()
        self._text = re.sub(r"<odometryRate>[^<]*<", "<odometryRate>30<", block)
        self._commands: List[rospy.Publisher] = []
        for index in range(number):
            self._add(f"robot{index}", self._text, index)

    def add_camera(self) -> None:
        """Put a robot with a camera beside the others."""
        self._add("eye", (PACKAGE / "urdf" / "camera_robot.urdf").read_text(), -PER_ROW)

    def end(self) -> None:
        """End the bridge."""
        self._process.terminate()
        self._process.wait(20.0)

    def _add(self, name: str, text: str, index: int) -> None:
        row, column = divmod(index, PER_ROW)
        pose = Pose(Point(SPACING * column, SPACING * row, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
        rospy.set_param(f"/{name}/tf_prefix", name)
        rospy.set_param(f"/{name}/robot_description", text)
        self._spawn(name, text, name, pose, "")
        commands = rospy.Publisher(f"{name}/cmd_vel", Twist, queue_size=1, latch=True)
        commands.publish(Twist(linear=Vector3(0.2, 0.0, 0.0), angular=Vector3(0.0, 0.0, 0.3)))
        self._commands.append(commands)


class View:
    """The view as a process."""

    def __init__(self, log: Path):
        self._log = log
        with log.open("w") as out:
            command = [sys.executable, str(PACKAGE / "scripts" / "view.py"), "_port:=18300"]
            self._process = psutil.Popen(command, stdout=out, stderr=subprocess.STDOUT)
        self.url = wait_for_url(self._log.read_text)

    def percent(self, seconds: float) -> float:
        """Return how much of a core it uses for so long, in percent."""
        before, start = self._used(), time.perf_counter()
        time.sleep(seconds)
        return 100.0 * (self._used() - before) / (time.perf_counter() - start)

    def end(self) -> None:
        """End it."""
        self._process.terminate()
        self._process.wait(20.0)

    def _used(self) -> float:
        used = self._process.cpu_times()
        return used.user + used.system


def measure(number: int, seconds: float, rounds: int, log: Path) -> List[Dict[str, Any]]:
    """Return what the view costs in each of the three cases, medians and extremes of rounds."""
    robots = Robots(number)
    view = View(log)
    rows = []
    try:
        time.sleep(SETTLE_SECONDS)
        rows.append(_row("nobody", [view.percent(seconds) for _ in range(rounds)]))
        for case in ("somebody", "with an image"):
            if case == "with an image":
                robots.add_camera()
            looker = Looker(view.url)
            time.sleep(SETTLE_SECONDS)
            received = looker.received
            percents = [view.percent(seconds) for _ in range(rounds)]
            kilobytes = (looker.received - received) / (seconds * rounds) / 1000.0
            seen = sum(len(looker.positions(name)) for name in looker.nodes if "/robots/" in name)
            looker.close()
            rows.append({**_row(case, percents), "kB_per_s": kilobytes, "bodies": seen})
    finally:
        view.end()
        robots.end()
    return rows


def _row(case: str, percents: Sequence[float]) -> Dict[str, Any]:
    ordered = sorted(percents)
    row = {"case": case, "percent": ordered[len(ordered) // 2], "rounds": ordered}
    print(f"{case}: {row['percent']:.1f} % of a core", flush=True)
    return row


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(prog="bench.sh view")
    parser.add_argument("out", type=Path)
    parser.add_argument("--robots", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    given.out.parent.mkdir(parents=True, exist_ok=True)
    prepare_master()
    rospy.init_node("bench_view", disable_signals=True)
    log = given.out.with_suffix(".log")
    rows = measure(given.robots, given.seconds, given.rounds, log)
    print(f"\n{given.robots} robots, 30 pictures per second\n")
    print(f"{'':16}{'% of a core':>12}{'allowed':>9}{'kB/s':>8}{'bodies':>8}")
    for row in rows:
        print(
            f"{row['case']:16}{row['percent']:12.1f}{ALLOWED[row['case']]:9.0f}"
            f"{row.get('kB_per_s', 0.0):8.0f}{row.get('bodies', 0):8d}"
        )
    given.out.write_text(json.dumps({"robots": given.robots, "rows": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
