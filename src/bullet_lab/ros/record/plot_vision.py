"""Saves what the five detectors make of one image, side by side as in figure 7, and ends.

:ROS Parameters: see `PlotVisionParameters`.
:ROS Subscribers:
    - view_camera/image_annotated, canny_edges/edges, good_features/image_annotated,
      harris_corners/image_annotated, aruco/image_annotated (sensor_msgs/Image)
    - good_features/points, harris_corners/points (bullet_lab/ImagePoints)
    - aruco/detections (bullet_lab/MarkerDetectionArray)

Leaves a picture for each detector, marker.png if there is one, side_by_side.png and summary.json.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional

import cv2
import numpy as np
import rospy
from sensor_msgs.msg import Image

from bullet_lab.core.figures import save
from bullet_lab.core.files import FileError, make_folder, replace_file, write_json
from bullet_lab.msg import ImagePoints, MarkerDetection, MarkerDetectionArray
from bullet_lab.reports.vision import vision_figure
from bullet_lab.ros.messages.images import pixels_of
from bullet_lab.ros.node import parameters
from bullet_lab.ros.node.lock_step import join_when
from bullet_lab.ros.node.node import NodeError, private_parameters, run_node
from bullet_lab.vision.drawing import enlarged

# Pictures by the name of their detector, in the order of figure 7.
PICTURES = {
    "view_camera": "view_camera/image_annotated",
    "canny_edges": "canny_edges/edges",
    "good_features": "good_features/image_annotated",
    "harris_corners": "harris_corners/image_annotated",
    "aruco": "aruco/image_annotated",
}
FEATURES = ("good_features", "harris_corners")
DETECTIONS = "aruco/detections"
# Wall seconds that results of one image are waited for, once there is one of each.
_PATIENCE = 5.0
_POLL_SECONDS = 0.02
# Edge of the picture of the marker alone, px.
_ENLARGED = 480


@dataclass(frozen=True)
class PlotVisionParameters:
    """Private parameters of plot_vision."""

    out: str = parameters.text("results/vision", "folder for the files")
    about: Mapping[str, Any] = parameters.mapping("what else summary.json shall say")
    settle: float = parameters.number(1.0, "simulated seconds before the image", minimum=0.0)
    timeout: float = parameters.number(90.0, "wall seconds to wait for all results", above=0.0)
    lock_step: bool = parameters.boolean(False, "tell the bridge when ready")


class PlotVision:
    """Brings the answers of all detectors to one image together."""

    def __init__(self, wanted: PlotVisionParameters):
        self._wanted = wanted
        self._lock = threading.Lock()
        self._answers: Dict[str, Dict[int, Any]] = {}
        self._subscribers: List[rospy.Subscriber] = []
        for topic in PICTURES.values():
            self._listen(topic, Image)
        for name in FEATURES:
            self._listen(f"{name}/points", ImagePoints)
        self._listen(DETECTIONS, MarkerDetectionArray)

    def is_connected(self) -> bool:
        """Return whether every topic has a publisher."""
        return all(subscriber.get_num_connections() > 0 for subscriber in self._subscribers)

    def wait(self) -> Mapping[str, Any]:
        """Return a message for each topic, those of one image if they come.

        Raises:
            NodeError: a topic brings nothing in the time allowed.
        """
        deadline = time.monotonic() + self._wanted.timeout
        whole_since: Optional[float] = None
        while not rospy.is_shutdown():
            with self._lock:
                stamps = set.intersection(*(set(by) for by in self._answers.values()))
                missing = [topic for topic, by in self._answers.items() if not by]
                if stamps:
                    return {topic: by[min(stamps)] for topic, by in self._answers.items()}
                if not missing and whole_since is None:
                    whole_since = time.monotonic()
                if whole_since is not None and time.monotonic() - whole_since > _PATIENCE:
                    rospy.logwarn("the detectors never answered the same image")
                    return {topic: by[max(by)] for topic, by in self._answers.items()}
            if time.monotonic() > deadline:
                what = ", ".join(missing) or "results of one image"
                raise NodeError(f"nothing on {what} within {self._wanted.timeout:g} s")
            time.sleep(_POLL_SECONDS)
        raise rospy.ROSInterruptException("shutdown")

    def finish(self, answers: Mapping[str, Any]) -> None:
        """Write all pictures and say what was found; raises FileError."""
        for subscriber in self._subscribers:
            subscriber.unregister()
        folder = make_folder(Path(self._wanted.out))
        pictures = {name: pixels_of(answers[topic], "bgr8") for name, topic in PICTURES.items()}
        lines = found_lines(answers, pictures)
        if answers[DETECTIONS].detections:
            corners = np.reshape(answers[DETECTIONS].detections[0].corners, (4, 2))
            pictures["marker"] = enlarged(pictures["view_camera"], corners, _ENLARGED)
            lines["marker"] = "the marker, enlarged, and the outline that aruco found"
        for name, picture in pictures.items():
            replace_file(folder / f"{name}.png", lambda path, p=picture: _write_png(path, p))
        stamp = answers[PICTURES["view_camera"]].header.stamp
        title = f"What the detectors make of one image ({stamp.to_sec():.3f} s)"
        coloured = {name: picture[:, :, ::-1] for name, picture in pictures.items()}
        save(vision_figure(coloured, lines, title), folder / "side_by_side.png")
        for name, line in lines.items():
            rospy.loginfo("%s: %s", name, line)
        markers = [marker_figures(marker) for marker in answers[DETECTIONS].detections]
        values = {**self._wanted.about, "stamp_s": stamp.to_sec()}
        values.update(found=lines, markers=markers)
        write_json(folder / "summary.json", values)
        rospy.loginfo("pictures in %s", folder)

    def _listen(self, topic: str, kind: type) -> None:
        self._answers[topic] = {}

        def receive(message: Any) -> None:
            if message.header.stamp.to_sec() >= self._wanted.settle:
                with self._lock:
                    self._answers[topic].setdefault(message.header.stamp.to_nsec(), message)

        self._subscribers.append(rospy.Subscriber(topic, kind, receive, tcp_nodelay=True))


def found_lines(answers: Mapping[str, Any], pictures: Mapping[str, np.ndarray]) -> Dict[str, str]:
    """Return a line on what each detector found, by its name."""
    view = answers[PICTURES["view_camera"]]
    grey = cv2.cvtColor(pictures["view_camera"], cv2.COLOR_BGR2GRAY)
    edges = int(np.count_nonzero(pictures["canny_edges"][:, :, 0]))
    markers = [_marker_line(marker) for marker in answers[DETECTIONS].detections]
    return {
        "view_camera": f"{view.width} x {view.height} px, mean grey level {grey.mean():.0f}",
        "canny_edges": f"{edges} edge pixels, {100.0 * edges / grey.size:.1f} % of the image",
        **{name: _points_line(answers[f"{name}/points"]) for name in FEATURES},
        "aruco": "; ".join(markers) or "no marker",
    }


def marker_figures(marker: MarkerDetection) -> Dict[str, Any]:
    """Return what summary.json says of a marker."""
    place = marker.pose.pose.position
    return {
        "id": marker.id,
        "dictionary": marker.dictionary,
        "corners_px": [list(marker.corners[k : k + 2]) for k in range(0, 8, 2)],
        "position_m": [place.x, place.y, place.z],
        "reprojection_error_px": marker.reprojection_error,
        "ambiguous": marker.ambiguous,
    }


def _points_line(message: ImagePoints) -> str:
    if not message.points:
        return "no corner"
    best = message.points[0]
    return f"{len(message.points)} corners, the strongest at ({best.x:.0f}, {best.y:.0f}) px"


def _marker_line(marker: MarkerDetection) -> str:
    name = f"marker {marker.id} of {marker.dictionary}"
    if not marker.size:
        return f"{name}, no pose without camera_info"
    place = marker.pose.pose.position
    where = f"{place.z:.3f} m ahead, {place.x:.3f} m right, {place.y:.3f} m down"
    return f"{name}, {where}, to {marker.reprojection_error:.2f} px"


def _write_png(path: Path, picture: np.ndarray) -> None:
    if not cv2.imwrite(str(path), picture):
        raise FileError(f"cannot write {path}")


def main() -> None:
    """Run the node."""

    def body() -> None:
        wanted = private_parameters(PlotVisionParameters)
        plotter = PlotVision(wanted)
        if wanted.lock_step:
            join_when(plotter.is_connected, "the detectors")
        plotter.finish(plotter.wait())

    run_node("plot_vision", body)
