"""Markers, how certain they are and their poses are the same numbers as before.

A change that means to find others writes the texts anew, see `assert_as_before`.
"""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from alike import assert_as_before, lines_of
from marker_images import BENT, CAMERA, Layer, View, image_of, marker, noisy, true_corners

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.vision.candidates import CandidateSearch, quads_in_cells
from bullet_lab.vision.dictionaries import decode, dictionary_named, may_be_markers, refined
from bullet_lab.vision.images import Picture
from bullet_lab.vision.marker_bundles import observe_bundles, read_bundles
from bullet_lab.vision.marker_detector import DetectorSettings, why_nothing
from bullet_lab.vision.marker_pose import MarkerObserver, estimate_pose
from bullet_lab.vision.pattern_fit import fit_pattern
from bullet_lab.vision.pattern_pixels import without_hidden_side

HERE = Path(__file__).parent
TAGS = dictionary_named("apriltag_36h10")
ODD = PinholeCamera(331, 243, 250.0, 260.0, 160.0, 125.0, (0.1, -0.05, 0.001, 0.002, 0.0))
CAMERAS = {"straight": CAMERA, "bent": BENT, "odd": ODD}
PICTURES = yaml.safe_load((HERE / "detections.yaml").read_text())


def image_in(made, view, camera):
    """The image of a picture: markers, what is over them, motion to the right and light."""
    layers = [marker(**one) for one in made["markers"]]
    layers += [Layer(np.array(grey, float, ndmin=2), *place) for grey, *place in made["over"]]
    image = image_of(layers, view, camera, **{"samples": 4, **made["light"]})
    image = cv2.blur(image, (made["motion"], 1))
    image = np.where(np.arange(camera.width) < 330, *made["sun"]) * image
    return noisy(image, made["noise"], np.random.default_rng(0))


def numbers_of(covariance):
    """Deviations, and what tells how they hang together."""
    return [*np.sqrt(np.diag(covariance)), *1e6 * covariance.sum(axis=0)]


def lines_of_poses(estimate, name):
    yield f"{name}: {estimate.ambiguous}"
    for pose in (estimate.best, estimate.alternative):
        yield from lines_of([*pose.rotation[2], *pose.translation, pose.error], name)
        yield from lines_of(numbers_of(pose.covariance), name)


def lines_found(made):
    """Of a picture, the report, each marker and each bundle."""
    view, camera = View(*made["view"]), CAMERAS[made["camera"]]
    settings = DetectorSettings(**made["settings"])
    seen = MarkerObserver(settings, **made["sizes"]).observe(image_in(made, view, camera), camera)
    yield from lines_of(seen.report, "report")
    yield why_nothing(seen.report, settings.tags)
    true = {
        one.get("number", 0): (one.get("size", 0.2), one.get("centre", (0.0, 0.0)))
        for one in made["markers"]
    }
    for one in seen.markers:
        yield from lines_of([one.id, one.bit_errors, one.likeness, one.size], "marker")
        size, centre = true.get(one.id, (0.0, (0.0, 0.0)))
        off = one.corners - true_corners(view, size, camera, centre)
        assert np.abs(off).max() < made["most_off"]
        yield from lines_of(off, "off")
        yield from lines_of(numbers_of(one.covariance), "covariance")
        yield from lines_of_poses(one.pose, "pose")
    for one in observe_bundles(read_bundles(made["bundles"]), seen.markers, camera):
        yield from lines_of([one.id, *one.seen], "bundle")
        yield from lines_of_poses(one.pose, "pose")


@pytest.mark.parametrize("name", [*PICTURES][1:])
def test_detections_are_as_before(name):
    made = {**PICTURES["usual"], **PICTURES[name]}
    assert_as_before(lines_found(made), HERE / "detections" / f"{name}.txt")


def lines_of_quads(quads, name):
    yield from lines_of([len(quads), *np.nansum(quads, axis=0).ravel()], name)


