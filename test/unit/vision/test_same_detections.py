"""Markers, how certain they are and their poses are the same numbers as before.

A change that means to find others puts what `found` returns into detections.yaml.
"""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from marker_images import BENT, CAMERA, Layer, View, image_of, marker, noisy

from bullet_lab.vision.candidates import CandidateSearch
from bullet_lab.vision.dictionaries import may_be_markers
from bullet_lab.vision.images import Picture
from bullet_lab.vision.marker_bundles import observe_bundles, read_bundles
from bullet_lab.vision.marker_detector import DetectorSettings
from bullet_lab.vision.marker_pose import MarkerObserver

PICTURES = yaml.safe_load((Path(__file__).parent / "detections.yaml").read_text())
# Share, and px, m or so, by which places and deviations may differ: other processors round others.
WITHIN = ((0.0, 2e-4), (2e-3, 0.0))


def image_in(made, camera):
    """The image of a picture: markers, what is over them, motion to the right and light."""
    layers = [marker(**one) for one in made.get("markers", [{}])]
    layers += [Layer(np.array([[grey]]), *place) for grey, *place in made.get("over", ())]
    image = image_of(layers, View(*made["view"]), camera, samples=4, **made.get("light", {}))
    image = cv2.blur(image, (made.get("motion", 1), 1))
    left, right = made.get("sun", (1.0, 1.0))
    image = np.where(np.arange(camera.width) < 330, left, right) * image
    return noisy(image, made.get("noise", 2.0), np.random.default_rng(0))


def found(made):
    """Of the report, each marker and each bundle: what is exact, and standard deviations."""
    camera = BENT if made.get("bent") else CAMERA
    observer = MarkerObserver(DetectorSettings(**made.get("settings", {})))
    seen = observer.observe(image_in(made, camera), camera)
    report = seen.report
    yield [report.quads, report.undecoded, report.second_pass], [report.noise]
    for one in seen.markers:
        best, other = one.pose.best, one.pose.alternative
        place = one.id, one.likeness, best.error, *best.translation, *other.rotation[2]
        deviations = *one.deviations.ravel(), *np.sqrt(np.diag(best.covariance))
        yield [*place, *one.corners.ravel()], [*deviations]
    for one in observe_bundles(read_bundles(made.get("bundles", ())), seen.markers, camera):
        best, other = one.pose.best, one.pose.alternative
        place = len(one.seen), best.error, one.pose.ambiguous, *other.rotation[2]
        yield [*place, *best.translation], [*np.sqrt(np.diag(best.covariance))]


@pytest.mark.parametrize("name", PICTURES)
def test_detections_are_as_before(name):
    before = PICTURES[name]["found"]
    now = [*found(PICTURES[name])]
    assert len(now) == len(before)
    for pair in zip(now, before):
        for values, known, within in zip(*pair, WITHIN):
            np.testing.assert_allclose(values, known, *within)


def candidates_in(seed):
    """Of shapes before a bright ground: numbers of outlines of each pass, and of those that may be
    markers, and the mean corner.
    """
    chance = np.random.default_rng(seed)
    image = np.full((480, 640), 200, np.uint8)
    for middle in np.argwhere(np.ones((8, 6)))[: 5 + 43 * (seed % 2)] * 80 + 40:
        turns = 1.57 * np.arange(4) + chance.random() * chance.uniform(0.0, 1.5, 4)
        around = np.stack((np.cos(turns), np.sin(turns)), axis=1) * chance.uniform(4.0, 38.0, 2)
        for scale, grey in ((1.0, chance.integers(20, 199)), (chance.uniform(0.0, 0.8), 200)):
            outline = np.rint(16.0 * (middle + scale * around)).astype(int)
            cv2.fillPoly(image, [outline], int(grey), cv2.LINE_AA, 4)
        corner = (middle + around[0]).astype(int).tolist()
        cv2.circle(image, corner, int(chance.integers(8)), 200, -1)
    image = noisy(image, chance.uniform(0.0, 6.0), chance)
    search = CandidateSearch(image, 8.0)
    passes = search.first_pass(7.0), search.second_pass(7.0), search.open_pass(7.0)
    quads = np.concatenate(passes)
    likely = may_be_markers(Picture(image), quads, 6)
    return [*map(len, passes), likely.sum(), *quads.mean(axis=(0, 1))]


CANDIDATES = """
5 1 0 5 53.232 269.218
55 22 0 60 289.304 243.077
7 3 0 9 41.060 200.551
48 22 0 45 319.803 232.749
8 42 12 37 147.634 233.554
57 24 0 63 303.858 242.830
10 4 0 8 93.436 182.419
53 19 0 58 316.246 242.421
"""


@pytest.mark.parametrize("seed, known", [*enumerate(CANDIDATES.split("\n")[1:-1])])
def test_candidates_are_as_before(seed, known):
    assert candidates_in(seed) == pytest.approx([*map(float, known.split())], abs=2e-3)
