"""Markers are found where they are, all of them and nothing else."""

import dataclasses

import cv2
import numpy as np
import pytest
from marker_images import (
    CAMERA,
    Layer,
    View,
    corner_error,
    corner_points,
    image_of,
    marker,
    true_corners,
)

from bullet_lab.core.parameters import ParameterError
from bullet_lab.vision import marker_detector
from bullet_lab.vision.candidates import CandidateSearch, sound_quads
from bullet_lab.vision.dictionaries import DICTIONARY_NAMES, Match, dictionary_named
from bullet_lab.vision.images import VisionError
from bullet_lab.vision.marker_detector import (
    DetectorSettings,
    MarkerDetector,
    add_match,
    noise_level,
    why_nothing,
)

TAGS = "apriltag_36h10"
BENT = dataclasses.replace(CAMERA, distortion=(-0.3, 0.1, 0.001, -0.002, 0.02))


def detect(image, camera=None, **settings):
    return MarkerDetector(DetectorSettings(**settings)).detect(image, camera)


def picture(view, *layers, **light):
    """The image of some layers, or of a marker."""
    return image_of(layers or [marker()], view, samples=4, **light)


def ids_of(detections):
    return sorted(found.id for found in detections.markers)


def nested(outer, inner, inner_size=0.1, **light):
    """A marker as one white cell of a larger one; the layers, the larger size and the centre."""
    pattern = dictionary_named(TAGS).pattern(outer)
    row, column = np.argwhere(pattern == 1)[8]
    cell = inner_size * 10 / 8
    centre = ((column + 0.5 - 4.0) * cell, (4.0 - row - 0.5) * cell)
    large = marker(outer, size=8 * cell, **light)
    return [large, marker(inner, size=inner_size, centre=centre, **light)], 8 * cell, centre


# Accuracy


@pytest.mark.parametrize("distance, yaw", [(0.5, 50.0), (1.0, 0.0), (4.0, 25.0)])
def test_corners_are_exact_and_unbiased(distance, yaw):
    errors = []
    for number in range(3):
        view = View(distance, yaw + number, 1.5 * number, 2.0 * number, (0.02 * distance, 0.03))
        image = image_of([marker()], view, samples=8)
        (found,) = detect(image).markers
        errors.append(found.corners - true_corners(view))
    errors = np.array(errors)
    assert np.linalg.norm(errors, axis=2).max() < 0.1
    # Neither moved nor too large or small.
    assert np.abs(errors.mean(axis=(0, 1))).max() < 0.02
    outward = errors * np.sign(true_corners(view) - true_corners(view).mean(axis=0))
    assert abs(outward.mean()) < 0.03


def test_corners_begin_at_the_top_left_of_a_marker_however_turned():
    for roll in (0.0, 85.0, 180.0, -95.0):
        view = View(1.0, yaw=10.0, roll=roll)
        (found,) = detect(image_of([marker(3)], view, samples=6)).markers
        assert corner_error(found.corners, true_corners(view)) < 0.05


def test_a_lens_does_not_bend_what_is_found():
    view = View(0.8, yaw=25.0, shift=(0.3, 0.2))
    image = image_of([marker()], view, camera=BENT, samples=8)
    true = true_corners(view, camera=BENT)
    (found,) = detect(image, BENT).markers
    assert corner_error(found.corners, true) < 0.05
    (without,) = detect(image).markers
    assert corner_error(without.corners, true) > 0.1


# Which are found


@pytest.mark.parametrize("name", DICTIONARY_NAMES)
def test_markers_of_every_dictionary(name):
    number = 7
    image = picture(View(1.0, yaw=15.0), marker(number, tags=name))
    assert ids_of(detect(image, tags=name)) == [number]


@pytest.mark.parametrize("yaw, farthest", [(0.0, 6.0), (30.0, 5.5), (60.0, 3.5)])
def test_range_without_gaps(yaw, farthest):
    for distance in np.linspace(0.45, farthest, 8):
        view = View(distance, yaw=yaw, pitch=1.0, roll=2.0)
        image = picture(view, noise=2.0)
        assert ids_of(detect(image)) == [0], distance


def test_several_markers_largest_first():
    layers = [marker(5, centre=(-0.3, 0.0)), marker(5, size=0.25, centre=(-0.3, 0.3))]
    layers += [marker(9, size=0.3, centre=(0.2, 0.0))]
    found = detect(picture(View(1.5), *layers)).markers
    assert [m.id for m in found] == [9, 5, 5]


