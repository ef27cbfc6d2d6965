"""Markers in the pictures of a simulated camera, of which only the part that matters is drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bullet_lab.docking.types import Sighting
from bullet_lab.simulation.plugins.camera import Camera
from bullet_lab.simulation.plugins.lenses import Lens
from bullet_lab.vision.images import grey
from bullet_lab.vision.marker_detector import MarkerDetector

# Sizes of parts, px. They are few, as the renderer keeps a buffer for each of the last ones.
_SIZES = (64, 96, 128, 192, 256, 320, 416)
# Parts between two whole pictures.
_MOST_PARTS = 4
# What a part shows around the markers: px, and as a share of the largest marker's edge.
_AROUND, _AROUND_SHARE = 20.0, 0.2


class MarkerWatch:
    """Finds markers in the pictures of a camera without distortion.

    While they are in sight, a picture is only a part of a whole one: where they should be if they
    move on as between the two pictures before. Each fifth picture is a whole one, and so is one
    whose part does not show all of them. What comes into sight is found within a second.
    """

    def __init__(self, camera: Camera, detector: MarkerDetector, dictionary: str):
        self._camera, self._detector, self._dictionary = camera, detector, dictionary
        self._whole = camera.camera
        # Corners (n, 4, 2) in the last picture and in the one before, px.
        self._last = self._before = np.empty((0, 4, 2))
        self._parts = 0

    def look(self, step: int) -> tuple[Sighting, ...]:
        """Return the markers in the present picture; its noise depends on the step."""
        part = self._part() if len(self._last) and self._parts < _MOST_PARTS else None
        seen: tuple[Sighting, ...] = ()
        if part is not None:
            seen = self._find(step, *part)
            self._parts += 1
        if part is None or len(seen) < len(self._last):
            seen = self._find(step, np.zeros(2), (self._whole.width, self._whole.height))
            self._parts = 0
        self._before, self._last = self._last, np.array([one.corners for one in seen])
        return seen

    def _part(self) -> tuple[np.ndarray, tuple[int, int]] | None:
        """Return the first pixel and the size of the part to draw; None: all."""
        corners, whole = self._last, (self._whole.width, self._whole.height)
        if len(self._before) == len(corners):
            corners = corners + (corners - self._before).mean(axis=(0, 1))
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        around = _AROUND + _AROUND_SHARE * np.ptp(corners, axis=1).max()
        needed = (high - low).max() + 2.0 * around
        for size in _SIZES:
            if needed <= size <= min(whole):
                first = np.rint(0.5 * (low + high - size))
                return np.clip(first, 0, np.subtract(whole, size)), (size, size)
        return None

    def _find(self, step: int, first: np.ndarray, size: tuple[int, int]) -> tuple[Sighting, ...]:
        """Draw a part of the picture and return the markers in it, in px of the whole."""
        centre = np.array((self._whole.cx, self._whole.cy)) - first
        part = replace(self._whole, width=size[0], height=size[1], cx=centre[0], cy=centre[1])
        lens, self._camera.lens = self._camera.lens, Lens(part)
        picture = self._camera.take(step)
        self._camera.lens = lens
        found = self._detector.detect(grey(picture, "rgb8"), part).markers
        return tuple(
            Sighting(m.id, self._dictionary, m.corners + first, m.deviations) for m in found
        )
