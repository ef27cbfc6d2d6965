"""Measures how the bridge slows down with robots and models; scripts/bench.sh robots and models.

robots: block robots that drive, odometry 20 Hz and lasers 10 Hz, a subscriber to each topic.
models: one such robot among beacons. Each for a bridge in a process of its own, at full speed
in steps of 1 ms, with the subscribers in this process. Prints a table, writes JSON, and draws
what has been measured so far of both beside each other.
--rounds N: of which the median is taken. --seconds S: simulated, of each round.
"""

import json
import statistics
import time

import rospy
from common import Bridge, options, report, start_ros, urdf
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

    def add(self, bench, number):
        """Put one more into the world; listen to robots."""
        if bench == "models":
            self.add_model(f"beacon_{number}", number)
            return
        name = self.add_robot(number, self._block)
        for topic in ("odom", "scan"):
            rospy.Subscriber(f"{name}/{topic}", rospy.AnyMsg, self._receive)
            self._topics += 1

    def factor(self, seconds):
        """Return simulated seconds per second."""
        self._settle()
        start = time.perf_counter()
        self.step(round(1000 * seconds))
        return seconds / (time.perf_counter() - start)

    def _settle(self):
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

    def _receive(self, _message):
        self._received += 1


def measure(bench, rounds, seconds):
    """Return the real-time factors for each number; medians of the rounds.

    All come from one bridge, to which robots or models are added on the way.
    """
    bridge = Scaled()
    rows = []
    there = 0
    try:
        if bench == "models":
            bridge.add("robots", 0)
        for number in NUMBERS[bench]:
            for index in range(there, number):
                bridge.add(bench, index)
            there = number
            # What is fast takes longer, to be measured as well.
            duration = seconds * max(1.0, EASY[bench] / number)
            factor = statistics.median(bridge.factor(duration) for _ in range(rounds))
            asked = ">= 1" if (bench, number) == ("robots", ASKED_ROBOTS) else ""
            rows.append((str(number), factor, ".2f", asked))
            print(f"{number} {bench}: {factor:.2f}", flush=True)
    finally:
        end_all(bridge)
    return rows


def draw(folder):
    """Draw what is there of both benches into scaling.png."""
    figure = new_figure(9.0, 3.8)
    for index, (bench, colour) in enumerate((("robots", BLUE), ("models", ORANGE)), start=1):
        axes = figure.add_subplot(1, 2, index)
        axes.set(xscale="log", yscale="log", xlabel=bench, ylabel="real-time factor")
        axes.grid(alpha=0.3, which="both")
        axes.axhline(1.0, color=BLACK, linewidth=0.8, linestyle="--", label="real time")
        path = folder / f"{bench}.json"
        if path.is_file():
            factors = json.loads(path.read_text())["factors"]
            numbers = NUMBERS[bench]
            axes.plot(numbers, factors, "o-", color=colour, label="measured")
            if bench == "robots":
                linear = [factors[0] / n for n in numbers]
                axes.plot(numbers, linear, color=GREY, linewidth=0.9, label="linear")
        axes.legend()
    figure.suptitle("Steps of 1 ms; of each robot, odometry at 20 Hz and 360 rays at 10 Hz")
    figure.subplots_adjust(left=0.08, right=0.98, bottom=0.15, top=0.88, wspace=0.22)
    save(figure, folder / "scaling.png")


def main():
    """Measure, print, write and draw; the name of the file to write is that of the bench."""
    wanted = options(__doc__, rounds=3, seconds=3.0)
    start_ros()
    rows = measure(wanted.out.stem, wanted.rounds, wanted.seconds)
    report(wanted.out, rows, wanted.out.stem, factors=[factor for _, factor, _, _ in rows])
    draw(wanted.out.parent)
    print(f"drawn in {wanted.out.parent / 'scaling.png'}")


if __name__ == "__main__":
    main()
