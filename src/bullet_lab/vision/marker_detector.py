"""Detector of a dictionary's markers in an image, including markers inside markers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Iterable, Sequence

import cv2
import numpy as np
from numpy import ndarray

from bullet_lab.core.parameters import (
    ParameterError,
    boolean,
    check_parameters,
    checked,
    choice,
    number,
)
from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.vision import images
from bullet_lab.vision.candidates import CandidateSearch, quads_in_cells
from bullet_lab.vision.dictionaries import (
    DICTIONARY_NAMES,
    Match,
    decode,
    dictionary_named,
    may_be_markers,
    refined,
)
from bullet_lab.vision.images import (
    Picture,
    VisionError,
    mean_side,
)
from bullet_lab.vision.pattern_fit import PatternFit, fit_pattern
from bullet_lab.vision.pattern_pixels import without_hidden_side

# Most quadrilaterals that are tried, the largest first. Of one that was found several times, at
# most so many versions are.
_MOST_QUADS = 60
_TRIES = 3
# Share of the border's cells that may be misread.
_BORDER_RATE = 0.1
# Least correlation of grey levels and pattern.
_LEAST_LIKENESS = 0.6
# Standard deviation of noise, grey levels, above which the image is smoothed, and the factor by
# which smoothing lessens it.
_CLEAN = 0.6
_SMOOTHED = 0.37
# Grey levels that an image should use, and the fewest that are spread to that.
_RANGE = 160.0
_LEAST_RANGE = 20.0
# Least contrast: standard deviations of noise, and grey levels.
_CONFIDENCE = 9.0
_LEAST_CONTRAST = 6.0
# Outlines of one id are of one marker if their sizes are within this factor, and their middles
# within this part of the smaller one's side.
_ONE_MARKER = 1.5
_BESIDE = 0.25
# An image with less between its darkest and its brightest pixel is uniform, grey levels; one with
# a mean below or above these is dark or over-exposed.
_FLAT = 12.0
_DARK = 12.0
_BRIGHT = 243.0
# Standard deviation of corners that follow from the outline alone: px, and part of a side.
_UNSURE = 0.3
_UNSURE_PART = 0.05
# How corners are refined, and the standard deviation of corners that are not fitted to the pattern,
# px. That of the corners of boards before a real camera is 0.2 and 0.6.
REFINEMENTS = ("pattern", "corners", "none")
_DEVIATIONS = {"corners": 0.15, "none": 0.5}


def _accept_tags(value: Any) -> str:
    """Return the name of a dictionary in OpenCV; raises ValueError."""
    try:
        return dictionary_named(value if isinstance(value, str) else "").name
    except VisionError as error:
        raise ValueError(str(error)) from error


def _accept_ids(value: Any) -> tuple[int, ...]:
    """Return the ids of "0 5", [0, 5] or 0; raises ValueError or TypeError."""
    parts = value.split() if isinstance(value, str) else value
    parts = parts if isinstance(parts, (list, tuple)) else [parts]
    if any(isinstance(part, (bool, float)) or int(part) < 0 for part in parts):
        raise ValueError
    return tuple(map(int, parts))


@dataclass(frozen=True)
class DetectorSettings:
    """Settings of a detector, which are parameters of the node aruco.

    Raises:
        ParameterError: one is not allowed, or the dictionary has no marker of an id.
    """

    tags: str = checked(
        "DICT_APRILTAG_36h10",
        "dictionary of the markers",
        "one of " + ", ".join(name[5:].lower() for name in DICTIONARY_NAMES),
        _accept_tags,
    )
    ids: tuple[int, ...] = checked(
        (), "markers to report; none: all", "ids with spaces between them", _accept_ids
    )
    border: float = number(3.0, "px to the edge of the image; nearer markers are cropped", 0.0)
    min_side: float = number(8.0, "edge of the smallest marker, px", 5.0)
    contrast: float = number(
        7.0, "least difference of black and white in grey levels", 0.0, maximum=255.0
    )
    correction: float = number(0.5, "share of the correctable bits to correct", 0.0, maximum=1.0)
    inverted: bool = boolean(False, "find white markers on black as well")
    second_pass: bool = boolean(True, "search once more if no marker is found")
    refine: str = choice(
        REFINEMENTS[0], "what corners follow from: all edges, sides, or thresholds", REFINEMENTS
    )

    def __post_init__(self) -> None:
        """Check the values."""
        check_parameters(self)
        count = len(dictionary_named(self.tags).codes)
        wrong = [marker for marker in self.ids if marker >= count]
        if wrong:
            known = f"its ids are 0 to {count - 1}"
            raise ParameterError(f"{self.tags} has no marker {wrong[0]}; {known}")


@dataclass(frozen=True)
class DetectedMarker:
    """A marker in an image.

    Its corners are (4, 2) u, v in px of the image, with its distortion: top left, top right,
    bottom right, bottom left of the black square, as one looks at the marker.
    """

    id: int  #: its number in the dictionary
    corners: ndarray
    bit_errors: int  #: bits that were corrected
    likeness: float  #: correlation of the grey levels with its pattern
    covariance: ndarray  #: (8, 8) of the corners' u0, v0, u1 ... by this image, px²

    @property
    def deviations(self) -> ndarray:
        """Standard deviations (4, 2) of the corners' u and v, px."""
        return np.sqrt(np.diag(self.covariance)).reshape(4, 2)

    @property
    def side(self) -> float:
        """Mean length of its sides in px."""
        return float(mean_side(self.corners))


