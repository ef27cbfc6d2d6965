"""What a robot's sensors measured on a drive."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, Optional, Sequence

import numpy as np

from bullet_lab.recording.series import Series

# A push below this (N) is a touch that has just ended.
TOUCH = 0.1


@dataclass(frozen=True)
class Angles:
    """Of the rays of a scan, in rad: the first one's and the step to the next."""

    first: float
    step: float

    def of(self, count: int) -> np.ndarray:
        """Return the angles of so many rays."""
        return self.first + self.step * np.arange(count)


class SensorsRecording:
    """Writes odom.csv, scan.csv, range.csv, imu.csv and bumper.csv row by row.

    Args:
        folder: where they go.
        rays: number of a scan's.

    Raises:
        FileError: one cannot be written, here and in all that adds to it.
    """

    def __init__(self, folder: Path, rays: int):
        self.odom = Series(folder / "odom.csv", ("x", "y", "yaw"))
        self.scan = Series(folder / "scan.csv", [f"range_{ray}" for ray in range(rays)])
        self.range = Series(folder / "range.csv", ("range",))
        self.imu = Series(folder / "imu.csv", ("ax", "ay", "az", "wx", "wy", "wz"))
        self.bumper = Series(folder / "bumper.csv", ("points", "fx", "fy", "fz"))

    def all(self) -> Dict[str, Series]:
        """Return all series by name."""
        return dict(vars(self))

    def finish(self, until: Optional[int]) -> None:
        """Close all files; leave out what came after a stamp in ns, if one is given."""
        for series in self.all().values():
            series.finish(until)


def scan_points(recording: SensorsRecording, angles: Angles) -> np.ndarray:
    """Return what the scans saw, in the odometry's frame.

    A scan is placed by the pose of the same stamp, or the last one before it; the scanner is
    taken to stand above the robot's origin.

    Returns:
        Points (m, m), shape (n, 2).
    """
    stamps, poses = recording.odom.table()
    scan_stamps, ranges = recording.scan.table()
    if not len(stamps) or not len(scan_stamps):
        return np.zeros((0, 2))
    index = np.searchsorted(stamps, scan_stamps + 1e-9) - 1
    chosen = index >= 0
    x, y, yaw = (column[:, None] for column in poses[index[chosen]].T)
    bearing = yaw + angles.of(ranges.shape[1])[None, :]
    seen = np.isfinite(ranges[chosen])
    reach = np.where(seen, ranges[chosen], 0.0)
    points = np.stack([x + reach * np.cos(bearing), y + reach * np.sin(bearing)], axis=-1)
    return points[seen]


def sensors_summary(recording: SensorsRecording, touched: Sequence[str]) -> Dict[str, Any]:
    """Return the figures for summary.json; null where a sensor said nothing.

    Args:
        recording: of all sensors.
        touched: names of what the bumper touched.
    """
    _, ranges = recording.range.table()
    _, scans = recording.scan.table()
    _, inertial = recording.imu.table()
    stamps, bumps = recording.bumper.table()
    force = np.hypot(bumps[:, 1], bumps[:, 2])
    pushed = force > TOUCH
    return {
        "messages": {name: len(series.table()[0]) for name, series in recording.all().items()},
        "nearest_scan_m": _least(scans[np.isfinite(scans)]),
        "nearest_range_m": _least(ranges),
        "mean_upward_acceleration_mps2": float(inertial[:, 2].mean()) if len(inertial) else None,
        "greatest_turn_rate_radps": float(np.abs(inertial[:, 5]).max()) if len(inertial) else None,
        "touched": sorted(touched),
        "first_touch_s": float(stamps[pushed][0]) if pushed.any() else None,
        "median_push_N": float(np.median(force[pushed])) if pushed.any() else None,
    }


def _least(values: np.ndarray) -> Optional[float]:
    return float(values.min()) if values.size else None
