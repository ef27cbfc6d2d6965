"""The report of the job `vision`: the results of all detectors for one image, as in figure 7."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any, Sequence

import cv2
import numpy as np

from bullet_lab.core.figures import new_figure
from bullet_lab.core.files import FileError, replace_file
from bullet_lab.reports import Figures, Report, Summary
from bullet_lab.vision.drawing import enlarged

# Topics of the pictures by the name of their detector, in the order of figure 7.
PICTURES = {
    "view_camera": "view_camera/image_annotated",
    "canny_edges": "canny_edges/edges",
    "good_features": "good_features/image_annotated",
    "harris_corners": "harris_corners/image_annotated",
    "aruco": "aruco/image_annotated",
}
FEATURES = ("good_features", "harris_corners")
DETECTIONS = "aruco/detections"
_COLUMNS = 3
_LINE_LENGTH = 58
# px; edge of the enlarged picture of the marker.
_ENLARGED = 480


class VisionReport(Report):
    """A picture of each detector, marker.png if a marker was found, and the results as text.

    Attributes:
        found: a line for each picture, once all results have come.
    """

    def __init__(self, folder: Path):
        super().__init__(folder)
        self.topics = {
            **dict.fromkeys(PICTURES.values(), "sensor_msgs/Image"),
            **{f"{name}/points": "bullet_lab/ImagePoints" for name in FEATURES},
            DETECTIONS: "bullet_lab/MarkerDetectionArray",
        }
        self.found: dict[str, str] = {}
        self._pictures: dict[str, np.ndarray] = {}

    def is_complete(self) -> bool:
        return len(self.readings) == len(self.topics)

    def finish(self, until: int | None = None) -> None:
        self._pictures = {name: self.readings[topic][-1].detail for name, topic in PICTURES.items()}
        self.found = self._found()
        if self._markers():
            corners = np.reshape(self._markers()[0].corners, (4, 2))
            self._pictures["marker"] = enlarged(self._pictures["view_camera"], corners, _ENLARGED)
            self.found["marker"] = "the marker, enlarged, and the outline that aruco found"
        for name, picture in self._pictures.items():
            replace_file(self.folder / f"{name}.png", lambda path, p=picture: _write(path, p))

    def summary(self, finished: bool, run: Summary) -> Summary:
        markers = [marker_figures(marker) for marker in self._markers()]
        return {"stamp_s": self._stamp_s(), "found": self.found, "markers": markers}

    def figures(self, summary: Summary) -> Figures:
        name = self.about.get("picture", f"{self._stamp_s():.3f} s")
        figure = new_figure(14.0, 8.6, f"The detectors on one image ({name})")
        rows = -(-len(self._pictures) // _COLUMNS)
        grid = figure.subplots(rows, _COLUMNS, squeeze=False)
        lines = [textwrap.fill(self.found[name], _LINE_LENGTH) for name in self._pictures]
        room = max(0.06, 0.025 + 0.018 * max(line.count("\n") + 1 for line in lines))
        figure.subplots_adjust(
            left=0.02, right=0.98, top=0.92, bottom=room, hspace=0.28, wspace=0.05
        )
        for axes in grid.ravel():
            axes.set_axis_off()
        for axes, (name, picture), line in zip(grid.ravel(), self._pictures.items(), lines):
            axes.imshow(picture[:, :, ::-1])
            axes.set_title(name, fontsize=11, fontweight="bold")
            axes.text(
                0.5, -0.03, line, fontsize=9, transform=axes.transAxes, va="top", ha="center"
            )
        return {"side_by_side.png": figure}

    def _stamp_s(self) -> float:
        return self.readings[PICTURES["view_camera"]][-1].seconds

    def _markers(self) -> Sequence[Any]:
        return self.readings[DETECTIONS][-1].detail

    def _found(self) -> dict[str, str]:
        """Return the result of each detector in one line, by its name."""
        view = self._pictures["view_camera"]
        height, width = view.shape[:2]
        grey = cv2.cvtColor(view, cv2.COLOR_BGR2GRAY)
        edges = int(np.count_nonzero(self._pictures["canny_edges"][:, :, 0]))
        points = {name: self.readings[f"{name}/points"][-1].detail for name in FEATURES}
        return {
            "view_camera": f"{width} x {height} px, mean grey level {grey.mean():.0f}",
            "canny_edges": f"{edges} edge pixels, {100.0 * edges / grey.size:.1f} % of the image",
            **{name: _points_line(found) for name, found in points.items()},
            "aruco": "; ".join(map(_marker_line, self._markers())) or "no marker",
        }


def marker_figures(marker: Any) -> Summary:
    """Return the entry of a bullet_lab/MarkerDetection in summary.json."""
    figures = {
        "id": marker.id,
        "dictionary": marker.dictionary,
        "corners_px": [list(marker.corners[k : k + 2]) for k in range(0, 8, 2)],
    }
    if not marker.size:
        return figures
    place = marker.pose.pose.position
    return {
        **figures,
        "position_m": [place.x, place.y, place.z],
        "reprojection_error_px": marker.reprojection_error,
        "ambiguous": marker.ambiguous,
    }


def _points_line(points: list[tuple[float, float]]) -> str:
    if not points:
        return "no corner"
    x, y = points[0]
    return f"{len(points)} corners, the strongest at ({x:.0f}, {y:.0f}) px"


def _marker_line(marker: Any) -> str:
    name = f"marker {marker.id} of {marker.dictionary}"
    if not marker.size:
        return f"{name}, no pose without camera_info"
    place = marker.pose.pose.position
    where = f"{place.z:.3f} m ahead, {place.x:.3f} m right, {place.y:.3f} m down"
    return f"{name}, {where}, to {marker.reprojection_error:.2f} px"


def _write(path: Path, picture: np.ndarray) -> None:
    if not cv2.imwrite(str(path), picture):
        raise FileError(f"cannot write {path}")