@dataclass(frozen=True)
class DetectionReport:
    """Statistics of a detection, to explain why nothing was found."""

    mean: float  #: of the grey levels
    contrast: float  #: grey levels between its darkest and its brightest pixel
    noise: float  #: standard deviation of the grey levels' noise
    quads: int = 0  #: dark quadrilaterals that were tried
    undecoded: int = 0  #: number of them that are no marker
    cropped: Sequence[int] = ()  #: ids dropped at the edge of the image
    other_ids: Sequence[int] = ()  #: ids seen and not asked for
    second_pass: bool = False  #: whether the image was searched twice


@dataclass(frozen=True)
class Detections:
    """All markers of an image, the largest first, and the report."""

    markers: Sequence[DetectedMarker]
    report: DetectionReport


class MarkerDetector:
    """Finds markers."""

    def __init__(self, settings: DetectorSettings | None = None):
        self.settings = settings or DetectorSettings()
        self.dictionary = dictionary_named(self.settings.tags)
        self._correction = int(self.settings.correction * self.dictionary.max_correction + 1e-9)
        self._border_errors = int(_BORDER_RATE * 4 * (self.dictionary.cells + 1))

    def detect(self, image: ndarray, camera: PinholeCamera | None = None) -> Detections:
        """Return the markers in an image, (h, w) grey levels or (h, w, 3) BGR, uint8.

        Of the camera only the distortion is used, to have straight edges straight. Raises
        VisionError if it is no such image.
        """
        grey = images.grey(image)
        detections = self._detect(Picture(grey, camera))
        if not self.settings.inverted:
            return detections
        negative = self._detect(Picture(255 - grey, camera))
        both = sorted((*detections.markers, *negative.markers), key=lambda one: -one.side)
        return Detections(both, (detections if detections.markers else negative).report)

    def _detect(self, picture: Picture) -> Detections:
        grey = picture.levels
        low, high = float(grey.min()), float(grey.max())
        report = DetectionReport(float(cv2.mean(grey)[0]), high - low, noise_level(grey))
        smooth, least = _prepare(grey, low, high, report.noise)
        search = CandidateSearch(smooth, self.settings.min_side)
        quads = search.first_pass(max(least, self.settings.contrast))
        found = self._markers(picture, quads, report)
        if found.markers or not self.settings.second_pass:
            return found
        report = replace(report, second_pass=True)
        found = self._markers(picture, search.second_pass(least), report)
        if found.report.undecoded < found.report.quads:
            return found
        last = self._markers(picture, search.open_pass(least), report)
        # Hulls that are no marker are not worth reporting.
        return last if last.report.undecoded < last.report.quads else found

    def _markers(self, picture: Picture, quads: ndarray, report: DetectionReport) -> Detections:
        """Return the markers among quadrilaterals (n, 4, 2), and complete the report."""
        outlines = self._outlines(picture, quads)
        decoded = self._first_decoded(picture, outlines)
        cropped, other_ids, markers = [], [], []
        border, (height, width) = self.settings.border, picture.levels.shape
        largest = np.array((width, height)) - 1 - border
        for match in self._different(picture, decoded):
            corners = picture.seen(match.corners)
            if self.settings.ids and match.marker not in self.settings.ids:
                other_ids.append(match.marker)
            elif not ((corners >= border) & (corners <= largest)).all():
                cropped.append(match.marker)
            else:
                markers.append(self._measured(match, picture))
        tried, undecoded = len(outlines), len(outlines) - len(decoded)
        seen = {"quads": tried, "undecoded": undecoded, "cropped": cropped, "other_ids": other_ids}
        return Detections(markers, replace(report, **seen))

    def _different(self, picture: Picture, matches: Sequence[Match]) -> list[Match]:
        """Return each marker once, and other markers in their white cells."""
        found: list[Match] = []
        for match in matches:
            add_match(match, found)
        for outer in found[:]:
            pattern = self.dictionary.pattern(outer.marker)
            known = np.array([one.corners for one in found])
            inner = quads_in_cells(
                picture, outer.corners, pattern, self.settings.min_side, known
            )
            for match in self._decoded(picture, inner).values():
                add_match(match, found)
        return found

    def _outlines(self, picture: Picture, quads: ndarray) -> list[ndarray]:
        """Return up to `_TRIES` versions (k, 4, 2) of each outline among (n, 4, 2), largest first.

        Versions that cannot be a marker are left out.
        """
        if not len(quads):
            return []
        sides = mean_side(quads)
        order = np.argsort(-sides, kind="stable")
        quads, sides = quads[order], sides[order]
        likely = may_be_markers(picture, quads, self.dictionary.cells)
        same = _same_quads(quads, sides)
        outlines: list[ndarray] = []
        left = np.ones(len(quads), dtype=bool)
        while left.any() and len(outlines) < _MOST_QUADS:
            versions = same[left.argmax()] & left
            left &= ~versions
            outlines.append(quads[versions & likely][:_TRIES])
        return outlines

    def _first_decoded(self, picture: Picture, outlines: Sequence[ndarray]) -> list[Match]:
        """Return the marker of the first version of each outline that is a marker."""
        found: dict[int, Match] = {}
        for attempt in range(_TRIES):
            left = [k for k, one in enumerate(outlines) if k not in found and attempt < len(one)]
            decoded = self._decoded(picture, np.array([outlines[k][attempt] for k in left]))
            found.update((left[index], match) for index, match in decoded.items())
        return [found[k] for k in sorted(found)]

    def _decoded(self, picture: Picture, quads: ndarray) -> dict[int, Match]:
        """Return the markers among (n, 4, 2) quadrilaterals, px, by their indices."""
        if not len(quads):
            return {}
        if self.settings.refine != "none":
            quads = refined(picture, quads, self.dictionary.cells + 2)
        else:
            quads = picture.ideal(quads)
        found = decode(picture, quads, self.dictionary, self._correction, self._border_errors)
        return {index: match for index, match in found if match.likeness >= _LEAST_LIKENESS}

    def _measured(self, match: Match, picture: Picture) -> DetectedMarker:
        fit = self._fit(match, picture)
        by_ideal = picture.derivatives(fit.corners)
        covariance = by_ideal @ fit.covariance @ by_ideal.T
        seen = picture.seen(fit.corners)
        return DetectedMarker(match.marker, seen, match.errors, match.likeness, covariance)


    def _fit(self, match: Match, picture: Picture) -> PatternFit:
        if self.settings.refine != "pattern":
            spread = _DEVIATIONS[self.settings.refine]
            return PatternFit(match.corners, spread**2 * np.eye(8))
        pattern = self.dictionary.pattern(match.marker)
        corners = without_hidden_side(picture, match.corners, pattern)
        fit = fit_pattern(picture, corners, pattern)
        if fit is None:
            # The pattern does not explain the image, so the outline is not reliable either.
            spread = max(_UNSURE, _UNSURE_PART * mean_side(corners))
            fit = PatternFit(corners, spread**2 * np.eye(8), 1.0)
        return fit


