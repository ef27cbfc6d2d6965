"""Measures how the bridge slows down with robots and models; scripts/bench.sh robots and models.

robots: block robots that drive, odometry 20 Hz and lasers 10 Hz, a subscriber to each topic.
models: one such robot among beacons. Each for a bridge in a process of its own, at full speed
in steps of 1 ms, with the subscribers in this process. Prints a table, writes JSON, and draws
what has been measured so far of both beside each other.
--rounds N: of which the median is taken. --seconds S: simulated, of each round.
"""

from __future__ import annotations

import json
import statistics
import time
from pathlib import Path
from typing import Any, Dict, List, Sequence

import rospy
from common import Bridge, options, start_ros, urdf, write
from lab_nodes import end_all

from bullet_lab.core.figures import BLACK, BLUE, GREY, ORANGE, new_figure, save

NUMBERS = {"robots": (1, 2, 5, 10, 20, 50), "models": (10, 100, 1000)}
# Below so many, more is simulated.
EASY = {"robots": 5, "models": 100}
# So many robots have to be simulated in real time.
ASKED_ROBOTS = 20


class Scaled(Bridge):
    """A paused bridge, and a subscriber to all that its robots send."""

    def __init__(self):
        super().__init__("_paused:=true", "_rtf:=0")
        self._block = urdf("block_robot")
        self._topics = 0
        self._received = 0

    def add(self, bench: str, number: int) -> None:
        """Put one more into the world; listen to robots."""
        if bench == "models":
            self.add_model(f"beacon_{number}", number)
            return
        name = self.add_robot(number, self._block)
        for topic in ("odom", "scan"):
            rospy.Subscriber(f"{name}/{topic}", rospy.AnyMsg, self._receive)
            self._topics += 1

    def factor(self, seconds: float) -> Dict[str, float]:
        """Return simulated seconds per second, of the wall and of the bridge's own work."""
        self._settle()
        before, start = self._worked(), time.perf_counter()
        self.step(round(1000 * seconds))
        wall, work = time.perf_counter() - start, self._worked() - before
        return {"wall": seconds / wall, "work": seconds / work}

    def _worked(self) -> float:
        """Return the processor time of all threads so far, in s; finer than the usual 10 ms."""
        threads = Path(f"/proc/{self.process.pid}/task").glob("*/schedstat")
        return 1e-9 * sum(int(path.read_text().split()[0]) for path in threads)

    def _settle(self) -> None:
        """Let robots get going, and see that all topics are there."""
        deadline = time.monotonic() + 20.0
        while True:
            self._received = 0
            self.step(200)
            time.sleep(0.1)
            # In 0.2 s, odometry comes four times and a scan twice.
            if self._received >= 3 * self._topics:
                return
            if time.monotonic() > deadline:
                raise SystemExit(f"{self._received} messages in 0.2 s of {self._topics} topics")

    def _receive(self, _message: Any) -> None:
        self._received += 1


def measure(bench: str, rounds: int, seconds: float) -> List[Dict[str, float]]:
    """Return the real-time factors for each number; medians of the rounds.

    All come from one bridge, to which robots or models are added on the way.
    """
    bridge = Scaled()
    rows, there = [], 0
    try:
        if bench == "models":
            bridge.add("robots", 0)
        for number in NUMBERS[bench]:
            for index in range(there, number):
                bridge.add(bench, index)
            there = number
            # What is fast takes longer, to be measured as well.
            duration = seconds * max(1.0, EASY[bench] / number)
            found = [bridge.factor(duration) for _ in range(rounds)]
            figures = {key: statistics.median(row[key] for row in found) for key in found[0]}
            rows.append({"number": number, **figures})
            print(f"{number} {bench}: {figures['wall']:.2f}", flush=True)
    finally:
        end_all(bridge)
    return rows


def growth(rows: Sequence[Dict[str, float]]) -> float:
    """Return the work for each robot or model in the last row over that in the first.

    At most 1 where the whole grows at most linearly.
    """
    first, *_, last = (1.0 / row["work"] / row["number"] for row in rows)
    return last / first


def print_rows(bench: str, rows: Sequence[Dict[str, float]]) -> None:
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
        axes.set(xscale="log", yscale="log", xlabel=bench, ylabel="real-time factor")
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
    """Measure, print, write and draw; the name of the file to write is that of the bench."""
    wanted = options(__doc__, rounds=3, seconds=3.0)
    start_ros()
    rows = measure(wanted.out.stem, wanted.rounds, wanted.seconds)
    print_rows(wanted.out.stem, rows)
    write(wanted.out, {"growth": growth(rows), "rows": rows})
    draw(wanted.out.parent)
    print(f"drawn in {wanted.out.parent / 'scaling.png'}")


if __name__ == "__main__":
    main()
