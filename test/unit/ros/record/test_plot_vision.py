from types import SimpleNamespace

import message_filters
import pytest
import rospy
from shared import cases, refuses

from bullet_lab.ros.node.node import NodeError
from bullet_lab.ros.record import plots

TOPICS = dict.fromkeys("abc", "sensor_msgs/Image")


class Detector(message_filters.SimpleFilter):
    """The subscriber of one topic."""

    def __init__(self, topic, kind, **options):
        super().__init__()
        self.sub = SimpleNamespace(get_num_connections=lambda: 1, unregister=lambda: None)
        self.all[topic] = self


@pytest.fixture
def first(monkeypatch):
    """A function that returns the answers to the first image, when answers come.

    "a1 b2" is a's answer to image 1, stamped 0.1 s, and b's to 2.
    """
    monkeypatch.setattr(Detector, "all", {}, raising=False)
    monkeypatch.setattr(message_filters, "Subscriber", Detector)
    # The synchronizer asks what time it is.
    monkeypatch.setattr(rospy.Time, "now", lambda: rospy.Time(1))

    def first(answers, settle=0.0, timeout=60.0):
        def come(*_):
            for topic, number in answers.split():
                header = SimpleNamespace(stamp=rospy.Time(0, 100_000_000 * int(number)))
                message = SimpleNamespace(header=header, of=topic + number)
                Detector.all[topic].signalMessage(message)

        monkeypatch.setattr(plots, "join_when", come)
        found = plots.first_image(TOPICS, settle, timeout)
        assert list(found) == list(TOPICS)
        return " ".join(message.of for message in found.values())

    return first


@cases("""
answers, found:
  - [a1 b1 c1 a2 b2 c2, a1 b1 c1]
  # Each misses some, and is as late as it likes.
  - [a1 b2 c1 a2 c2 b3, a2 b2 c2]
  - [a1 a2 a3 b1 b2 b3 c2 c3, a2 b2 c2]
  # That the first image is whole comes later.
  - [a1 a2 b2 c2 b1 c1, a2 b2 c2]
""")
def test_the_answers_are_those_of_the_first_image_that_all_have_answered(first, answers, found):
    assert first(answers) == found


def test_images_before_the_settling_do_not_count(first):
    assert first("a1 b1 c1 a2 b2 c2 a3 b3 c3 a4 b4 c4", settle=0.25) == "a3 b3 c3"


def test_a_silent_detector_is_named(first):
    with refuses(r"^nothing on a, c within 0\.05 s$", NodeError):
        first("b1", timeout=0.05)