def _same_quads(quads: ndarray, sides: ndarray) -> ndarray:
    """Return which (n, n) of (n, 4, 2) quadrilaterals are the same to a fraction of a cell.

    Their middles and the mean lengths of their sides, `sides` (n,), agree.
    """
    middles = quads.mean(axis=1)
    away = np.abs(middles[:, None] - middles).max(axis=2)
    larger = np.abs(sides[:, None] - sides)
    # A marker's white surroundings on a bright ground are a dark square one cell larger.
    return np.maximum(away, larger) < (1.0 + 0.04 * sides)[:, None]


def add_match(match: Match, found: list[Match]) -> None:
    """Add a marker; of two outlines of one marker, keep the one that looks more like it.

    A panel before a bright sky has an outline too, about as large as its marker's.
    """
    for index, other in enumerate(found):
        if _is_same_marker(match, other):
            if match.likeness > other.likeness:
                found[index] = match
            return
    found.append(match)


def _is_same_marker(first: Match, second: Match) -> bool:
    if first.marker != second.marker:
        return False
    small, large = sorted((mean_side(first.corners), mean_side(second.corners)))
    away = np.linalg.norm(first.corners.mean(axis=0) - second.corners.mean(axis=0))
    return bool(large < _ONE_MARKER * small and away < _BESIDE * small)


