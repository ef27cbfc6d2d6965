"""The detectors of figure 7 on a picture from a file, with the defaults of their nodes.

Example:
    bullet_lab detectors picture:=photo.jpg
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Sequence

import cv2
import numpy as np

from bullet_lab.core.parameters import choice, text
from bullet_lab.reports import Reading, save_all
from bullet_lab.reports.vision import DETECTIONS, FEATURES, PICTURES, VisionReport
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.studies.study import Settings, Tell, run_from
from bullet_lab.vision.dictionaries import DICTIONARY_NAMES, dictionary_named
from bullet_lab.vision.drawing import draw_area, draw_marker, draw_points, draw_text
from bullet_lab.vision.features import good_features, harris_corners
from bullet_lab.vision.images import VisionError, grey
from bullet_lab.vision.marker_detector import (
    REFINEMENTS,
    DetectorSettings,
    MarkerDetector,
    why_nothing,
)

WALL = "package://bullet_lab/models/docking_station/meshes/back_wall.png"


@dataclass(frozen=True)
class PictureSettings(Settings):
    """The picture, and the markers in it."""

    picture: str = text(WALL, "picture file, of any kind that OpenCV reads")
    tags: str = choice(
        "apriltag_36h10",
        "dictionary of the markers",
        [name[5:].lower() for name in DICTIONARY_NAMES],
    )
    refine: str = choice(
        REFINEMENTS[0], "what markers' corners follow from, as ~refine of aruco", REFINEMENTS
    )


@dataclass(frozen=True)
class FoundMarker:
    """A marker without a pose, as VisionReport reads it: corners u, v in px, (8,)."""

    id: int
    dictionary: str
    corners: Sequence[float]
    size: float = 0.0


def run_detectors(folder: Path, settings: PictureSettings) -> VisionReport:
    """Run all detectors; write their pictures, side_by_side.png and summary.json.

    Raises:
        LabError: the picture cannot be read, or the folder cannot be written to.
    """
    path = ResourceFinder.anywhere().find(settings.picture)
    report = VisionReport(folder)
    report.about = {"job": "detectors", "picture": path.name, "tags": settings.tags}
    for topic, detail in _answers(read_picture(path), settings).items():
        report.take(topic, Reading(0, (), detail))
    save_all(report, True)
    return report


def read_picture(path: Path) -> np.ndarray:
    """Return a picture, (h, w, 3) uint8 BGR; raises VisionError."""
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise VisionError(f"cannot read {path}: it must be a picture, such as PNG or JPEG")
    return picture


def _answers(picture: np.ndarray, settings: PictureSettings) -> dict[str, Any]:
    """Return the detail of each reading of VisionReport by its topic."""
    levels, tags = grey(picture), settings.tags
    drawn = {name: picture.copy() for name in PICTURES}
    drawn["canny_edges"] = cv2.cvtColor(cv2.Canny(levels, 100.0, 200.0), cv2.COLOR_GRAY2BGR)
    good = good_features(levels)
    draw_points(drawn["good_features"], good)
    area, corners = harris_corners(levels)
    draw_area(drawn["harris_corners"], area)
    found = MarkerDetector(DetectorSettings(tags, refine=settings.refine)).detect(levels)
    for marker in found.markers:
        draw_marker(drawn["aruco"], marker, f"id {marker.id}")
    if not found.markers:
        draw_text(drawn["aruco"], why_nothing(found.report, tags), (8, 16))
    name = dictionary_named(tags).name
    return {
        **{topic: drawn[detector] for detector, topic in PICTURES.items()},
        **{f"{one}/points": xy[:, :2].tolist() for one, xy in zip(FEATURES, (good, corners))},
        DETECTIONS: [FoundMarker(m.id, name, m.corners.ravel().tolist()) for m in found.markers],
    }


def _run(folder: Path, settings: PictureSettings, _tell: Tell) -> list[str]:
    found = run_detectors(folder, settings).found
    return [f"{name}: {line}" for name, line in found.items()]


main = functools.partial(run_from, "detectors", __doc__, (PictureSettings,), _run)
