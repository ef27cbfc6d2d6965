"""Recording a perfect and a noisy path, row by row, so that a crash loses nothing."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Dict, List, Optional, Tuple

from bullet_lab.errors import LabError
from bullet_lab.numerics.trajectory import CSV_HEADER, Trajectory, csv_row, tum_row
from bullet_lab.recording.files import RowFile, make_folder

PlanarPose = Tuple[float, float, float]
NANOSECONDS = 1_000_000_000


class RecordingError(LabError):
    """A pose cannot be recorded."""


class PathsRecording:
    """Writes odom.tum, noisy_odom.tum and paths.csv while poses come in.

    Poses of the two paths are paired where their stamps are the same to the nanosecond. Each row
    is in the file as soon as it is known; `finish` writes the files once more, whole.

    Args:
        folder: where the files go; made if need be.

    Raises:
        FileError: a file cannot be written, here and in all that adds to the files.
    """

    PERFECT, NOISY, PAIRS = "odom.tum", "noisy_odom.tum", "paths.csv"

    def __init__(self, folder: Path):
        self.folder = make_folder(folder)
        self._perfect: Dict[int, PlanarPose] = {}
        self._noisy: Dict[int, PlanarPose] = {}
        self._last: Dict[str, int] = {}
        self._files = {
            name: RowFile(folder / name) for name in (self.PERFECT, self.NOISY, self.PAIRS)
        }
        self._files[self.PAIRS].write(CSV_HEADER)

    def add_perfect(self, stamp: int, pose: PlanarPose) -> None:
        """Record a perfect pose (m, m, rad) at a stamp in ns.

        Raises:
            RecordingError: not finite, or not later than the one before.
        """
        self._add(self.PERFECT, self._perfect, stamp, pose)
        self._write_pair(stamp)

    def add_noisy(self, stamp: int, pose: PlanarPose) -> None:
        """Record a noisy pose; see `add_perfect`."""
        self._add(self.NOISY, self._noisy, stamp, pose)
        self._write_pair(stamp)

    def last(self, name: str) -> Optional[int]:
        """Return the last stamp in ns in PERFECT or NOISY, or None."""
        return self._last.get(name)

    def perfect(self) -> Optional[Trajectory]:
        """Return the whole perfect path, or None while there is none."""
        return _trajectory(self._perfect, sorted(self._perfect))

    def pairs(self) -> Optional[Tuple[Trajectory, Trajectory]]:
        """Return the paired poses of both paths, or None while there are none."""
        stamps = self._paired_stamps()
        if not stamps:
            return None
        return _trajectory(self._perfect, stamps), _trajectory(self._noisy, stamps)

    def finish(self, until: Optional[int] = None) -> None:
        """Close the files; leave out what came after the stamp `until` in ns, if given."""
        self.close()
        if until is not None:
            for poses in (self._perfect, self._noisy):
                for stamp in [s for s in poses if s > until]:
                    del poses[stamp]
        self._files[self.PERFECT].rewrite(self._tum_rows(self._perfect))
        self._files[self.NOISY].rewrite(self._tum_rows(self._noisy))
        self._files[self.PAIRS].rewrite(
            [CSV_HEADER] + [self._pair_row(stamp) for stamp in self._paired_stamps()]
        )

    def close(self) -> None:
        """Close the files as they are."""
        for file in self._files.values():
            file.close()

    def _add(self, name: str, poses: Dict[int, PlanarPose], stamp: int, pose: PlanarPose) -> None:
        if not all(map(math.isfinite, pose)):
            raise RecordingError(f"a pose that is not finite: {pose}")
        last = self._last.get(name)
        if last is not None and stamp <= last:
            raise RecordingError(f"time goes back from {last / 1e9:.9f} s to {stamp / 1e9:.9f} s")
        self._last[name] = stamp
        poses[stamp] = pose
        self._files[name].write(tum_row(stamp / NANOSECONDS, *pose))

    def _write_pair(self, stamp: int) -> None:
        if stamp in self._perfect and stamp in self._noisy:
            self._files[self.PAIRS].write(self._pair_row(stamp))

    def _pair_row(self, stamp: int) -> str:
        return csv_row(stamp / NANOSECONDS, self._perfect[stamp], self._noisy[stamp])

    def _paired_stamps(self) -> List[int]:
        return sorted(self._perfect.keys() & self._noisy.keys())

    @staticmethod
    def _tum_rows(poses: Dict[int, PlanarPose]) -> List[str]:
        return [tum_row(stamp / NANOSECONDS, *poses[stamp]) for stamp in sorted(poses)]


def _trajectory(poses: Dict[int, PlanarPose], stamps: List[int]) -> Optional[Trajectory]:
    if not stamps:
        return None
    return Trajectory([s / NANOSECONDS for s in stamps], [poses[s] for s in stamps])
