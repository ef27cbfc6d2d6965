"""The reports of the jobs `sensors` and `beacons`: measurements of a robot on a drive."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Callable, Iterator, Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from numpy import ndarray

from bullet_lab.core.figures import (
    BEACON_RADIUS,
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    VERMILION,
    gridded,
    new_figure,
    plan_axes,
)
from bullet_lab.core.files import Join, Series, Values
from bullet_lab.core.se2 import hypot
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.errors import LabError
from bullet_lab.reports import Figures, Reading, Report, Summary, draw_path

# N; a smaller force is a touch that has just ended.
TOUCH = 0.1
DISTANCES = "distances.csv"
BEACON_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE)


class SensorsReport(Report):
    """A CSV file for each sensor: odom, scan (with a number of rays), range, imu and bumper.

    Attributes:
        angles: rad, of the first ray of the newest scan, and the step to the next ray.
        touched: names of the models that the bumper touched.
    """

    def __init__(self, folder: Path, rays: int):
        super().__init__(folder)
        self.topics = {
            "odom": "nav_msgs/Odometry",
            "scan": "sensor_msgs/LaserScan",
            "sonar": "sensor_msgs/Range",
            "imu": "sensor_msgs/Imu",
            "bumper": "gazebo_msgs/ContactsState",
        }
        self.series = {
            "odom": Series(folder / "odom.csv", ("x", "y", "yaw")),
            "scan": Series(folder / "scan.csv", [f"range_{ray}" for ray in range(rays)]),
            "sonar": Series(folder / "range.csv", ("range",)),
            "imu": Series(folder / "imu.csv", ("ax", "ay", "az", "wx", "wy", "wz")),
            "bumper": Series(folder / "bumper.csv", ("points", "fx", "fy", "fz")),
        }
        self.angles = (0.0, 0.0)
        self.touched: set[str] = set()

    def take(self, topic: str, reading: Reading) -> bool:
        super().take(topic, reading)
        if topic == "scan":
            self.angles = reading.detail
        elif topic == "bumper":
            self.touched.update(reading.detail)
        return True

    def table(self, topic: str) -> tuple[ndarray, ndarray]:
        """Return the stamps (s) and the rows of a sensor."""
        return self.series[topic].table()

    def push(self) -> tuple[ndarray, ndarray]:
        """Return the stamps (s) of the bumper's messages and the horizontal forces (N)."""
        stamps, rows = self.table("bumper")
        return stamps, hypot(rows[:, 1], rows[:, 2])

    def scan_points(self) -> ndarray:
        """Return the points (m) of all scans in the frame of the odometry, shape (n, 2).

        The pose of a scan is that of its stamp, or the last one before. The scanner is taken to be
        at the origin of the robot.
        """
        stamps, poses = self.table("odom")
        scan_stamps, ranges = self.table("scan")
        if not len(stamps) or not len(scan_stamps):
            return np.zeros((0, 2))
        index = np.searchsorted(stamps, scan_stamps + 1e-9) - 1
        chosen = index >= 0
        x, y, yaw = (column[:, None] for column in poses[index[chosen]].T)
        first, step = self.angles
        bearing = yaw + (first + step * np.arange(ranges.shape[1]))[None, :]
        seen = np.isfinite(ranges[chosen])
        reach = np.where(seen, ranges[chosen], 0.0)
        points = np.stack([x + reach * np.cos(bearing), y + reach * np.sin(bearing)], axis=-1)
        return points[seen]

    def summary(self, finished: bool, run: Summary) -> Summary:
        _, ranges = self.table("sonar")
        _, scans = self.table("scan")
        _, inertial = self.table("imu")
        stamps, force = self.push()
        pushed = force > TOUCH
        rows = {topic: len(series) for topic, series in self.series.items()}
        return {
            "finished": finished,
            "messages": {"range" if name == "sonar" else name: n for name, n in rows.items()},
            "nearest_scan_m": _of(np.min, scans[np.isfinite(scans)]),
            "nearest_range_m": _of(np.min, ranges),
            "mean_upward_acceleration_mps2": _of(np.mean, inertial[:, 2]),
            "greatest_turn_rate_radps": _of(np.max, np.abs(inertial[:, 5])),
            "touched": sorted(self.touched),
            "first_touch_s": _of(np.min, stamps[pushed]),
            "median_push_N": _of(np.median, force[pushed]),
            **run,
        }

    def figures(self, summary: Summary) -> Figures:
        figure = new_figure(12.5, 7.6, "Measurements of the sensors")
        grid = figure.add_gridspec(5, 2, width_ratios=(1.0, 1.1))
        figure.subplots_adjust(
            left=0.06, right=0.98, top=0.93, bottom=0.07, hspace=0.22, wspace=0.18
        )
        self._draw_plan(figure.add_subplot(grid[:, 0]))
        panels = [figure.add_subplot(grid[row, 1]) for row in range(5)]
        self._draw_curves(panels)
        units = ("nearest ray (m)", "range (m)", "IMU (m/s²)", "IMU (rad/s)", "bumper (N)")
        times = np.concatenate([series.table()[0] for series in self.series.values()])
        for panel, unit in zip(panels, units):
            gridded(panel, ylabel=unit)
            if times.size:
                panel.set_xlim(times.min(), times.max())
        for panel in panels[:-1]:
            panel.set_xticklabels([])
        return {"sensors.png": figure}

    def _draw_plan(self, axes: Axes) -> None:
        plan_axes(axes, title="laser scans, placed by the odometry")
        x, y = self.scan_points().T
        axes.plot(x, y, ".", color=VERMILION, markersize=1.0, alpha=0.3)
        _, poses = self.table("odom")
        if len(poses):
            draw_path(axes, poses, BLACK, 1.4, start="white", end=BLACK)
            axes.legend(loc="best")

    def _draw_curves(self, panels: list[Axes]) -> None:
        scan, sonar, acceleration, rotation, bumper = panels
        stamps, scans = self.table("scan")
        # A ray without an obstacle is +inf, one with an obstacle that is too near is -inf.
        nearest = [row[np.isfinite(row)].min(initial=np.inf) for row in scans]
        scan.plot(stamps, nearest, color=VERMILION, linewidth=1.0)
        sonar.plot(*self.table("sonar"), color=GREEN, linewidth=1.0)
        stamps, inertial = self.table("imu")
        for first, panel in ((0, acceleration), (3, rotation)):
            for column, (name, colour) in enumerate(zip("xyz", (BLUE, ORANGE, PURPLE)), first):
                values = inertial[:, column]
                panel.plot(stamps, values, color=colour, linewidth=0.8, label=name)
            panel.legend(loc="upper left", ncol=3, fontsize=7)
        bumper.plot(*self.push(), color=VERMILION, linewidth=1.0)
        bumper.set(xlabel="simulated time (s)")


