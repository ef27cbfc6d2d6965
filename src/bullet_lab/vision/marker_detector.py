"""Detector of the markers of a dictionary in an image, nested and double ones too."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Iterable, List, Optional, Sequence, Tuple

import cv2
import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.vision import images
from bullet_lab.vision.dictionaries import (
    Match,
    dictionary_named,
    interpret,
    match,
    may_be_markers,
    read_cells,
)
from bullet_lab.vision.images import Lens, VisionError
from bullet_lab.vision.outlines import OutlineSearch, mean_side, mean_sides, same_quads
from bullet_lab.vision.pattern_fit import PatternFit, fit_pattern
from bullet_lab.vision.pattern_sides import without_hidden_side
from bullet_lab.vision.quads import quads_in_cells, refine_corners

# A quadrilateral that was found with several windows is tried in so many of its versions.
_TRIES = 3
# Standard deviation of noise, in grey levels, from which on the image is smoothed.
_CLEAN = 0.6
# Grey levels that an image should use, and by how much they may be spread for it.
_RANGE = 160.0
_LARGEST_GAIN = 8.0
# What smoothing leaves of it.
_SMOOTHED = 0.37
# Standard deviations of noise, and grey levels, by which white is brighter than black.
_CONFIDENCE = 9.0
_LEAST_CONTRAST = 6.0
# Outlines of one id are of one marker if their sizes are within this factor, and their middles
# within this part of the smaller one's side.
_ONE_MARKER, _BESIDE = 1.5, 0.25

# Grey levels: an image with less between its darkest and brightest pixel shows nothing, and
# one whose mean is nearer than this to black or white shows little.
_FLAT = 12.0
_DARK = 12.0
_BRIGHT = 243.0
# Standard deviation of corners that only the outline tells of: px, and part of a side.
_UNSURE, _UNSURE_PART = 0.3, 0.05
# Limits of the settings.
_ALLOWED = {
    "border": (0.0, 1000.0),
    "min_side": (5.0, 1e4),
    "contrast": (0.0, 255.0),
    "correction": (0.0, 1.0),
    "border_rate": (0.0, 0.5),
    "likeness": (0.0, 1.0),
    "max_quads": (1, 10000),
}
# A marker and its corners, (4, 2) ideal px from its top left on.
Decoded = Tuple[Match, np.ndarray]


@dataclass(frozen=True)
class DetectorSettings:
    """Settings of a detector: what to look for, and how."""

    dictionary: str = "apriltag_36h10"  #: as `dictionary_named` takes it
    ids: Tuple[int, ...] = ()  #: markers to report; empty: all of the dictionary
    border: float = 3.0  #: px; what has a corner nearer to the edge of the image is dropped
    min_side: float = 8.0  #: px; mean side of the smallest marker that is looked for
    contrast: float = 7.0  #: grey levels by which black is darker than white
    correction: float = 0.5  #: part of the bits that could be corrected which is corrected
    border_rate: float = 0.1  #: part of the border's cells that may be misread
    likeness: float = 0.6  #: least correlation of grey levels and pattern
    max_quads: int = 60  #: at most so many quadrilaterals are tried, the largest first
    inverted: bool = False  #: find white markers on black as well
    second_pass: bool = True  #: look again, with other thresholds, where nothing was found

    def __post_init__(self) -> None:
        """Raise VisionError where a setting is not allowed."""
        for name, (low, high) in _ALLOWED.items():
            value = getattr(self, name)
            if not math.isfinite(value) or not low <= value <= high:
                raise VisionError(f"{name} is {value}: it must be from {low:g} to {high:g}")
        count = len(dictionary_named(self.dictionary).codes)
        wrong = [marker for marker in self.ids if not 0 <= marker < count]
        if wrong:
            raise VisionError(f"{self.dictionary} has no marker {wrong[0]}, only 0 to {count - 1}")


@dataclass(frozen=True)
class DetectedMarker:
    """A marker in an image.

    Its corners are (4, 2) u, v in px of the image as it is, with its distortion: top left, top
    right, bottom right, bottom left of the black square, as one looks at the marker.
    """

    id: int  #: which of the dictionary
    corners: np.ndarray
    bit_errors: int  #: bits that were corrected
    likeness: float  #: correlation of the grey levels with its pattern
    covariance: np.ndarray  #: (8, 8) of the corners' u0, v0, u1 ... as the image tells it, px²

    @property
    def deviations(self) -> np.ndarray:
        """Standard deviations (4, 2) of the corners' u and v, px."""
        return np.sqrt(np.diag(self.covariance)).reshape(4, 2)

    @property
    def side(self) -> float:
        """Mean length of its sides in px."""
        return mean_side(self.corners)


