"""Measures how the bridge slows down with robots and models; run it with scripts/bench.sh.

`robots`: block robots that drive, odometry 20 Hz and lasers 10 Hz, a subscriber to each topic.
`models`: one such robot among beacons. Each for a bridge in a process of its own, at full speed
in steps of 1 ms, with the subscribers in this process. Prints a table, writes JSON, and draws
what has been measured so far of both beside each other. Starts a ROS master of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import time
from pathlib import Path
from typing import Any, Dict, List, Sequence

import rospkg
import rospy
from bullet_lab.srv import Step
from geometry_msgs.msg import Point, Pose, Quaternion, Twist, Vector3

from bullet_lab.core.figures import BLACK, BLUE, GREY, ORANGE, new_figure, save
from bullet_lab.ros.launcher.supervision import prepare_master
from bullet_lab.ros.messages.gazebo_types import srv

BLOCK = Path(rospkg.RosPack().get_path("bullet_lab")) / "urdf" / "block_robot.urdf"
BEACON = '<sdf version="1.6"><include><uri>model://beacon</uri></include></sdf>'
NUMBERS = {"robots": (1, 2, 5, 10, 20, 50), "models": (10, 100, 1000)}
# Below so many, more is simulated.
EASY = {"robots": 5, "models": 100}
TOPICS = ("odom", "scan")
# So many robots have to be simulated in real time.
ASKED_ROBOTS = 20
# m between robots, as in the job fleet.
SPACING = 2.5
PER_ROW = 8


class Bridge:
    """A paused bridge in a process of its own, and a subscriber to all that its robots send."""

    def __init__(self):
        command = ["rosrun", "bullet_lab", "pybullet_bridge.py", "_paused:=true", "_rtf:=0"]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        rospy.wait_for_service("/bullet_lab/step", 60.0)
        self._step = rospy.ServiceProxy("/bullet_lab/step", Step, persistent=True)
        self._spawn_urdf = self._spawner("urdf")
        self._spawn_sdf = self._spawner("sdf")
        self._text = BLOCK.read_text()
        self._listeners: List[Any] = []
        self._commands: List[Any] = []
        self.received = 0

    def add_robot(self, number: int) -> None:
        """Put a robot into the world, listen to it and let it drive in circles."""
        row, column = divmod(number, PER_ROW)
        name = f"robot{number}"
        pose = Pose(Point(SPACING * column, SPACING * row, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
        rospy.set_param(f"/{name}/tf_prefix", name)
        self._spawn_urdf(name, self._text, name, pose, "")
        for topic in TOPICS:
            self._listeners.append(rospy.Subscriber(f"{name}/{topic}", rospy.AnyMsg, self._receive))
        commands = rospy.Publisher(f"{name}/cmd_vel", Twist, queue_size=1, latch=True)
        commands.publish(Twist(linear=Vector3(0.2, 0.0, 0.0), angular=Vector3(0.0, 0.0, 0.3)))
        self._commands.append(commands)

    def add_model(self, number: int) -> None:
        """Put a beacon into the world."""
        row, column = divmod(number, 32)
        pose = Pose(Point(3.0 + column, row - 16.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
        self._spawn_sdf(f"beacon_{number}", BEACON, "", pose, "")

    def factor(self, seconds: float) -> Dict[str, float]:
        """Return simulated seconds per second, of the wall and of the bridge's own work."""
        self._settle()
        before, start = self._worked(), time.perf_counter()
        self._step(round(1000 * seconds))
        wall, work = time.perf_counter() - start, self._worked() - before
        return {"wall": seconds / wall, "work": seconds / work}

    def stop(self) -> None:
        """End it."""
        for entry in (*self._listeners, *self._commands):
            entry.unregister()
        self._process.terminate()
        self._process.wait(20.0)

    def _worked(self) -> float:
        """Return the processor time of all threads so far, in s; finer than the usual 10 ms."""
        threads = Path(f"/proc/{self._process.pid}/task").glob("*/schedstat")
        return 1e-9 * sum(int(path.read_text().split()[0]) for path in threads)

    def _settle(self) -> None:
        """Let robots get going, and see that all topics are there."""
        expected = len(self._listeners)
        deadline = time.monotonic() + 20.0
        while True:
            self.received = 0
            self._step(200)
            time.sleep(0.1)
            # In 0.2 s, odometry comes four times and a scan twice.
            if self.received >= 3 * expected:
                return
            if time.monotonic() > deadline:
                raise SystemExit(f"{self.received} messages in 0.2 s of {expected} topics")

    def _receive(self, _message: Any) -> None:
        self.received += 1

    @staticmethod
    def _spawner(kind: str) -> rospy.ServiceProxy:
        return rospy.ServiceProxy(f"/gazebo/spawn_{kind}_model", srv.SpawnModel, persistent=True)


