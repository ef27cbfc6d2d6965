"""What scripts/bench.sh detectors compares with."""

from shared import module_of

contestants = module_of("bench/detectors/contestants.py")


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
