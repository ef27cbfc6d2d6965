"""Markers are found where they are, all of them and nothing else."""

import cv2
import numpy as np
import pytest
from marker_images import TAGS, View, image_of, marker, noisy
from shared import cases

from bullet_lab.core.parameters import ParameterError
from bullet_lab.vision import marker_detector
from bullet_lab.vision.candidates import CandidateSearch, quads_in_cells
from bullet_lab.vision.dictionaries import DICTIONARY_NAMES, Match, dictionary_named
from bullet_lab.vision.images import UNIT_SQUARE, Picture, VisionError
from bullet_lab.vision.marker_detector import DetectorSettings, MarkerDetector, add_match

SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def detect(image, **settings):
    return MarkerDetector(DetectorSettings(**settings)).detect(image)


def ids_in(image, **settings):
    return [found.id for found in detect(image, **settings).markers]


# Which are found


@pytest.mark.parametrize("name", DICTIONARY_NAMES)
def test_markers_of_every_dictionary(name):
    image = image_of([marker(7, tags=name)], View(1.0, yaw=15.0), samples=4)
    assert ids_in(image, tags=name) == [7]


@cases("yaw, farthest: [[0.0, 6.0], [30.0, 5.5], [60.0, 3.5]]")
def test_range_without_gaps(yaw, farthest):
    for distance in np.linspace(0.45, farthest, 8):
        view = View(distance, yaw=yaw, pitch=1.0, roll=2.0)
        assert ids_in(image_of([marker()], view, samples=4, noise=2.0)) == [0], distance


def test_of_two_outlines_of_one_marker_the_likelier_stays():
    """As of a panel before a bright sky: its own outline, and that of its marker."""
    panel = Match(0, 100.0 + 27.0 * SQUARE, 2, 0.7)
    marker_itself = Match(0, 100.5 + 25.0 * SQUARE, 0, 0.95)
    inner = Match(0, 101.0 + 2.5 * SQUARE, 0, 0.9)
    other_id = Match(3, 100.0 + 25.0 * SQUARE, 0, 0.8)
    beside = Match(0, 100.0 + 25.0 * SQUARE + (60.0, 0.0), 0, 0.8)
    found = []
    for match in (panel, marker_itself, panel, inner, other_id, beside):
        add_match(match, found)
    assert found == [marker_itself, inner, other_id, beside]


def test_nothing_is_found_in_cells_without_contrast():
    pattern, grey = dictionary_named(TAGS).pattern(0), Picture(np.full((300, 300), 100, np.uint8))
    with np.errstate(all="raise"):
        assert not len(quads_in_cells(grey, 299.0 * UNIT_SQUARE, pattern, 8.0, np.empty((0, 4, 2))))


# False ones


def dots(chance):
    """As figure 8: dots on white, some of them square."""
    image, radius = np.full((480, 640), 230, np.uint8), chance.uniform(1.5, 8.0)
    for u, v in chance.integers((640, 480), size=(chance.integers(200, 1500), 2)).tolist():
        grey = int(chance.integers(0, 60))
        if chance.random() < 0.3:
            image[v : v + round(2 * radius), u : u + round(2 * radius)] = grey
        else:
            cv2.circle(image, (u, v), round(radius), grey, -1)
    return noisy(image, chance.uniform(0.0, 6.0), chance)


def test_no_marker_in_dots():
    chance = np.random.default_rng(8)
    for _ in range(6):
        assert ids_in(dots(chance)) == []


def test_a_square_among_more_dots_than_16_bits_can_number():
    image = np.full((520, 720), 220, np.uint8)
    image[::2, ::2] = 20
    assert (image == 20).sum() > 2**16
    image[400:450, 500:550] = 220
    image[410:440, 510:540] = 20
    quads = CandidateSearch(image, min_side=8.0).first_pass(contrast=7.0)
    ends = np.concatenate((quads.min(axis=1), quads.max(axis=1)), axis=1)
    assert np.abs(ends - (509.5, 409.5, 539.5, 439.5)).sum(axis=1).min() < 0.1


@cases("weak, found: [[20, false], [80, true]]")
def test_much_texture_hides_weak_edges_in_the_first_pass_only(weak, found):
    grey = np.full((200, 200), 120, np.uint8)
    grey[:, 100:] = np.where(np.indices((200, 100)).sum(axis=0) // 4 % 2, 200, 40)
    grey[60:90, 30:60] = 120 - weak
    search = CandidateSearch(grey, 8.0)
    first, second = (
        (quads.max(axis=(1, 2)) < 95.0).any()
        for quads in (search.first_pass(7.0), search.second_pass(7.0))
    )
    assert (first, second) == (found, True)


@cases("edge: [16, 48]")
def test_a_dark_square_in_a_small_image(edge):
    image = np.full((edge, edge + 1), 220, np.uint8)
    image[2:-2, 2:-2] = 20
    assert detect(image, min_side=5.0).report.quads == 1


# What is refused, and the rest


def test_images_that_are_none():
    for shape, kind in (((480, 640), float), ((4, 4), np.uint8), ((48, 64, 2), np.uint8)):
        with pytest.raises(VisionError):
            detect(np.zeros(shape, kind))


@cases("""
wrong:
  - {tags: x}
  - {refine: all}
  - {ids: [2320]}
  - {ids: [-1]}
  - {min_side: 4.9}
  - {border: -0.1}
  - {contrast: -0.1}
  - {contrast: 255.1}
  - {correction: -0.1}
  - {correction: 1.1}
""")
def test_settings_that_are_not_allowed(wrong):
    with pytest.raises(ParameterError):
        DetectorSettings(**wrong)


def test_the_number_of_tries_is_bounded(monkeypatch):
    square = np.pad(np.full((14, 14), 20, np.uint8), 5, constant_values=200)
    image = np.tile(square, (20, 26))
    for count in (20, 50):
        monkeypatch.setattr(marker_detector, "_MOST_QUADS", count)
        assert detect(image, second_pass=False).report.quads == count