@dataclass
class DetectionReport:
    """What happened on the way, to say why nothing was found."""

    quads: int = 0  #: dark quadrilaterals that were tried
    undecoded: int = 0  #: of them, those that are no marker
    cropped: List[int] = field(default_factory=list)  #: ids dropped at the edge of the image
    other_ids: List[int] = field(default_factory=list)  #: ids seen and not asked for
    mean: float = 0.0  #: of the grey levels
    contrast: float = 0.0  #: grey levels between its darkest and its brightest pixel
    noise: float = 0.0  #: standard deviation of the grey levels' noise
    second_pass: bool = False  #: whether the image was looked at twice


@dataclass(frozen=True)
class Detections:
    """All markers of an image, the largest first, and what happened on the way."""

    markers: Sequence[DetectedMarker]
    report: DetectionReport


class MarkerDetector:
    """Finds markers."""

    def __init__(self, settings: Optional[DetectorSettings] = None):
        self.settings = settings or DetectorSettings()
        self.dictionary = dictionary_named(self.settings.dictionary)
        self._correction = int(self.settings.correction * self.dictionary.max_correction + 1e-9)
        self._border_errors = int(self.settings.border_rate * 4 * (self.dictionary.cells + 1))

    def detect(self, image: np.ndarray, camera: Optional[PinholeCamera] = None) -> Detections:
        """Return the markers in an image, (h, w) grey levels or (h, w, 3) BGR, uint8.

        Of the camera only the distortion is used, to have straight edges straight. Raises
        VisionError for what is no such image.
        """
        grey = images.grey(image)
        lens = Lens(camera)
        detections = self._detect(grey, lens)
        if not self.settings.inverted:
            return detections
        negative = self._detect(255 - grey, lens)
        both = sorted((*detections.markers, *negative.markers), key=lambda one: -one.side)
        return Detections(both, (detections if detections.markers else negative).report)

    def _detect(self, grey: np.ndarray, lens: Lens) -> Detections:
        report = DetectionReport()
        low, high = float(grey.min()), float(grey.max())
        report.mean, report.contrast = float(cv2.mean(grey)[0]), high - low
        report.noise = noise_level(grey)
        smooth, least = _prepare(grey, low, high, report.noise)
        search = OutlineSearch(smooth, self.settings.min_side)
        quads = search.first_look(max(least, self.settings.contrast))
        markers = self._look(grey, quads, lens, report)
        if not markers and self.settings.second_pass:
            report.second_pass = True
            markers = self._look(grey, search.second_look(least), lens, report)
            if report.undecoded == report.quads:
                # Hulls of anything are no quadrilaterals to report.
                last = replace(report)
                markers = self._look(grey, search.last_look(least), lens, last)
                report = last if last.undecoded < last.quads else report
        return Detections(markers, report)

    def _look(
        self, image: np.ndarray, quads: np.ndarray, lens: Lens, report: DetectionReport
    ) -> List[DetectedMarker]:
        quads, versions = self._likely(image, quads, lens, report)
        found: List[Decoded] = []
        report.cropped, report.other_ids = [], []
        for one in self._first_decoded(image, quads, versions, lens):
            if one is None:
                report.undecoded += 1
            else:
                add_decoded(one, found)
        # Other markers may be in their white cells.
        for read, corners in found[:]:
            pattern = self.dictionary.pattern(read.marker)
            size = mean_side(corners)
            others = [other for _, other in found if mean_side(other) < size]
            least = self.settings.min_side
            inner = quads_in_cells(image, corners, pattern, lens, least, others)
            for one in self._decode(image, inner, lens):
                if one is not None:
                    add_decoded(one, found)
        return self._choose(found, image, lens, report)

    def _likely(
        self, image: np.ndarray, quads: np.ndarray, lens: Lens, report: DetectionReport
    ) -> Tuple[np.ndarray, List[range]]:
        """Return those (n, 4, 2) that may be markers, and which are one and the same.

        The largest come first. In the report, those that cannot be markers are counted.
        """
        settings = self.settings
        report.quads = report.undecoded = 0
        if not len(quads):
            return quads, []
        sides = mean_sides(quads)
        order = np.argsort(-sides, kind="stable")
        quads, sides = quads[order], sides[order]
        likely = may_be_markers(image, quads, self.dictionary.cells, lens)
        same = same_quads(quads, sides)
        versions, done = [], np.zeros(len(quads), dtype=bool)
        chosen: List[int] = []
        for index in range(len(quads)):
            if done[index]:
                continue
            if report.quads == settings.max_quads:
                break
            alike = same[index] & ~done
            done |= alike
            report.quads += 1
            tried = np.flatnonzero(alike & likely)[:_TRIES].tolist()
            if tried:
                versions.append(range(len(chosen), len(chosen) + len(tried)))
                chosen += tried
            else:
                report.undecoded += 1
        return quads[chosen], versions

    def _first_decoded(
        self, image: np.ndarray, quads: np.ndarray, versions: Sequence[range], lens: Lens
    ) -> List[Optional[Decoded]]:
        """Return the marker that the first of each one's versions that is any tells, or None."""
        found: List[Optional[Decoded]] = [None] * len(versions)
        for attempt in range(_TRIES):
            left = [k for k, same in enumerate(versions) if not found[k] and attempt < len(same)]
            tried = quads[[versions[k][attempt] for k in left]] if left else quads[:0]
            for k, one in zip(left, self._decode(image, tried, lens)):
                found[k] = one
        return found

    def _decode(self, image: np.ndarray, quads: np.ndarray, lens: Lens) -> List[Optional[Decoded]]:
        """Return the marker that each of (n, 4, 2) quadrilaterals, px, is, or None."""
        cells = self.dictionary.cells
        if not len(quads):
            return []
        corners = refine_corners(image, quads, cells + 2, lens)
        sound = np.flatnonzero(np.isfinite(corners).all(axis=(1, 2)))
        decoded: List[Optional[Decoded]] = [None] * len(quads)
        readings = interpret(read_cells(image, corners[sound], cells, lens))
        for index, reading in zip(sound.tolist(), readings):
            if reading is None or reading.border_errors > self._border_errors:
                continue
            found = match(reading, self.dictionary, self._correction)
            if found is not None and found.likeness >= self.settings.likeness:
                decoded[index] = found, np.roll(corners[index], found.turns, axis=0)
        return decoded

    def _choose(
        self,
        found: List[Decoded],
        image: np.ndarray,
        lens: Lens,
        report: DetectionReport,
    ) -> List[DetectedMarker]:
        """Return what was asked for and is whole, measured as well as can be."""
        border, chosen = self.settings.border, []
        largest = np.array(image.shape[::-1]) - 1 - border
        for read, ideal in found:
            corners = lens.seen(ideal)
            if self.settings.ids and read.marker not in self.settings.ids:
                report.other_ids.append(read.marker)
            elif not ((corners >= border) & (corners <= largest)).all():
                report.cropped.append(read.marker)
            else:
                chosen.append(self._measured(read, ideal, image, lens))
        return chosen

    def _measured(
        self, read: Match, corners: np.ndarray, image: np.ndarray, lens: Lens
    ) -> DetectedMarker:
        pattern = self.dictionary.pattern(read.marker)
        corners = without_hidden_side(image, corners, pattern, lens)
        fit = fit_pattern(image, corners, pattern, lens)
        if fit is None:
            # What is there is not as the pattern says: its outline alone is not to be relied on.
            spread = max(_UNSURE, _UNSURE_PART * mean_side(corners))
            fit = PatternFit(corners, spread**2 * np.eye(8), 1.0)
        turn = lens.derivatives(fit.corners)
        covariance = turn @ fit.covariance @ turn.T
        return DetectedMarker(
            read.marker, lens.seen(fit.corners), read.errors, read.likeness, covariance
        )