def test_of_two_outlines_of_one_marker_the_likelier_stays():
    """As of a panel before a bright sky: its own outline, and that of its marker."""
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    panel = Match(0, 100.0 + 27.0 * square, 2, 0.7)
    marker_itself = Match(0, 100.5 + 25.0 * square, 0, 0.95)
    inner = Match(0, 101.0 + 2.5 * square, 0, 0.9)
    other_id = Match(3, 100.0 + 25.0 * square, 0, 0.8)
    beside = Match(0, 100.0 + 25.0 * square + (60.0, 0.0), 0, 0.8)
    found = []
    for match in (panel, marker_itself, panel, inner, other_id, beside):
        add_match(match, found)
    assert found == [marker_itself, inner, other_id, beside]


@pytest.mark.parametrize("outer, inner, distance", [(0, 0, 1.3), (17, 0, 2.0), (0, 17, 3.0)])
def test_a_marker_in_a_cell_of_another_and_the_other(outer, inner, distance):
    layers, size, centre = nested(outer, inner)
    view = View(distance, yaw=12.0)
    large, small = detect(picture(view, *layers)).markers
    assert (large.id, small.id) == (outer, inner)
    assert corner_error(large.corners, true_corners(view, size)) < 0.2
    assert corner_error(small.corners, true_corners(view, 0.1, centre=centre)) < 0.2


def test_a_marker_in_a_cell_in_the_dark():
    layers, size, centre = nested(0, 0, 0.08, black=2.0, white=28.0)
    for seed, (distance, blur) in enumerate([(1.5, 1.0), (1.8, 0.8), (2.2, 0.5)]):
        view = View(distance, yaw=10.0)
        image = image_of(layers, view, background=15.0, blur=blur, noise=5.0, seed=seed)
        large, small = detect(image).markers
        assert corner_error(large.corners, true_corners(view, size)) < 1.5
        assert corner_error(small.corners, true_corners(view, 0.08, centre=centre)) < 1.5


@pytest.mark.parametrize("distance", [1.5, 2.8])
def test_nothing_is_found_in_cells_that_hold_something_else(distance):
    layers, _, centre = nested(0, 0)
    other = Layer(np.kron([[20.0, 220.0], [220.0, 20.0]], np.ones((4, 4))), 0.1, centre)
    for view in (View(distance), View(distance, yaw=30.0)):
        image = image_of([layers[0], other], view, noise=3.0)
        assert ids_of(detect(image)) == [0]


@pytest.mark.parametrize("distance, corner", [(0.4, 0), (0.6, 1), (0.6, 3), (1.5, 2)])
def test_a_marker_with_something_dark_before_a_corner(distance, corner):
    """It is a part of the outline; from near by that was as many px off as it was large."""
    view = View(distance, yaw=2.0, pitch=1.0)
    image = picture(view, marker(black=2.0, white=17.0), background=9.0, noise=1.5)
    corners = true_corners(view)
    half = 0.125 * np.hypot(*(corners[1] - corners[0]))
    low, high = np.rint((corners[corner] - half, corners[corner] + half)).astype(int)
    image[low[1] : high[1], low[0] : high[0]] = 2
    (found,) = detect(image).markers
    others = np.arange(4) != corner
    assert np.abs(found.corners - corners)[others].max() < 1.0


@pytest.mark.parametrize("distance, corner", [(0.6, 0), (0.6, 2), (1.0, 1), (1.5, 3)])
def test_a_marker_with_a_corner_behind_what_is_as_grey_as_the_ground(distance, corner):
    """The marker's black runs into the ground there, and no threshold shows four corners."""
    view = View(distance, yaw=-3.0, roll=1.5)
    cover = Layer(np.full((1, 1), 10.0), 0.05, tuple(corner_points(0.2)[corner, :2]))
    layers = [marker(black=3.0, white=24.0), cover]
    image = image_of(layers, view, background=10.0, blur=0.8, noise=2.7, seed=corner)
    (found,) = detect(image).markers
    others = np.arange(4) != corner
    off = np.abs(found.corners - true_corners(view))
    assert (off < np.maximum(0.5, 3.0 * found.deviations))[others].all()


