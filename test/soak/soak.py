"""Has a lab live for hours of simulated time, and looks whether it grows; see scripts/soak.sh.

A camera robot drives squares in lock step with noisy odometry and a marker detector, while models,
robots with lasers, subscribers and nodes come and go, and the world and time are reset. What the
nodes take of the machine is sampled into samples.csv; a soak that was stopped goes on in another
segment, with nodes of its own. What is there at a time takes more or less: shadow maps alone take
up to 64 MB. So now and then all that has come is taken away, and what the nodes take then is what
is judged: slopes within segments, after the first quarter of each.
"""

import csv
import itertools
import math
import sys
import time
from pathlib import Path

import numpy as np
import rospy
from lab import NODES, Soaked
from lab_nodes import parser_of
from life import Life
from slope import slope
from tqdm import tqdm

from bullet_lab.core import figures
from bullet_lab.core.files import write_json
from bullet_lab.ros.launcher.supervision import prepare_master
from bullet_lab.studies.study import interrupt_once

UNITS = {"mb": "memory (MB)", "descriptors": "descriptors", "threads": "threads"}
TAKEN = tuple(UNITS)
MOST_GROWTH = 1.0
"""Of each, in an hour of simulated time."""

COLUMNS = (
    *("segment", "at_rest", "hours", "speed"),
    *(f"{name}_{what}" for name in NODES for what in TAKEN),
)
COLOURS = (
    *(figures.VERMILION, figures.BLUE, figures.GREEN),
    *(figures.ORANGE, figures.PURPLE, figures.BLACK),
)
# Simulated seconds between samples, of long soaks; short ones have so many samples at least.
SAMPLE_SECONDS, FEWEST_SAMPLES = 10.0, 60
# Simulated seconds between rests; and wall seconds of one, in which nodes look for garbage.
REST_SECONDS, REST = 240.0, 12.0
# Simulated seconds between lines, where there is no terminal for a bar.
TELL_SECONDS = 900.0
# Wall seconds without a simulated one.
PATIENCE = 60.0
FLAT, GROWS, OPEN = "flat", "grows", "open"


class Samples:
    """Rows of samples.csv, those of earlier segments among them."""

    def __init__(self, path):
        self._path = path
        self.rows = []
        if path.exists():
            with path.open() as file:
                # The last one may have been cut.
                rows = [row for row in csv.DictReader(file) if None not in row.values()]
            self.rows = [{name: float(value) for name, value in row.items()} for row in rows]
            if self.rows and tuple(self.rows[0]) != COLUMNS:
                sys.exit(f"soak.sh: {path} has other columns: choose another --out")
        self._write("w", [COLUMNS, *(row.values() for row in self.rows)])

    @property
    def hours(self):
        """How long it has been simulated."""
        return self.rows[-1]["hours"] if self.rows else 0.0

    @property
    def segment(self):
        """The number of the next segment, from 1 on."""
        return int(self.rows[-1]["segment"]) + 1 if self.rows else 1

    def add(self, *values):
        """Append a row."""
        self.rows.append(dict(zip(COLUMNS, values)))
        self._write("a", [values])

    def column(self, name):
        """Return a column."""
        return np.array([row[name] for row in self.rows])

    def resting(self):
        """Return which rows are of a rest."""
        return self.column("at_rest") > 0.0

    def slope(self, values):
        """How much a column grows in an hour, at rest."""
        rows = self.resting()
        return slope(self.column("hours")[rows], values[rows], self.column("segment")[rows])

    def _write(self, mode, rows):
        with self._path.open(mode, newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)


def live(samples, hours, seed, folder):
    """Have a lab live until so many hours have been simulated; return what happened."""
    segment, before = samples.segment, samples.hours
    lab = Soaked(folder, seed)
    failures = []
    life = Life(lab, np.random.default_rng([seed, segment]))
    try:
        for taken in _seconds(life, lab, 3600.0 * (hours - before), failures):
            samples.add(segment, taken[0], before + taken[1] / 3600.0, *taken[2:])
    except (rospy.ServiceException, rospy.ROSException) as error:
        failures += [f"the bridge does not answer: {error}", *lab.deaths()]
    except KeyboardInterrupt:
        print("stopped: what was sampled is kept, and the same command goes on", flush=True)
    else:
        failures += lab.deaths()
    finally:
        lab.end()
    return {"done": dict(life.done), "failures": failures + lab.tracebacks()}


