"""The sides and corners of a path made of straight drives and turns on the spot."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bullet_lab.numerics.metrics import closure_error
from bullet_lab.numerics.trajectory import Trajectory

TURNING_RADIUS = 0.1
"""m; a message is part of a drive if the curve it lies on is at least this wide."""

MIN_SIDE = 0.05
"""m; a shorter drive is no side but a disturbance of the turns beside it."""

MIN_TURN = math.radians(5.0)
"""rad; a smaller turn is no corner but a disturbance of the drives beside it."""

MIN_STRAIGHTNESS = 0.9
"""Distance between the ends of a side over the way driven; below, the path is a curve."""


@dataclass(frozen=True)
class SquarePath:
    """What a path of straight drives and turns on the spot is made of.

    Attributes:
        side_lengths_m: distance between the ends of each side, in the order driven.
        turns_deg: heading change after each side, unwrapped, as a magnitude: clockwise and
            counter-clockwise look the same. One less than the sides if the path ends on a side.
        closure_error_m: distance from the start of the path to its end.
    """

    side_lengths_m: list[float]
    turns_deg: list[float]
    closure_error_m: float


def analyse(trajectory: Trajectory) -> SquarePath:
    """Cut a path into its sides and the turn after each.

    Rests belong to what they interrupt, and so do crawls and stray messages: only drives of at
    least `MIN_SIDE` and turns of at least `MIN_TURN` count. A path that stops half way gives as
    many sides and turns as it has; one that does not move or is not made of straight drives
    gives none.
    """
    positions = trajectory.poses[:, :2]
    headings = np.unwrap(trajectory.poses[:, 2])
    drives, turns = _cut(positions, headings)
    if not all(_is_straight(positions[start : end + 1]) for start, end in drives):
        drives, turns = [], []
    # The message in which a drive and a turn meet has a share of both, hence one more at each
    # end; of a message that is all drive or all turn this adds nothing to the other.
    last = len(trajectory) - 1
    return SquarePath(
        [
            float(np.hypot(*(positions[min(end + 1, last)] - positions[max(start - 1, 0)])))
            for start, end in drives
        ],
        [
            float(np.degrees(abs(headings[min(end + 1, last)] - headings[start - 1])))
            for start, end in turns
        ],
        closure_error(trajectory),
    )


def _cut(positions: np.ndarray, headings: np.ndarray):
    """Return the drives, and the turns after the first of them, as pairs of pose indices."""
    ways = np.hypot(*np.diff(positions, axis=0).T)
    is_drive = ways >= TURNING_RADIUS * np.abs(np.diff(headings))
    if not is_drive.size:
        return [], []
    edges = np.concatenate([[0], np.flatnonzero(np.diff(is_drive)) + 1, [is_drive.size]])
    first_is_drive = bool(is_drive[0])

    # Pieces alternate. The least significant one is given to its neighbours, which become one
    # piece then, until all that are left matter.
    while True:
        drive = (np.arange(len(edges) - 1) % 2 == 0) == first_is_drive
        distance = np.hypot(*np.diff(positions[edges], axis=0).T)
        turn = np.abs(np.diff(headings[edges]))
        significance = np.where(drive, distance / MIN_SIDE, turn / MIN_TURN)
        least = int(np.argmin(significance))
        if significance[least] >= 1.0:
            break
        if len(edges) == 2:
            return [], []
        if least == 0:
            first_is_drive = not first_is_drive
        inner = [edge for edge in (least, least + 1) if 0 < edge < len(edges) - 1]
        edges = np.delete(edges, inner)

    pieces = list(zip(edges[:-1].tolist(), edges[1:].tolist()))
    first_drive = 0 if first_is_drive else 1
    return pieces[first_drive::2], pieces[first_drive + 1 :: 2]


def _is_straight(positions: np.ndarray) -> bool:
    way = np.hypot(*np.diff(positions, axis=0).T).sum()
    return bool(np.hypot(*(positions[-1] - positions[0])) >= MIN_STRAIGHTNESS * way)
