from types import SimpleNamespace

import numpy as np
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


def answer(topic, number):
    return SimpleNamespace(
        header=SimpleNamespace(stamp=rospy.Time(0, 100_000_000 * number)), of=(topic, number)
    )


def first_whole(arrivals):
    """Return the number of the image whose answers are complete first, by hand."""
    have = {topic: set() for topic in TOPICS}
    for topic, number in arrivals:
        have[topic].add(number)
        common = set.intersection(*have.values())
        if common:
            return min(common)
    return None


@pytest.mark.parametrize("seed", range(10))
def test_the_answers_are_those_of_the_first_image_that_all_have_answered(receive, seed):
    answers = plot_vision.SameImage(TOPICS, settle=0.0)
    rng = np.random.default_rng(seed)
    # Each detector answers in order, misses some, and is as late as it likes.
    queues = {t: [n for n in range(1, 10) if rng.random() < 0.7] for t in TOPICS}
    for queue in queues.values():
        queue.append(10)
    arrivals = []
    while any(queues.values()):
        topic = rng.choice([t for t, queue in queues.items() if queue])
        arrivals.append((topic, queues[topic].pop(0)))
    for topic, number in arrivals:
        receive[topic](answer(topic, number))
    found = answers.wait(60.0)
    expected = first_whole(arrivals)
    assert {t: message.of for t, message in found.items()} == {t: (t, expected) for t in TOPICS}


def test_images_before_the_settling_do_not_count(receive):
    answers = plot_vision.SameImage(TOPICS, settle=0.25)
    for number in (1, 2, 3, 4):
        for topic in TOPICS:
            receive[topic](answer(topic, number))
    assert {message.of[1] for message in answers.wait(60.0).values()} == {3}


def test_answers_to_different_images_are_better_than_none(receive, monkeypatch):
    monkeypatch.setattr(plot_vision, "_PATIENCE", 0.05)
    answers = plot_vision.SameImage(TOPICS, settle=0.0)
    for topic, number in (("a", 1), ("b", 2), ("c", 3), ("a", 4)):
        receive[topic](answer(topic, number))
    assert {t: m.of[1] for t, m in answers.wait(60.0).items()} == {"a": 4, "b": 2, "c": 3}


def test_a_silent_detector_is_named(receive):
    answers = plot_vision.SameImage(TOPICS, settle=0.0)
    receive["b"](answer("b", 1))
    with pytest.raises(NodeError, match=r"^nothing on a, c within 0\.05 s$"):
        answers.wait(0.05)