@pytest.mark.parametrize(
    "refine, least, most", [("pattern", 0.0, 0.05), ("corners", 0.0, 0.2), ("none", 0.2, 2.0)]
)
def test_corners_are_as_good_as_their_refinement(refine, least, most):
    view = View(1.5, yaw=20.0, roll=7.0)
    (found,) = detect(image_of([marker()], view, blur=0.6, noise=1.0), refine=refine).markers
    assert least < np.abs(found.corners - true_corners(view)).max() < most


def test_only_ids_that_were_asked_for():
    image = image_of([marker(5), marker(6, centre=(0.3, 0.0))], View(1.5), samples=4)
    detections = detect(image, ids=(6, 8))
    assert (ids_of(detections), detections.report.other_ids) == ([6], [5])


def test_a_marker_at_the_edge_of_the_image_is_dropped():
    for shift, count in (((0.53, 0.0), 1), ((0.536, 0.0), 0)):
        detections = detect(picture(View(1.0, shift=shift)))
        assert len(detections.markers) == count, shift
        assert detections.report.cropped == [0] * (1 - count)


def test_bits_are_corrected_as_far_as_asked():
    def damaged(count):
        layer = marker(2)
        for row, column in [(2, 2), (3, 5), (6, 4), (5, 7)][:count]:
            layer.cells[row, column] = 240.0 - layer.cells[row, column]
        return image_of([layer], View(1.0), samples=4)

    # 36h10 could correct four.
    assert [m.bit_errors for m in detect(damaged(2)).markers] == [2]
    assert detect(damaged(3)).markers == []
    assert [m.bit_errors for m in detect(damaged(4), correction=1.0).markers] == [4]
    assert detect(damaged(1), correction=0.0).markers == []


def test_misread_cells_of_the_border_are_counted(monkeypatch):
    layer = marker(2)
    # Grey, so that the outline is seen, and nearer to white.
    for place in (3, 5, 6):
        layer.cells[1, place] = layer.cells[place, 1] = 130.0
    image = image_of([layer], View(1.0), samples=4)
    assert detect(image).markers == []
    monkeypatch.setattr(marker_detector, "_BORDER_RATE", 0.5)
    assert ids_of(detect(image)) == [2]


# Light


@pytest.mark.parametrize(
    "black, white, background, noise",
    [
        (4.0, 18.0, 8.0, 0.5),
        (205.0, 255.0, 250.0, 1.0),
        (8.0, 35.0, 250.0, 0.5),
        (20.0, 220.0, 120.0, 12.0),
        (90.0, 115.0, 100.0, 2.0),
    ],
    ids=["dark", "bright", "back-lit", "noisy", "faint"],
)
def test_light(black, white, background, noise):
    for distance in (0.6, 2.5):
        view = View(distance, yaw=10.0, pitch=3.0)
        layers = [marker(black=black, white=white)]
        image = image_of(layers, view, background=background, noise=noise, samples=4)
        (found,) = detect(image).markers
        assert corner_error(found.corners, true_corners(view)) < 0.5


def test_light_that_changes_across_the_marker():
    image = picture(View(0.5)).astype(float)
    light = np.interp(np.arange(image.shape[1]), (260, 400), (0.15, 1.0))
    for brightness in (light, light[::-1]):
        lit = np.rint(image * brightness).astype(np.uint8)
        assert ids_of(detect(lit, correction=0.0)) == [0]


def test_the_second_pass_is_made_only_where_nothing_was_found():
    bright = picture(View(2.0))
    assert not detect(bright).report.second_pass
    # The contrast is less than the first pass needs, in an image of full range.
    faint = image_of([marker(black=100.0, white=106.0)], View(1.0), background=103.0, samples=4)
    faint[:40] = 255
    faint[-40:] = 0
    detections = detect(faint)
    assert (ids_of(detections), detections.report.second_pass) == ([0], True)
    assert detect(faint, second_pass=False).markers == []


# False ones


def dots(chance, noise):
    """As figure 8: dots on white, some of them square."""
    image = np.full((480, 640), 230, np.uint8)
    radius = chance.uniform(1.5, 8.0)
    for u, v in chance.uniform(0.0, 1.0, (chance.integers(200, 1500), 2)) * (640, 480):
        centre = (int(u), int(v))
        if chance.random() < 0.3:
            other = (int(u + 2 * radius), int(v + 2 * radius))
            cv2.rectangle(image, centre, other, int(chance.integers(0, 60)), -1)
        else:
            cv2.circle(image, centre, int(radius + 0.5), int(chance.integers(0, 60)), -1)
    values = image + chance.normal(0.0, noise, image.shape)
    return np.clip(values, 0, 255).astype(np.uint8)


