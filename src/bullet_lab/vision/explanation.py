"""Says in words why no marker was found."""

from __future__ import annotations

from typing import Iterable

from bullet_lab.vision.marker_detector import DetectionReport

# Grey levels: an image with less between its darkest and brightest pixel shows nothing, and
# one whose mean is nearer than this to black or white shows little.
_FLAT = 12.0
_DARK = 12.0
_BRIGHT = 243.0


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
