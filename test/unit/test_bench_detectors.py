"""What scripts/bench.sh detectors compares with."""

import numpy as np
from shared import module_of

contestants = module_of("bench/detectors/contestants.py")
photos = module_of("bench/detectors/photos.py")


def test_apriltag_is_freed_before_its_family():
    freed = []

    class Library:
        def apriltag_detector_destroy(self, pointer):
            freed.append("detector")

        def tag36h11_destroy(self, pointer):
            freed.append("family")

    detector = contestants.AprilTag36h11()
    detector.libc = Library()
    detector.__del__()
    assert freed == ["detector", "family"]


def test_what_two_detectors_find_is_one_marker():
    square = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [0.0, 9.0]])
    found = {
        "first": [(1, square)],
        "second": [(1, square + 30.0), (2, square)],
        "third": [(1, square - 1.0)],
    }
    agreed = [sorted(by) for by in photos.consensus(found)]
    assert agreed == [["first", "third"], ["second"], ["second"]]
