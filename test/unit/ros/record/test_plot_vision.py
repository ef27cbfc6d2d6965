from types import SimpleNamespace

import pytest
import rospy

from bullet_lab.ros.node.node import NodeError
from bullet_lab.ros.record import plot_vision

TOPICS = dict.fromkeys("abc", "sensor_msgs/Image")


@pytest.fixture
def receive(monkeypatch):
    """What the subscribers would call, by topic."""
    receivers = {}

    def subscriber(topic, kind, receive):
        receivers[topic] = receive
        return SimpleNamespace(get_num_connections=lambda: 1, unregister=lambda: None)

    monkeypatch.setattr(plot_vision, "subscriber", subscriber)
    # The synchronizer asks what time it is.
    monkeypatch.setattr(rospy.Time, "now", lambda: rospy.Time(1))
    monkeypatch.setattr(rospy, "is_shutdown", lambda: False)
    return receivers


def send(receive, answers):
    """Have detectors answer: "a1 b2" is a's answer to image 1, stamped 0.1 s, and b's to 2."""
    for topic, number in answers.split():
        stamp = rospy.Time(0, 100_000_000 * int(number))
        receive[topic](SimpleNamespace(header=SimpleNamespace(stamp=stamp), of=topic + number))


def wait(answers, seconds=60.0):
    found = answers.wait(seconds)
    assert list(found) == list(TOPICS)
    return " ".join(message.of for message in found.values())


@pytest.mark.parametrize(
    ("answers", "found"),
    [
        ("a1 b1 c1 a2 b2 c2", "a1 b1 c1"),
        # Each misses some, and is as late as it likes.
        ("a1 b2 c1 a2 c2 b3", "a2 b2 c2"),
        ("a1 a2 a3 b1 b2 b3 c2 c3", "a2 b2 c2"),
        # That the first image is whole comes later.
        ("a1 a2 b2 c2 b1 c1", "a2 b2 c2"),
    ],
)
def test_the_answers_are_those_of_the_first_image_that_all_have_answered(receive, answers, found):
    image = plot_vision.SameImage(TOPICS, settle=0.0)
    send(receive, answers)
    assert wait(image) == found


def test_images_before_the_settling_do_not_count(receive):
    image = plot_vision.SameImage(TOPICS, settle=0.25)
    send(receive, "a1 b1 c1 a2 b2 c2 a3 b3 c3 a4 b4 c4")
    assert wait(image) == "a3 b3 c3"


def test_answers_to_different_images_are_better_than_none(receive, monkeypatch):
    monkeypatch.setattr(plot_vision, "_PATIENCE", 0.05)
    image = plot_vision.SameImage(TOPICS, settle=0.0)
    send(receive, "a1 b2 c3 a4")
    assert wait(image) == "a4 b2 c3"


def test_a_silent_detector_is_named(receive):
    answers = plot_vision.SameImage(TOPICS, settle=0.0)
    send(receive, "b1")
    with pytest.raises(NodeError, match=r"^nothing on a, c within 0\.05 s$"):
        answers.wait(0.05)