def _seconds(life, lab, most, failures):
    """Live second by second; yield samples: at rest or not, seconds, speed, what nodes take."""
    period = min(SAMPLE_SECONDS, most / FEWEST_SAMPLES)
    acted = sampled = rested = life.seconds()
    start, wall, moved, told = acted, time.monotonic(), time.monotonic(), 0
    with tqdm(total=round(most), unit="s", desc="simulated", disable=None, smoothing=0.01) as bar:
        while not lab.dead():
            now = life.seconds()
            if now >= acted + 1.0:
                life.go_on()
                acted, moved = now, time.monotonic()
            elif time.monotonic() > moved + PATIENCE:
                failures.append(f"simulated time has stood still for {PATIENCE:.0f} s")
                return
            if now >= sampled + period:
                speed = (now - sampled) / (time.monotonic() - wall)
                yield [0.0, now - start, speed, *itertools.chain(*lab.taken().values())]
                bar.update(min(round(now - start), bar.total) - bar.n)
                sampled, wall = now, time.monotonic()
                if bar.disable and (now - start) // TELL_SECONDS > told:
                    told += 1
                    print(f"{(now - start) / 3600.0:.2f} h simulated", flush=True)
            if now >= start + most:
                return
            if now >= rested + REST_SECONDS:
                with life.at_rest():
                    time.sleep(REST)
                    yield [1.0, now - start, math.nan, *itertools.chain(*lab.taken().values())]
                rested = sampled = now
                wall = moved = time.monotonic()
            time.sleep(0.05)


def verdicts(samples):
    """Judge the memory of all nodes together, and what each of them takes."""
    columns = {f"{n} {w}": samples.column(f"{n}_{w}") for n in NODES for w in TAKEN}
    columns["all mb"] = sum(samples.column(f"{name}_mb") for name in NODES)
    found = {}
    for name, values in columns.items():
        rise = samples.slope(values)
        numbers = {k: v if math.isfinite(v) else None for k, v in rise._asdict().items()}
        last = float(values[-1]) if len(values) else None
        # NaN is neither.
        verdict = GROWS if rise.low > MOST_GROWTH else FLAT if rise.high < MOST_GROWTH else OPEN
        found[name] = {"last": last, "per_hour": numbers, "verdict": verdict}
    return found


def figure(samples, title):
    """Draw memory, descriptors, threads and speed over time."""
    drawing = figures.new_figure(9.0, 10.0)
    axes = drawing.subplots(4, sharex=True)
    hours, segments, rest = samples.column("hours"), samples.column("segment"), samples.resting()
    begins = hours[np.flatnonzero(np.diff(segments)) + 1]
    for what, ax in zip(TAKEN, axes):
        for name, colour in zip(NODES, COLOURS):
            values = samples.column(f"{name}_{what}")
            ax.plot(hours, values, color=colour, lw=0.5, alpha=0.4)
            ax.plot(hours[rest], values[rest], color=colour, marker=".", lw=1.0, label=name)
        ax.set(ylabel=UNITS[what])
        ax.set_ylim(bottom=0.0)
    axes[3].plot(hours, samples.column("speed"), color=figures.GREY, lw=0.8)
    # Between two resets there may be next to nothing to do.
    axes[3].set(ylabel="times real time", xlabel="simulated time (h)", yscale="log")
    for ax in axes:
        ax.grid(alpha=0.3)
        for begin in begins:
            ax.axvline(begin, color=figures.BLACK, lw=0.8, ls=":")
    axes[0].set_ylim(top=1.35 * axes[0].get_ylim()[1])
    axes[0].legend(ncol=len(NODES), fontsize="small", loc="upper center")
    axes[0].set_title(title, fontsize="medium")
    drawing.tight_layout()
    return drawing


def in_words(found):
    """Say of a verdict what it is from."""
    value, low, high = found["per_hour"].values()
    if value is None:
        return "too short to tell"
    return f"{value:+.2f} [{low:+.2f}, {high:+.2f}] in an hour: {found['verdict']}"


def main():
    """Soak; status 1 where something grows or fails."""
    out = Path("results/soak")
    wanted = parser_of("soak.sh", __doc__, hours=1.0, seed=1, out=out).parse_args()
    folder = wanted.out.absolute()
    (folder / "log").mkdir(parents=True, exist_ok=True)
    samples = Samples(folder / "samples.csv")
    began = time.monotonic()
    happened = {"done": {}, "failures": []}
    if samples.hours < wanted.hours:
        prepare_master()
        rospy.init_node("soak", disable_signals=True)
        rospy.set_param("/use_sim_time", True)
        interrupt_once()
        happened = live(samples, wanted.hours, wanted.seed, folder / "log")
    found = verdicts(samples)
    everything = found["all mb"]
    said = f"memory of all nodes at rest, MB after the first quarter: {in_words(everything)}"
    figures.save(figure(samples, f"{samples.hours:.2f} h simulated; {said}"), folder / "soak.png")
    summary = {
        "seed": wanted.seed,
        "hours": samples.hours,
        "segments": samples.segment - 1,
        "wall_time_s": time.monotonic() - began,
        **happened,
        "verdict": everything["verdict"],
        "columns": found,
    }
    write_json(folder / "summary.json", summary)
    for name in NODES:
        print(f"{name:16} " + "; ".join(f"{w} {in_words(found[f'{name} {w}'])}" for w in TAKEN))
    grown = [name for name, one in found.items() if one["verdict"] == GROWS]
    for failure in [*happened["failures"], *(f"{name} grows" for name in grown)]:
        print(failure)
    print(f"{samples.hours:.2f} h in {samples.segment - 1} segments, slopes are within them")
    print(f"{said}; see {wanted.out}")
    sys.exit(1 if grown or happened["failures"] else 0)


if __name__ == "__main__":
    main()