def lines_of_candidates(seed):
    """Of shapes before a bright ground: the outlines of each pass, those that may be markers, and
    where lines along edges meet.
    """
    chance = np.random.default_rng(seed)
    image = np.full((480 - seed, 640 - seed), 200, np.uint8)
    # As long as a side may be.
    image[400:432, 200:470] = 90
    for middle in np.argwhere(np.ones((8, 6)))[: (4, 48)[seed % 2]] * 80 + 40:
        turns = 1.57 * np.arange(4) + chance.random() * chance.uniform(0.0, 1.5, 4)
        around = np.stack((np.cos(turns), np.sin(turns)), axis=1) * chance.uniform(3.0, 38.0, 2)
        for scale, grey in ((1.0, chance.integers(20, 199)), (chance.uniform(0.0, 0.8), 200)):
            outline = np.rint(16.0 * (middle + scale * around)).astype(int)
            cv2.fillPoly(image, [outline], int(grey), cv2.LINE_AA, 4)
        corner = (middle + around[0]).astype(int).tolist()
        cv2.circle(image, corner, int(chance.integers(8)), 200, -1)
    image = noisy(image, chance.uniform(0.0, (1.0, 6.0)[seed % 2]), chance)
    search = CandidateSearch(image, 8.0)
    passes = search.first_pass(7.0), search.second_pass(7.0), search.open_pass(7.0)
    for quads in passes:
        yield from lines_of_quads(quads, f"{seed} pass")
    quads = np.concatenate(passes)
    likely = may_be_markers(Picture(image), quads, 6)
    yield from lines_of_quads(quads[likely], f"{seed} likely")
    corners = refined(Picture(image), quads, 8)
    yield from lines_of_quads(corners, f"{seed} refined")
    for number, match in decode(Picture(image), quads, TAGS, 36, 28):
        yield from lines_of([number, match.marker, match.errors, match.likeness], "match")


@pytest.mark.parametrize("seed", range(16))
def test_candidates_are_as_before(seed):
    assert_as_before(lines_of_candidates(seed), HERE / "detections" / f"candidates_{seed}.txt")


def lines_of_fit(seed):
    """Of a marker with things before it: what may be in its cells, its corners and its poses."""
    chance, camera = np.random.default_rng(seed), (CAMERA, BENT)[seed % 2]
    view = View(chance.uniform(0.6, 3.5) ** (1 + seed % 3), *chance.uniform(-50.0, 50.0, 3))
    places = chance.uniform(-0.5, 0.5, (12, 2))
    things = [Layer(np.full((1, 1), 90.0 * chance.random()), 0.08, place) for place in places]
    image = image_of([marker(seed, size=1.0), *things], view, camera, samples=2, blur=1.2)
    picture = Picture(noisy(image, chance.uniform(0.0, 6.0), chance), camera)
    true = picture.ideal(true_corners(view, 1.0, camera))
    corners, pattern = true + chance.normal(0.0, 0.3, (4, 2)), TAGS.pattern(seed)
    known = true_corners(view, 0.08, camera, places[0])[None]
    yield from lines_of_quads(quads_in_cells(picture, corners, pattern, 4.0, known), "in cells")
    corners = without_hidden_side(picture, corners, pattern)
    yield from lines_of(corners - true, "off without a side")
    fit = fit_pattern(picture, corners, pattern)
    # One that is not all in the image hardly has a fit.
    if fit and view.distance > 2.0:
        yield from lines_of([fit.hidden, *(fit.corners - true).ravel()], "fit")
        yield from lines_of(numbers_of(fit.covariance), "fit")
        pose = estimate_pose(picture.seen(corners), 1.0, camera, 0.05, fit.covariance)
        yield from lines_of_poses(pose, "pose")


# Rounding decides how the fit of 5 ends and which pose of 21 comes first.
@pytest.mark.parametrize("seed", {*range(24)} - {5, 21})
def test_fits_are_as_before(seed):
    assert_as_before(lines_of_fit(seed), HERE / "detections" / f"fit_{seed}.txt")
