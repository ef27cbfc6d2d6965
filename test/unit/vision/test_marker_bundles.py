"""Bundles of markers: one pose from all that are seen, and what its covariance is worth."""

import math
from dataclasses import replace

import numpy as np
import pytest
from marker_images import BENT, CAMERA, View, angle_between, normalised_square
from scipy import stats
from shared import cases

from bullet_lab.vision.marker_bundles import observe_bundles, read_bundles
from bullet_lab.vision.marker_detector import DetectedMarker
from bullet_lab.vision.marker_pose import ObservedMarker, estimate_pose

SIZE = 0.08
PLACES = {0: (-0.1, 0.1), 1: (0.1, 0.1), 2: (-0.1, -0.1), 3: (0.1, -0.1)}
BOARD = {
    "name": "board",
    "layout": [{"id": i, "size": SIZE, "x": x, "y": y} for i, (x, y) in PLACES.items()],
}
# Two faces of a box, a right angle between them; the second looks to the right of the first.
BOX = {
    "name": "box",
    "layout": [
        {"id": 0, "size": SIZE, "z": 0.05},
        {"id": 1, "size": SIZE, "x": 0.05, "qy": 1.0, "qw": 1.0},
    ],
}
VIEW = View(1.2, yaw=25.0, pitch=10.0, roll=15.0, shift=(0.1, -0.05))
ASIDE = View(1.2, yaw=-35.0, pitch=10.0, shift=(0.1, -0.05))


def bundle_of(layout):
    (bundle,) = read_bundles([layout])
    return bundle


def observed(bundle, markers, camera=CAMERA):
    (found,) = observe_bundles([bundle], markers, camera, 0.0)
    return found


def seen(bundle, view, chance=None, sigma=0.1, camera=CAMERA, ids=None):
    """The markers of a bundle, with corners that are exact or noisy."""
    found = []
    for number in ids or bundle.markers:
        one = bundle.markers[number]
        corners = camera.project(view.to_camera(one.corners()))
        if chance is not None:
            corners = corners + chance.normal(0.0, sigma, (4, 2))
        covariance = sigma**2 * np.eye(8)
        detected = DetectedMarker(number, corners, 0, 1.0, covariance)
        pose = estimate_pose(corners, one.size, camera, 0.0, covariance)
        found.append(ObservedMarker(**vars(detected), size=one.size, pose=pose))
    return found


def square_of(pose, view):
    """The square of a pose's error by its covariance."""
    turn = pose.rotation @ view.rotation.T
    odd = 0.5 * (turn - turn.T)
    small = odd[2, 1], odd[0, 2], odd[1, 0]
    error = np.concatenate([pose.translation - view.translation, small])
    return normalised_square(error, pose.covariance)


@pytest.mark.parametrize("layout, camera", [(BOARD, BENT), (BOX, CAMERA), (BOX, BENT)])
def test_exact_corners_give_the_exact_pose(layout, camera):
    bundle = bundle_of(layout)
    found = observed(bundle, seen(bundle, ASIDE, camera=camera), camera)
    assert (found.id, found.seen) == (layout["name"], tuple(bundle.markers))
    assert not found.pose.ambiguous
    np.testing.assert_allclose(found.pose.best.translation, ASIDE.translation, atol=1e-5)
    assert angle_between(found.pose.best.rotation, ASIDE.rotation) < 2e-4


@pytest.mark.parametrize("layout, wrong", [(BOARD, 1.0), (BOX, 3.0)], ids=["board", "box"])
def test_the_covariance_is_that_of_the_errors(layout, wrong):
    """Also if corners are three times as far off as they believe.

    The scale of the covariance is estimated from the residuals, and never lowers it. So NEES is
    chi-square with 6 degrees of freedom over that scale; the mean of 200 is within its bounds of
    99.9 %.
    """
    bundle, sigma = bundle_of(layout), 0.1
    chance, squares = np.random.default_rng(7), []
    for _ in range(200):
        markers = seen(bundle, ASIDE, chance, wrong * sigma)
        markers = [replace(one, covariance=sigma**2 * np.eye(8)) for one in markers]
        squares.append(square_of(observed(bundle, markers).pose.best, ASIDE))
    residuals = stats.chi2(8 * len(bundle.markers) - 6)

    def moment(power):
        """Of the true variance over the estimated one."""

        def ratio(squares):
            return (wrong**2 / max(1.0, wrong**2 * squares / residuals.mean())) ** power

        return residuals.expect(ratio)

    mean = 6.0 * moment(1)
    deviation = math.sqrt((48.0 * moment(2) - mean**2) / len(squares))
    assert np.mean(squares) == pytest.approx(mean, abs=stats.norm.ppf(0.9995) * deviation)


def test_a_marker_that_is_seen_twice_and_one_of_nobody_do_not_count():
    bundle = bundle_of(BOARD)
    markers = seen(bundle, VIEW)
    stranger = replace(markers[1], id=77)
    twice = [*markers, replace(markers[0], corners=markers[0].corners + 50.0), stranger]
    found = observed(bundle, twice)
    assert found.seen == (1, 2, 3)
    np.testing.assert_allclose(found.pose.best.translation, VIEW.translation, atol=1e-4)
    assert not list(observe_bundles([bundle], [stranger], CAMERA))


@cases("""
change:
  - {name: ""}
  - {layout: []}
  - {layout: [{id: 1}]}
  - {layout: [{id: 1, size: 0.0}]}
  - {layout: [{id: 1, size: 0.1, x: .nan}]}
  - {layout: [{id: 1, size: 0.1, qw: 0.0}]}
  - {layout: [{id: 1, size: 0.1}, {id: 1, size: 0.1}]}
  - {layout: 7}
  - {layout: [marker]}
""")
def test_what_is_no_bundle(change):
    with pytest.raises((ValueError, TypeError, KeyError, AttributeError)):
        bundle_of({**BOARD, **change})


def test_two_bundles_of_one_name_are_refused():
    with pytest.raises(ValueError):
        read_bundles([BOARD, BOARD])
