"""Markers are found where they are, all of them and nothing else."""

import cv2
import numpy as np
import pytest
from marker_images import (
    BENT,
    TAGS,
    Layer,
    View,
    image_of,
    marker,
    noisy,
    off_by,
    true_corners,
)
from shared import cases

from bullet_lab.core.parameters import ParameterError
from bullet_lab.vision import marker_detector
from bullet_lab.vision.candidates import CandidateSearch, quads_in_cells
from bullet_lab.vision.dictionaries import DICTIONARY_NAMES, Match, dictionary_named
from bullet_lab.vision.images import UNIT_SQUARE, Picture, VisionError
from bullet_lab.vision.marker_detector import (
    DetectorSettings,
    MarkerDetector,
    add_match,
    noise_level,
    why_nothing,
)

SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def detect(image, camera=None, **settings):
    return MarkerDetector(DetectorSettings(**settings)).detect(image, camera)


def found_in(image, camera=None, **settings):
    return detect(image, camera, **settings).markers


def picture(view, *layers, samples=4, **light):
    """The image of some layers, or of a marker."""
    return image_of(layers or [marker()], view, samples=samples, **light)


def ids_in(image, **settings):
    return [found.id for found in found_in(image, **settings)]


def nested(outer, inner):
    """A marker as one white cell of a larger one; the layers, the larger size and the centre."""
    pattern = dictionary_named(TAGS).pattern(outer)
    row, column = np.argwhere(pattern == 1)[8]
    cell = 0.125
    centre = ((column + 0.5 - 4.0) * cell, (4.0 - row - 0.5) * cell)
    return [marker(outer, size=1.0), marker(inner, size=0.1, centre=centre)], 1.0, centre


# Accuracy


@cases("""
distance, yaw, roll:
  - [0.5, 50.0, 0.0]
  - [1.0, 0.0, 85.0]
  - [1.0, 10.0, -95.0]
  - [4.0, 25.0, 180.0]
""")
def test_corners_are_exact_and_unbiased_and_begin_at_the_top_left(distance, yaw, roll):
    errors = []
    for number in range(3):
        turned = yaw + number, 1.5 * number, roll + 2.0 * number
        view = View(distance, *turned, (0.02 * distance, 0.03))
        (found,) = found_in(picture(view, samples=8))
        errors.append(found.corners - true_corners(view))
    errors = np.array(errors)
    assert np.linalg.norm(errors, axis=2).max() < 0.1
    # Neither moved nor too large or small.
    assert np.abs(errors.mean(axis=(0, 1))).max() < 0.02
    outward = errors * np.sign(true_corners(view) - true_corners(view).mean(axis=0))
    assert abs(outward.mean()) < 0.03


def test_a_lens_does_not_bend_what_is_found():
    view = View(0.8, yaw=25.0, shift=(0.3, 0.2))
    image = picture(view, camera=BENT, samples=8)
    for camera, least, most in ((BENT, 0.0, 0.05), (None, 0.1, 99.0)):
        (found,) = found_in(image, camera)
        assert least < off_by(found, view, camera=BENT) < most


# Which are found


@pytest.mark.parametrize("name", DICTIONARY_NAMES)
def test_markers_of_every_dictionary(name):
    assert ids_in(picture(View(1.0, yaw=15.0), marker(7, tags=name)), tags=name) == [7]


@cases("yaw, farthest: [[0.0, 6.0], [30.0, 5.5], [60.0, 3.5]]")
def test_range_without_gaps(yaw, farthest):
    for distance in np.linspace(0.45, farthest, 8):
        view = View(distance, yaw=yaw, pitch=1.0, roll=2.0)
        assert ids_in(picture(view, noise=2.0)) == [0], distance


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


@pytest.mark.parametrize("view", [View(1.5), View(2.8, yaw=30.0)])
def test_nothing_is_found_in_cells_that_hold_something_else(view):
    layers, _, centre = nested(0, 0)
    other = Layer(np.kron([[20.0, 220.0], [220.0, 20.0]], np.ones((4, 4))), 0.1, centre)
    assert ids_in(picture(view, layers[0], other, samples=6, noise=3.0)) == [0]


def test_nothing_is_found_in_cells_without_contrast():
    pattern, grey = dictionary_named(TAGS).pattern(0), Picture(np.full((300, 300), 100, np.uint8))
    with np.errstate(all="raise"):
        assert not len(quads_in_cells(grey, 299.0 * UNIT_SQUARE, pattern, 8.0, np.empty((0, 4, 2))))


@cases("distance, corner: [[0.4, 0], [0.6, 1], [0.6, 3], [1.5, 2]]")
def test_a_marker_with_something_dark_before_a_corner(distance, corner):
    """It is a part of the outline; from near by that was as many px off as it was large."""
    view = View(distance, yaw=2.0, pitch=1.0)
    image = picture(view, marker(black=2.0, white=17.0), background=9.0, noise=1.5)
    corners = true_corners(view)
    half = 0.125 * np.hypot(*(corners[1] - corners[0]))
    low, high = np.rint((corners[corner] - half, corners[corner] + half)).astype(int)
    image[low[1] : high[1], low[0] : high[0]] = 2
    (found,) = found_in(image)
    assert np.delete(np.abs(found.corners - corners), corner, axis=0).max() < 1.0