def _prepare(grey: ndarray, low: float, high: float, noise: float) -> tuple[ndarray, float]:
    """Return the image with more contrast and less noise, and the least contrast to look for."""
    gain = max(1.0, _RANGE / max(_LEAST_RANGE, high - low))
    if gain > 1.0:
        middle = 0.5 * (low + high)
        table = np.clip(gain * (np.arange(256) - middle) + 127.5, 0.0, 255.0)
        grey = cv2.LUT(grey, np.rint(table).astype(np.uint8))
    if noise > _CLEAN:
        grey, noise = cv2.GaussianBlur(grey, (3, 3), 0), _SMOOTHED * noise
    return grey, max(_LEAST_CONTRAST, _CONFIDENCE * gain * noise)


def noise_level(grey: ndarray) -> float:
    """Return the standard deviation of an image's noise, in grey levels.

    It follows from the median of second differences both ways, which are zero in uniform areas and
    on straight edges (Immerkaer 1996, with the median in place of the mean).
    """
    last = len(grey) - 2
    up, row, down = (grey[k : last + k : 12].astype(np.int16) for k in (0, 1, 2))
    vertical = up - 2 * row + down
    both = np.abs(vertical[:, :-2] - 2 * vertical[:, 1:-1] + vertical[:, 2:]).ravel()
    counts = np.cumsum(np.bincount(both))
    middle = int(np.searchsorted(counts, 0.5 * both.size))
    if middle == 0:
        return 0.0
    # Interpolated, as levels are whole numbers: counts are of |d| < middle + 0.5.
    below = counts[middle - 1]
    median = middle - 0.5 + (0.5 * both.size - below) / (counts[middle] - below)
    return float(median) / (0.6745 * 6.0)


def why_nothing(report: DetectionReport, dictionary: str) -> str:
    """Return one line on why the markers that were asked for are not in an image."""
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
