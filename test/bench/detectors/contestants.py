"""Detectors behind one call, each with a small grid of settings."""

from typing import Callable, NamedTuple

import cv2
import numpy as np
from pupil_apriltags import Detector as AprilTagDetector

from bullet_lab.vision.marker_detector import DetectorSettings, MarkerDetector

try:
    import locus
except ImportError:
    locus = None


class Contestant(NamedTuple):
    """A detector of 36h11, and the settings of which the best are taken.

    `make` takes settings, and returns what finds markers in an image (h, w) of grey levels:
    ids, and (4, 2) corners from the top left clockwise.
    """

    make: Callable
    grid: list


def _ours(settings):
    detector = MarkerDetector(DetectorSettings("apriltag_36h11", **settings))
    return lambda image: [(m.id, m.corners) for m in detector.detect(image).markers]


def _opencv(settings):
    parameters = cv2.aruco.DetectorParameters()
    for name, value in settings.items():
        setattr(parameters, name, value)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    detector = cv2.aruco.ArucoDetector(dictionary, parameters)

    def find(image):
        corners, ids, _ = detector.detectMarkers(image)
        numbers = [] if ids is None else ids.ravel().tolist()
        return [(number, four[0].astype(float)) for number, four in zip(numbers, corners)]

    return find


class AprilTag36h11(AprilTagDetector):
    """Theirs frees its family before the detector that still uses it, and now and then crashes."""

    def __init__(self, **settings):
        super().__init__(families="tag36h11", nthreads=1, **settings)

    def __del__(self):
        self.libc.apriltag_detector_destroy(self.tag_detector_ptr)
        self.libc.tag36h11_destroy(self.tag_families["tag36h11"])


def _april(settings):
    detector = AprilTag36h11(**settings)

    def find(image):
        # Its pixels are numbered at their corners; its markers' corners begin at OpenCV's upper
        # right and run counter-clockwise.
        return [(t.tag_id, t.corners[[1, 0, 3, 2]] - 0.5) for t in detector.detect(image)]

    return find


def _locus(settings):
    families = [locus.TagFamily.AprilTag36h11]
    detector = locus.Detector(threads=1, families=families, **settings)

    def find(image):
        # Its pixels are numbered at their corners.
        found = detector.detect(image)
        corners = np.asarray(found.corners, dtype=float) - 0.5
        return list(zip(np.asarray(found.ids).tolist(), corners))

    return find


_SUBPIX, _CONTOUR = cv2.aruco.CORNER_REFINE_SUBPIX, cv2.aruco.CORNER_REFINE_CONTOUR
_APRILTAG = cv2.aruco.CORNER_REFINE_APRILTAG
_SMALL = {"minMarkerPerimeterRate": 0.01, "adaptiveThreshWinSizeStep": 4}
CONTESTANTS = {
    "ours": Contestant(_ours, [{}, {"correction": 1.0}, {"min_side": 10.0}]),
    "opencv": Contestant(
        _opencv,
        [
            {"cornerRefinementMethod": _SUBPIX},
            {"cornerRefinementMethod": _SUBPIX, **_SMALL},
            {"cornerRefinementMethod": _CONTOUR, **_SMALL},
            {"cornerRefinementMethod": _APRILTAG},
            {"cornerRefinementMethod": _SUBPIX, **_SMALL, "adaptiveThreshConstant": 4.0},
        ],
    ),
    "pupil_apriltags": Contestant(
        _april,
        [
            {"quad_decimate": decimate, "quad_sigma": sigma, "decode_sharpening": sharp}
            for decimate, sigma, sharp in (
                (1.0, 0.0, 0.25), (1.0, 0.8, 0.25), (1.0, 0.0, 0.5), (2.0, 0.0, 0.25),
            )
        ],
    ),
}  # fmt: skip
# A detector that is compared only where it is installed, from 0.10 on. Another one is a function
# like these and an entry: from settings to what finds ids and corners in an image.
if hasattr(locus, "DetectionBatch"):
    CONTESTANTS["locus"] = Contestant(
        _locus, [{"profile": "standard"}, {"profile": "high_accuracy"}]
    )


def described(settings):
    """Return settings for a report; the defaults go by that name."""
    return dict(settings) or {"settings": "defaults"}