def test_a_marker_at_the_edge_of_the_image_is_dropped():
    for shift, found, cropped in ((0.53, [0], []), (0.536, [], [0])):
        detections = detect(picture(View(1.0, shift=(shift, 0.0))))
        assert [one.id for one in detections.markers] == found
        assert detections.report.cropped == cropped


@cases("""
wrong, settings, found:
  # 36h10 could correct four.
  - [2, {}, [2]]
  - [3, {}, []]
  - [4, {correction: 1.0}, [4]]
  - [1, {correction: 0.0}, []]
""")
def test_bits_are_corrected_as_far_as_asked(wrong, settings, found):
    layer = marker(2)
    for place in [(2, 2), (3, 5), (6, 4), (5, 7)][:wrong]:
        layer.cells[place] = 240.0 - layer.cells[place]
    image = picture(View(1.0), layer)
    assert [one.bit_errors for one in found_in(image, **settings)] == found


def test_misread_cells_of_the_border_are_counted(monkeypatch):
    layer = marker(2)
    # Grey, so that the outline is seen, and nearer to white.
    places = [3, 5, 6]
    layer.cells[1, places] = layer.cells[places, 1] = 130.0
    image = picture(View(1.0), layer)
    assert ids_in(image) == []
    monkeypatch.setattr(marker_detector, "_BORDER_RATE", 0.5)
    assert ids_in(image) == [2]


# Light


def test_the_second_pass_is_made_only_where_nothing_was_found():
    assert not detect(picture(View(2.0))).report.second_pass
    # The contrast is less than the first pass needs, in an image of full range.
    faint = picture(View(1.0), marker(black=100.0, white=106.0), background=103.0)
    faint[:40], faint[-40:] = 255, 0
    assert detect(faint).report.second_pass
    assert ids_in(faint) == [0]
    assert ids_in(faint, second_pass=False) == []


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
    image = np.full((720, 960), 220, np.uint8)
    image[::2, ::2] = 20
    assert (image == 20).sum() > 2**16
    image[600:650, 700:750] = 220
    image[610:640, 710:740] = 20
    quads = CandidateSearch(image, min_side=8.0).first_pass(contrast=7.0)
    ends = np.concatenate((quads.min(axis=1), quads.max(axis=1)), axis=1)
    assert np.abs(ends - (709.5, 609.5, 739.5, 639.5)).sum(axis=1).min() < 0.1


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


def grey_with(part, level, rest):
    """An even picture, and an even part of it."""
    image = np.full((480, 640), rest, np.uint8)
    image[part, part] = level
    return image


@pytest.mark.parametrize(
    "image, settings, said",
    [
        (grey_with(slice(0), 0, 5), {}, "flat"),
        (grey_with(slice(20), 60, 5), {}, "dark (mean"),
        (grey_with(slice(100, 200), 30, 200), {}, "1 dark quadrilaterals"),
        (picture(View(1.0), marker(5)), {"ids": (0,)}, "marker 5 seen"),
        (picture(View(1.0, shift=(0.5365, 0.0)), marker(5)), {}, "marker 5 cut off"),
    ],
)
def test_the_reason_why_nothing_is_found(image, settings, said):
    for camera in (None, BENT):
        report = detect(image, camera, **settings).report
        assert said in why_nothing(report, "DICT_APRILTAG_36h10")


# What is refused, and the rest


def test_images_that_are_none():
    for shape, kind in (((480, 640), float), ((4, 4), np.uint8), ((48, 64, 2), np.uint8)):
        with pytest.raises(VisionError):
            detect(np.zeros(shape, kind))


@cases("""
wrong:
  # The other limits are declared, as those of all parameters.
  - {tags: x}
  - {refine: all}
  - {ids: [2320]}
  - {ids: [-1]}
  - {min_side: 2.0}
""")
def test_settings_that_are_not_allowed(wrong):
    with pytest.raises(ParameterError):
        DetectorSettings(**wrong)


@cases("sigma: [0.0, 4.0]")
def test_noise_is_measured(sigma):
    image = picture(View(1.0), noise=sigma)
    assert noise_level(image) == pytest.approx(sigma, rel=0.1, abs=0.05)


def test_the_number_of_tries_is_bounded(monkeypatch):
    square = np.pad(np.full((14, 14), 20, np.uint8), 5, constant_values=200)
    image = np.tile(square, (20, 26))
    for count in (20, 50):
        monkeypatch.setattr(marker_detector, "_MOST_QUADS", count)
        assert detect(image, second_pass=False).report.quads == count
