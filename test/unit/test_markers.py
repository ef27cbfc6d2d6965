"""Marker images and what they are printed on."""

import cv2
import numpy as np
import pytest
from PIL import Image
from shared import cases, complains, refuses

from bullet_lab import markers
from bullet_lab.markers import (
    CLOSEST,
    DOT_RADIUS,
    DOTS_PER_SQUARE_METRE,
    WALL_GREY,
    WALL_PIXELS,
    Print,
    dots_face,
    draw_dots,
    nested_face,
    paste,
    plate_face,
    scatter_dots,
    wall_face,
    write_plate,
)
from bullet_lab.vision.dictionaries import DICTIONARY_NAMES


def detections(image, dictionary="DICT_APRILTAG_36h10"):
    """Return the ids and the (n, 4, 2) corners that OpenCV finds."""
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    corners, ids, _ = cv2.aruco.ArucoDetector(known).detectMarkers(image)
    return ([] if ids is None else ids.ravel().tolist()), np.asarray(corners).reshape(-1, 4, 2)


def seen_from(face, distance):
    """Return the picture of the robot's camera, straight before a face that fills its wall."""
    scale = 502.3 / distance * face.size / len(face.image)
    seen = cv2.resize(face.image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    middle = [[1.0, 0.0, 320 - seen.shape[1] // 2], [0.0, 1.0, 240 - seen.shape[0] // 2]]
    return cv2.warpAffine(seen, np.array(middle), (640, 480), borderValue=60)


def assert_seen(face, distance, identifier, size, tolerance):
    """Check which marker is found from a distance (m), and its size (m)."""
    ids, corners = detections(seen_from(face, distance))
    assert ids == [identifier]
    side = np.linalg.norm(corners[0, 0] - corners[0, 1])
    assert side == pytest.approx(size * 502.3 / distance, rel=tolerance)


@pytest.mark.parametrize("name", DICTIONARY_NAMES)
def test_every_dictionary_has_markers_that_are_found_again(name):
    last = len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)).bytesList) - 1
    for identifier in (0, last):
        assert detections(Print(name, identifier).image(12), name)[0] == [identifier]


@cases("""
face, given, said:
  - [null, {dictionary: apriltag_99}, "no dictionary 'apriltag_99', only DICT_4X4_100"]
  - [null, {dictionary: 4x4_50, identifier: 50}, "4X4_50 has markers 0 to 49, not 50"]
  - [null, {quiet: 0}, "1 to 20 cells wide, not 0"]
  - [null, {size: 0.0}, size is from 0.001]
  - [wall_face, {size: 0.201}, multiple of 0.00625 m]
  - [wall_face, {size: 0.0125}, of four or more]
  - [wall_face, {size: 0.9}, does not fit]
""")
def test_what_cannot_be_printed_is_refused(face, given, said):
    with complains(said):
        wanted = Print(**given)
        getattr(markers, face)(wanted)


def test_what_does_not_fit_is_refused():
    with complains("seed must be an integer >= 0, not -1"):
        dots_face(Print(), -1)
    with complains("cell of 0.1 m"):
        nested_face(Print(size=0.1), Print(size=0.8))
    with complains(r"at \(3, 0\)"):
        paste(np.zeros((4, 4)), np.zeros((2, 2)), 3, 0)


@cases("name, size: [[apriltag_36h10, 0.2], [5x5_100, 0.175]]")
def test_a_wall_has_the_marker_exactly_in_its_middle_and_as_large_as_it_is_said_to_be(name, size):
    image = wall_face(Print(name, 3, size)).image
    assert image.shape == (WALL_PIXELS, WALL_PIXELS)
    wanted = [0.5 * (1.0 - size) * WALL_PIXELS, 0.5 * (1.0 + size) * WALL_PIXELS - 1.0]
    for found in np.nonzero(image == 0):
        assert [found.min(), found.max()] == pytest.approx(wanted)
    assert image[0, 0] == image[-1, -1] == WALL_GREY


def test_dots_are_as_many_as_in_figure_8_and_keep_apart():
    dots = scatter_dots(1.0, 0.4, np.random.default_rng(5))
    assert len(dots) == round(DOTS_PER_SQUARE_METRE * (1.0 - 0.4 * 0.4))
    apart = np.linalg.norm(dots[:, None] - dots[None], axis=2) + np.eye(len(dots))
    assert apart.min() >= CLOSEST
    assert dots.min() >= DOT_RADIUS and dots.max() <= 1.0 - DOT_RADIUS
    nearest = np.clip(dots, 0.3, 0.7)
    assert np.linalg.norm(dots - nearest, axis=1).min() > DOT_RADIUS


def test_the_ink_of_a_dot_is_that_of_its_disc():
    canvas = np.full((100, 100), 255, dtype=np.uint8)
    draw_dots(canvas, np.array([[0.05, 0.0503]]), 0.001)
    ink = (255.0 - canvas) / 255.0
    assert ink.sum() == pytest.approx(np.pi * (DOT_RADIUS / 0.001) ** 2, rel=0.02)
    rows, columns = np.nonzero(ink)
    assert (np.mean(columns), np.mean(rows)) == pytest.approx((49.5, 49.8), abs=0.1)


def test_too_many_dots_are_refused_rather_than_searched_for_ever(monkeypatch):
    monkeypatch.setattr("bullet_lab.markers.DOTS_PER_SQUARE_METRE", 20000.0)
    monkeypatch.setattr("bullet_lab.markers.TRIES_PER_DOT", 3)
    with refuses("no room for 200 dots"):
        scatter_dots(0.1, 0.0, np.random.default_rng(1))


def test_dots_leave_the_marker_and_its_quiet_zone_alone():
    face, bare = dots_face(Print(), 1), wall_face(Print())
    assert np.array_equal(face.image[480:800, 480:800], bare.image[480:800, 480:800])
    assert detections(seen_from(face, 2.0))[0] == [0]
    face.image[480:800, 480:800] = 255
    assert detections(seen_from(face, 2.0))[0] == []


def test_the_marker_around_another_one_is_itself_valid():
    wanted, around = Print(size=0.075), Print(identifier=7, size=0.8)
    face = nested_face(wanted, around)
    middle = face.image[590:690, 590:690]
    assert np.array_equal(middle[2:-2, 2:-2], wanted.image(12)[12:-12, 12:-12])
    face.image[590:690, 590:690] = 255
    assert_seen(face, 2.0, 7, 0.8, 0.01)


@cases("distance, size: [[0.4, 0.075], [1.0, 0.075], [3.0, 0.8], [6.0, 0.8]]")
def test_nearby_the_wanted_marker_is_found_and_from_afar_the_one_around_it(distance, size):
    assert_seen(nested_face(Print(size=0.075), Print(size=0.8)), distance, 0, size, 0.03)


def test_a_plate_shows_the_marker_with_its_quiet_zone(tmp_path):
    face = plate_face(Print(size=0.2))
    assert face.size == pytest.approx(0.25)
    assert (face.image[:32] == 255).all() and (face.image[32:64, 32:-32] == 0).all()
    *_, png = write_plate(face, 0.02, tmp_path / "new", "plate")
    assert np.array_equal(np.asarray(Image.open(png)), face.image)