def test_what_has_no_height_is_no_quadrilateral():
    """A docking ended by an index of -2**63."""
    line = np.array([[456.6, 328.5], [456.6, 328.5], [449.7, 328.5], [449.7, 328.5]])
    square = np.array([[10.0, 10.0], [50.0, 10.0], [50.0, 50.0], [10.0, 50.0]])
    assert sound_quads(np.stack((line, square, square * np.inf, square))).shape == (2, 4, 2)


def test_no_marker_in_dots():
    chance = np.random.default_rng(8)
    for _ in range(6):
        assert detect(dots(chance, chance.uniform(0.0, 6.0))).markers == []


def test_a_square_among_more_dots_than_16_bits_can_number():
    image = np.full((720, 960), 220, np.uint8)
    image[::2, ::2] = 20
    assert (image == 20).sum() > 2**16
    image[600:650, 700:750] = 220
    image[610:640, 710:740] = 20
    quads = CandidateSearch(image, min_side=8.0).first_pass(contrast=7.0)
    low, high = quads.min(axis=1), quads.max(axis=1)
    off = np.abs(low - (709.5, 609.5)) + np.abs(high - (739.5, 639.5))
    assert off.sum(axis=1).min() < 0.1


@pytest.mark.parametrize("edge", [16, 48])
def test_a_dark_square_in_a_small_image(edge):
    image = np.full((edge, edge + 1), 220, np.uint8)
    image[2:-2, 2:-2] = 20
    assert detect(image, min_side=5.0).report.quads == 1


def test_the_reason_why_nothing_is_found():
    name = "DICT_APRILTAG_36h10"
    empty = np.full((480, 640), 5, np.uint8)
    assert "flat" in why_nothing(detect(empty).report, name)
    assert "flat" in why_nothing(detect(empty, BENT).report, name)
    empty[:20, :20] = 60
    assert "dark (mean" in why_nothing(detect(empty).report, name)
    squares = np.full((480, 640), 200, np.uint8)
    squares[100:200, 100:200] = 30
    assert "1 dark quadrilaterals" in why_nothing(detect(squares).report, name)
    other = picture(View(1.0), marker(5))
    assert "marker 5 seen" in why_nothing(detect(other, ids=(0,)).report, name)
    cropped = picture(View(1.0, shift=(0.5365, 0.0)), marker(5))
    assert "marker 5 cut off" in why_nothing(detect(cropped).report, name)


def test_white_markers_on_black_are_an_option():
    layers = [marker(3, black=220.0, white=20.0)]
    negative = picture(View(1.5, yaw=10.0), *layers)
    assert ids_of(detect(negative)) == []
    (found,) = detect(negative, inverted=True).markers
    assert found.id == 3
    assert corner_error(found.corners, true_corners(View(1.5, yaw=10.0))) < 0.05


# What is refused, and the rest


def test_images_that_are_none():
    for shape, kind in (((480, 640), float), ((4, 4), np.uint8), ((48, 64, 2), np.uint8)):
        with pytest.raises(VisionError):
            detect(np.zeros(shape, kind))


@pytest.mark.parametrize(
    "wrong",
    [
        {"tags": "x"},
        {"refine": "all"},
        {"ids": (2320,)},
        {"ids": (-1,)},
        {"border": -1.0},
        {"min_side": 2.0},
        {"correction": 1.5},
        {"contrast": float("nan")},
    ],
    ids=str,
)
def test_settings_that_are_not_allowed(wrong):
    with pytest.raises(ParameterError):
        DetectorSettings(**wrong)


@pytest.mark.parametrize("sigma", [0.0, 4.0])
def test_noise_is_measured(sigma):
    image = picture(View(1.0), noise=sigma)
    assert noise_level(image) == pytest.approx(sigma, rel=0.1, abs=0.05)


def test_the_number_of_tries_is_bounded(monkeypatch):
    image = np.full((480, 640), 200, np.uint8)
    for v in range(10, 460, 24):
        for u in range(10, 620, 24):
            image[v : v + 14, u : u + 14] = 20
    for count in (20, 50):
        monkeypatch.setattr(marker_detector, "_MOST_QUADS", count)
        assert detect(image, second_pass=False).report.quads == count