def measure(bench: str, rounds: int, seconds: float) -> List[Dict[str, float]]:
    """Return the real-time factors for each number; medians of the rounds.

    All come from one bridge, to which robots or models are added on the way.
    """
    bridge = Bridge()
    rows, there = [], 0
    try:
        if bench == "models":
            bridge.add_robot(0)
        for number in NUMBERS[bench]:
            for index in range(there, number):
                bridge.add_robot(index) if bench == "robots" else bridge.add_model(index)
            there = number
            # What is fast takes longer, to be measured as well.
            duration = seconds * max(1.0, EASY[bench] / number)
            found = [bridge.factor(duration) for _ in range(rounds)]
            figures = {key: statistics.median(row[key] for row in found) for key in found[0]}
            rows.append({"number": number, **figures})
            print(f"{number} {bench}: {figures['wall']:.2f}", flush=True)
    finally:
        bridge.stop()
    return rows


def growth(rows: Sequence[Dict[str, float]]) -> float:
    """Return the work for each robot or model in the last row over that in the first.

    At most 1 where the whole grows at most linearly.
    """
    first, *_, last = (1.0 / row["work"] / row["number"] for row in rows)
    return last / first


def print_table(bench: str, rows: Sequence[Dict[str, float]]) -> None:
    """Print what was measured beside what is asked for."""
    columns = ("real-time factor", "by its own work", "µs a step each")
    print(f"\n{bench:>8} {columns[0]:>18} {columns[1]:>16} {columns[2]:>15} asked")
    for row in rows:
        number = row["number"]
        asked = ">= 1" if (bench, number) == ("robots", ASKED_ROBOTS) else ""
        each = 1e3 / row["work"] / number
        line = f"{number:>8} {row['wall']:>18.2f} {row['work']:>16.2f} {each:>15.2f} {asked}"
        print(line.rstrip())
    print(f"\nlast row over first, each: {growth(rows):.2f} (<= 1 is at most linear growth)")


def draw(folder: Path) -> None:
    """Draw what is there of both benches into scaling.png."""
    figure = new_figure(9.0, 3.8)
    for index, (bench, colour) in enumerate((("robots", BLUE), ("models", ORANGE)), start=1):
        axes = figure.add_subplot(1, 2, index)
        axes.set(xscale="log", yscale="log", xlabel=f"{bench}", ylabel="real-time factor")
        axes.grid(alpha=0.3, which="both")
        axes.axhline(1.0, color=BLACK, linewidth=0.8, linestyle="--", label="real time")
        path = folder / f"{bench}.json"
        if path.is_file():
            rows = json.loads(path.read_text())["rows"]
            numbers = [row["number"] for row in rows]
            axes.plot(numbers, [row["wall"] for row in rows], "o-", color=colour, label="measured")
            if bench == "robots":
                linear = [rows[0]["wall"] / n for n in numbers]
                axes.plot(numbers, linear, color=GREY, linewidth=0.9, label="linear")
        axes.legend()
    figure.suptitle("Steps of 1 ms; of each robot, odometry at 20 Hz and 360 rays at 10 Hz")
    figure.subplots_adjust(left=0.08, right=0.98, bottom=0.15, top=0.88, wspace=0.22)
    save(figure, folder / "scaling.png")


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="JSON file to write: robots.json or models.json")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=3.0, help="simulated, of each round")
    wanted = parser.parse_args()
    bench = wanted.out.stem
    prepare_master()
    rospy.init_node("bench", disable_signals=True)
    rows = measure(bench, wanted.rounds, wanted.seconds)
    print_table(bench, rows)
    wanted.out.parent.mkdir(parents=True, exist_ok=True)
    figures = {"cores": os.cpu_count(), "growth": growth(rows), "rows": rows}
    wanted.out.write_text(json.dumps(figures, indent=2) + "\n")
    draw(wanted.out.parent)
    print(f"written to {wanted.out} and {wanted.out.parent / 'scaling.png'}")


if __name__ == "__main__":
    main()