def _of(figure: Callable[[ndarray], Any], values: ndarray) -> float | None:
    """Return a figure of some values; None without a value."""
    return float(figure(values)) if values.size else None


class BeaconsReport(Report):
    """Rows `x,y,yaw,<beacon>…,true_<beacon>…` in m and rad, in distances.csv.

    A row is written once the robot's pose and the distances to all beacons have come for one
    stamp. The true distances follow from the pose and from the places of the beacons (m, m).
    """

    def __init__(self, folder: Path, beacons: Mapping[str, tuple[float, float]]):
        super().__init__(folder)
        self.beacons = dict(beacons)
        ranges = {f"{name}/range": "sensor_msgs/Range" for name in self.beacons}
        self.topics = {"odom": "nav_msgs/Odometry", **ranges}
        columns = ["x", "y", "yaw", *self.beacons, *(f"true_{name}" for name in self.beacons)]
        self._rows = Series(folder / DISTANCES, columns, in_order=False)
        self.series = {DISTANCES: self._rows}
        self._join = Join(self.topics, self._complete)

    def take(self, topic: str, reading: Reading) -> bool:
        if not all(map(math.isfinite, reading.values)):
            raise LabError("a distance of {}".format(*reading.values))
        self._join.add(topic, reading.stamp, reading.values)
        return True

    def _complete(self, stamp: int, found: dict[str, Values]) -> None:
        x, y, _ = pose = found["odom"]
        measured = [value for name in self.beacons for value in found[f"{name}/range"]]
        true = [hypot(x - bx, y - by) for bx, by in self.beacons.values()]
        self._rows.add(stamp, [*pose, *measured, *true])

    def _found(self) -> tuple[Trajectory | None, ndarray, ndarray]:
        """Return the path, and the measured and the true distances in m, shape (n, beacons)."""
        return (self._rows.path(), *np.hsplit(self._rows.table()[1][:, 3:], 2))

    def summary(self, finished: bool, run: Summary) -> Summary:
        path, measured, true = self._found()
        figures = {"closest_m": [], "largest_error_m": []}
        if path is not None:
            figures = {
                "closest_m": measured.min(axis=0).tolist(),
                "largest_error_m": np.abs(measured - true).max(axis=0).tolist(),
                "path_length_m": path.length(),
            }
        counts = {"rows": len(measured), "beacons": list(self.beacons)}
        return {"finished": finished, **counts, **figures, **run}

    def figures(self, summary: Summary) -> Figures:
        figure = new_figure(9.5, 7.0, "Distances to the beacons")
        above, below = figure.subplots(2, 1, gridspec_kw={"height_ratios": (1.0, 1.8)})
        figure.subplots_adjust(left=0.08, right=0.86, top=0.92, bottom=0.08, hspace=0.26)
        plan_axes(above)
        for name, (x, y), colour in self._coloured():
            above.add_patch(Circle((x, y), BEACON_RADIUS, facecolor=colour, edgecolor=BLACK))
            above.annotate(name, (x, y + 1.2 * BEACON_RADIUS), ha="center", va="bottom")
            # Matplotlib ignores patches when it computes the limits of the axes.
            above.plot(x, y, ".", color=colour)
        gridded(below, xlabel="simulated time (s)", ylabel="distance (m)")
        if len(self._rows):
            self._draw_rows(above, below)
            for axes in (above, below):
                axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return {"distances.png": figure}

    def _draw_rows(self, plan: Axes, curves: Axes) -> None:
        path, measured, true = self._found()
        draw_path(plan, path.poses, BLACK, 1.4, start=GREEN, end="white")
        for column, (name, _, colour) in enumerate(self._coloured()):
            curves.plot(path.stamps, true[:, column], color=colour, linewidth=6.0, alpha=0.3)
            curves.plot(path.stamps, measured[:, column], color=colour, linewidth=1.5, label=name)
        curves.plot([], [], color=BLACK, linewidth=6.0, alpha=0.3, label="truth")
        curves.set_ylim(0.0, 1.05 * max(measured.max(), true.max()))

    def _coloured(self) -> Iterator[tuple[str, tuple[float, float], str]]:
        for number, (name, place) in enumerate(self.beacons.items()):
            yield name, place, BEACON_COLOURS[number % len(BEACON_COLOURS)]
