"""Bundles: markers that are fixed to each other, such as a board or the faces of a box."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Iterable, Iterator, Mapping, Sequence

import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose
from bullet_lab.vision.marker_pose import SAME, SQUARE, ObservedMarker, ideal_corners
from bullet_lab.vision.pose_fit import MarkerPose, PoseEstimate, PoseFit, clearly_better

# The fit starts from the poses of so many markers, the largest in the image.
_STARTS = 2
_PLACE, _TURN = ("x", "y", "z"), ("qx", "qy", "qz", "qw")


@dataclass(frozen=True)
class BundledMarker:
    """A marker of a bundle: the edge of its black square in m, and its pose in the bundle."""

    size: float
    pose: Pose

    def corners(self) -> np.ndarray:
        """Return its corners (4, 3) in the bundle's frame, m."""
        turned = 0.5 * self.size * SQUARE @ self.pose.rotation_matrix().T
        return turned + self.pose.position


@dataclass(frozen=True)
class Bundle:
    """Markers by id that share a frame, and its name."""

    name: str
    markers: Mapping[int, BundledMarker]


@dataclass(frozen=True, eq=False)
class ObservedBundle:
    """A bundle in an image: its name as `id`, the markers that were seen, and its poses.

    A bundle of which two markers or more are seen rarely has another pose that fits.
    """

    id: str
    seen: tuple[int, ...]
    pose: PoseEstimate


def read_bundles(value: Any) -> tuple[Bundle, ...]:
    """Return the bundles of a list as in apriltag_ros' `tag_bundles`.

    Each has a `name` and a `layout`: a list of markers with `id`, `size` in m, and optionally
    `x`, `y`, `z` in m and the quaternion `qx`, `qy`, `qz`, `qw`.

    Raises:
        ValueError, TypeError, KeyError, AttributeError: it is no such list.
    """
    bundles = []
    for entry in value:
        name, layout = str(entry["name"]), entry["layout"]
        markers = {int(one["id"]): _bundled(one) for one in layout}
        if not name or not markers or len(markers) < len(layout):
            raise ValueError
        bundles.append(Bundle(name, markers))
    if len({bundle.name for bundle in bundles}) < len(bundles):
        raise ValueError
    return tuple(bundles)


def _bundled(entry: Mapping[str, Any]) -> BundledMarker:
    size = float(entry["size"])
    place = tuple(float(entry.get(key, 0.0)) for key in _PLACE)
    turn = tuple(float(entry.get(key, 1.0 if key == "qw" else 0.0)) for key in _TURN)
    length = math.hypot(*turn)
    if not (all(map(math.isfinite, (size, *place))) and size > 0.0 and 0.0 < length < math.inf):
        raise ValueError
    return BundledMarker(size, Pose(place, tuple(value / length for value in turn)))


def observe_bundles(
    bundles: Iterable[Bundle],
    markers: Sequence[ObservedMarker],
    camera: PinholeCamera,
    pixel_sigma: float = 0.02,
) -> Iterator[ObservedBundle]:
    """Yield the bundles of which a marker is seen; a marker that is seen twice does not count.

    Args:
        bundles: that may be there.
        markers: those of an image, the largest first.
        camera: geometry of the image.
        pixel_sigma: as of `MarkerObserver`.
    """
    ids = [marker.id for marker in markers]
    once = [marker for marker in markers if ids.count(marker.id) == 1]
    for bundle in bundles:
        seen = [marker for marker in once if marker.id in bundle.markers]
        starts = [_of_bundle(bundle, marker) for marker in seen[:_STARTS]]
        if len(seen) == 1:
            estimate = starts[0]
        elif seen:
            estimate = _fitted(bundle, seen, starts, camera, pixel_sigma)
        else:
            continue
        yield ObservedBundle(bundle.name, tuple(marker.id for marker in seen), estimate)


def _of_bundle(bundle: Bundle, marker: ObservedMarker) -> PoseEstimate:
    """Return the poses of a bundle that are those of one of its markers."""
    place, estimate = bundle.markers[marker.id].pose, marker.pose
    poses = (_moved(pose, place) for pose in (estimate.best, estimate.alternative))
    return PoseEstimate(*poses, estimate.ambiguous)


def _moved(pose: MarkerPose, place: Pose) -> MarkerPose:
    """Return the pose of the frame in which a marker of a pose has a place."""
    rotation = pose.rotation @ place.rotation_matrix().T
    x, y, z = arm = rotation @ place.position
    by_marker = np.eye(6)
    by_marker[:3, 3:] = ((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))
    covariance = by_marker @ pose.covariance @ by_marker.T
    return MarkerPose(rotation, pose.translation - arm, pose.error, covariance)


def _fitted(
    bundle: Bundle,
    markers: Sequence[ObservedMarker],
    starts: Sequence[PoseEstimate],
    camera: PinholeCamera,
    pixel_sigma: float,
) -> PoseEstimate:
    """Return the poses that fit the corners of several markers.

    If the corners are farther off than their covariance says, as on a board that is not flat, that
    of the pose grows by as much.
    """
    corners, covariances = zip(
        *(ideal_corners(one.corners, camera, pixel_sigma, one.covariance) for one in markers)
    )
    points = np.concatenate([bundle.markers[marker.id].corners() for marker in markers])
    fit = PoseFit(points, np.concatenate(corners), np.stack(covariances), camera)
    first = [pose for start in starts for pose in (start.best, start.alternative)]
    refined = (fit.refined(pose.rotation, pose.translation) for pose in first)
    fits = sorted((one for one in refined if one is not None), key=lambda one: one[0])
    if not fits:
        return starts[0]
    poses = [_widened(*one, 8 * len(markers) - 6) for one in fits]
    best = poses[0]
    others = [pose for pose in poses if np.sum(pose.rotation * best.rotation) < SAME]
    if not others:
        return PoseEstimate(best, best, False)
    sigma = float(np.sqrt(np.mean([np.trace(one) / 8.0 for one in covariances])))
    return PoseEstimate(best, others[0], not clearly_better(best, others[0], sigma))


def _widened(squares: float, pose: MarkerPose, freedom: int) -> MarkerPose:
    return replace(pose, covariance=max(1.0, squares / freedom) * pose.covariance)