def add_decoded(decoded: Decoded, found: List[Decoded]) -> None:
    """Add a marker; of two outlines of one marker, the one that looks more like it stays.

    A panel before a bright sky has an outline of its own, about as large as its marker's.
    """
    for index, other in enumerate(found):
        if _same_marker(decoded, other):
            if decoded[0].likeness > other[0].likeness:
                found[index] = decoded
            return
    found.append(decoded)


def _same_marker(first: Decoded, second: Decoded) -> bool:
    if first[0].marker != second[0].marker:
        return False
    sides = mean_side(first[1]), mean_side(second[1])
    away = np.linalg.norm(first[1].mean(axis=0) - second[1].mean(axis=0))
    return max(sides) < _ONE_MARKER * min(sides) and bool(away < _BESIDE * min(sides))


def _prepare(grey: np.ndarray, low: float, high: float, noise: float) -> Tuple[np.ndarray, float]:
    """Return the image with its full range used and less noise, and the least contrast there."""
    gain = float(np.clip(_RANGE / max(1.0, high - low), 1.0, _LARGEST_GAIN))
    if gain > 1.0:
        middle = 0.5 * (low + high)
        table = np.clip(gain * (np.arange(256) - middle) + 127.5, 0.0, 255.0)
        grey = cv2.LUT(grey, np.rint(table).astype(np.uint8))
    if noise > _CLEAN:
        grey, noise = cv2.GaussianBlur(grey, (3, 3), 0), _SMOOTHED * noise
    return grey, max(_LEAST_CONTRAST, _CONFIDENCE * gain * noise)


