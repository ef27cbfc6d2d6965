"""The dictionaries are OpenCV's, by every name that they go by."""

import cv2
import numpy as np
import pytest
from shared import cases

from bullet_lab.vision import dictionaries
from bullet_lab.vision.dictionaries import DICTIONARY_NAMES, dictionary_named
from bullet_lab.vision.images import Picture, VisionError


def test_every_dictionary_of_opencv_is_there_once():
    numbers = {getattr(cv2.aruco, n) for n in dir(cv2.aruco) if n.startswith("DICT_")}
    assert sorted(numbers) == sorted(getattr(cv2.aruco, n) for n in DICTIONARY_NAMES)


@cases("""
name:
  - apriltag_36h10
  - DICT_APRILTAG_36h10
  - " DICT_APRILTAG_36H10"
""")
def test_names_of_opencv_and_of_the_course(name):
    assert dictionary_named(name).name == "DICT_APRILTAG_36h10"


@cases("""
name:
  - ""
  - apriltag
  - DICT_
  - 4x4
""")
def test_a_name_that_there_is_not_is_refused_with_those_there_are(name):
    with pytest.raises(VisionError, match="DICT_4X4_50"):
        dictionary_named(name)


@cases("name: [apriltag_36h10, 4x4_50, 5x5_1000, 7x7_100]")
def test_patterns_are_those_that_opencv_draws(name):
    dictionary = dictionary_named(name)
    source = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary.name))
    for marker in (0, 1, len(dictionary.codes) - 1):
        side = dictionary.cells + 2
        drawn = cv2.aruco.generateImageMarker(source, marker, side)
        assert np.array_equal(drawn // 255, dictionary.pattern(marker))


def test_a_pattern_that_there_is_not():
    with pytest.raises(VisionError, match="markers 0 to 49"):
        dictionary_named("4x4_50").pattern(50)


def test_distances_are_those_in_the_names_of_the_tags():
    distances = {"16h5": 5, "25h9": 9, "36h10": 10, "36h11": 11}
    for family, distance in distances.items():
        dictionary = dictionary_named(f"apriltag_{family}")
        assert (dictionary.distance, dictionary.max_correction) == (distance, (distance - 1) // 2)


@cases("turns: [0, 1, 2, 3]")
def test_the_nearest_marker_however_turned_and_with_wrong_bits(turns):
    dictionary = dictionary_named("apriltag_36h10")
    pattern = dictionary.pattern(1234)[1:-1, 1:-1]
    # Read from the corner that is the k-th of the marker's.
    bits = np.where(np.rot90(pattern, turns), 1.0, -1.0).ravel()
    assert dictionary.nearest(bits) == (1234, turns, 0)
    bits[[3, 17, 30]] *= -1.0
    assert dictionary.nearest(bits) == (1234, turns, 3)


@pytest.mark.filterwarnings("error")
def test_what_lies_on_the_horizon_of_a_quadrilateral_is_no_marker(monkeypatch):
    monkeypatch.setattr(dictionaries, "homography", lambda quads: np.zeros((len(quads), 3, 3)))
    image = np.full((48, 64), 100, np.uint8)
    assert not dictionaries.may_be_markers(Picture(image), np.zeros((1, 4, 2)), 6).any()