def noise_level(grey: np.ndarray) -> float:
    """Return the standard deviation of an image's noise, in grey levels.

    From the median of second differences both ways, which are zero on even ground and on
    straight edges (Immerkaer 1996, with the median in place of the mean).
    """
    last = len(grey) - 2
    up, row, down = (grey[k : last + k : 12].astype(np.int16) for k in (0, 1, 2))
    vertical = up - 2 * row + down
    both = np.abs(vertical[:, :-2] - 2 * vertical[:, 1:-1] + vertical[:, 2:]).ravel()
    counts = np.cumsum(np.bincount(both, minlength=2))
    middle = int(np.searchsorted(counts, 0.5 * both.size))
    # Interpolated, as levels are whole numbers: |d| < middle + 0.5 has the share reached there.
    below = counts[middle - 1] if middle else 0
    if middle == 0:
        return 0.0
    median = middle - 0.5 + (0.5 * both.size - below) / (counts[middle] - below)
    return float(median) / (0.6745 * 6.0)


def why_nothing(report: DetectionReport, dictionary: str) -> str:
    """Return one line on why an image has none of the markers that were asked for."""
    if report.cropped:
        return f"{_markers(report.cropped)} cut off by the edge of the image"
    if report.other_ids:
        return f"not the one asked for, but {_markers(report.other_ids)} seen"
    if report.contrast < _FLAT:
        return f"the image is flat: all within {report.contrast:.0f} of 255 grey levels"
    light = ""
    if report.mean < _DARK:
        light = f", and the image is dark (mean {report.mean:.0f})"
    elif report.mean > _BRIGHT:
        light = f", and the image is over-exposed (mean {report.mean:.0f})"
    if not report.quads:
        return f"no dark quadrilateral in sight{light}"
    return f"{report.quads} dark quadrilaterals in sight, none is a marker of {dictionary}{light}"


def _markers(ids: Iterable[int]) -> str:
    each = sorted(set(ids))
    return f"marker{'s' if len(each) > 1 else ''} {', '.join(map(str, each))}"
