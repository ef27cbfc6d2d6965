"""Odometry that pauses, and robots that are waited for."""

from types import SimpleNamespace

import pytest
from bullet_lab.msg import ModelDescription, PluginDescription

from bullet_lab.reports.robot import ODOMETRY, TRUTH, Displacement, Robot, RobotReport
from bullet_lab.ros.node.node import NodeError
from bullet_lab.ros.record import try_robot
from bullet_lab.ros.record.robot_parts import SERVICE, VELOCITIES
from bullet_lab.ros.record.try_robot import Trial, _find_robot


class Odometry:
    """Poses one after the other; None pauses."""

    def __init__(self, *poses):
        self.poses, self.patience = list(poses), []

    def newest(self, now, patience):
        self.patience.append(patience)
        pose = self.poses.pop(0)
        if pose is None:
            raise NodeError("no odometry on /odom")
        return pose


@pytest.fixture
def trial(tmp_path):
    made = Trial.__new__(Trial)
    made._report = RobotReport(tmp_path, Robot("cart", odometry="/odom"), {})
    made._rate, made._pauses = SimpleNamespace(now=None), False
    return made


def test_odometry_comes_again_after_a_pause(trial, monkeypatch):
    warnings = []
    monkeypatch.setattr(try_robot.rospy, "logwarn", lambda *words: warnings.append(words))
    first, last = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)
    trial._odometry = Odometry(first, None, None, last, None)
    assert [trial._newest_odometry() for _ in range(5)] == [first, None, None, last, None]
    # What pauses is waited for once.
    assert [patience > 0.0 for patience in trial._odometry.patience] == [
        True, True, False, False, True
    ]  # fmt: skip
    assert (len(warnings), trial._report.pauses) == (2, 2)


def test_the_truth_decides_while_odometry_pauses(trial):
    trial._moved = {TRUTH: Displacement(), ODOMETRY: Displacement()}
    for x in (0.0, 0.5):
        trial._moved[ODOMETRY].add((x, 0.0, 0.0))
    for x in (0.0, 1.1):
        trial._moved[TRUTH].add((x, 0.0, 0.0))
    assert not trial._is_enough("ahead_m", 1.0)
    trial._pauses = True
    assert trial._is_enough("ahead_m", 1.0)


class Clock:
    """Wall time that goes on by what is slept."""

    def __init__(self):
        self.now = 0.0

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds


@pytest.fixture
def found(monkeypatch):
    """What is found where these models come at these times (s), and when."""

    def find(name, path="some.launch", **coming):
        clock = Clock()
        robots = {m: (at, of_world) for m, (at, of_world) in coming.items()}

        def models():
            return [
                ModelDescription(
                    name=name,
                    of_world_file=of_world,
                    plugins=[PluginDescription(inputs=[f"/{name}/go"])],
                )
                for name, (at, of_world) in robots.items()
                if clock.now >= at
            ]

        def subscribed():
            return {f"/{model.name}/go": VELOCITIES for model in models()}

        monkeypatch.setattr(try_robot, "time", clock)
        monkeypatch.setattr(
            try_robot,
            "Master",
            lambda: SimpleNamespace(services={SERVICE}, subscribed=subscribed()),
        )
        monkeypatch.setattr(try_robot, "described", lambda: SimpleNamespace(models=models()))
        monkeypatch.setattr(try_robot.rospy, "ServiceProxy", lambda *_: lambda: None)
        launched = SimpleNamespace(path=path, check=lambda: None)
        monkeypatch.setattr(try_robot.rospy, "is_shutdown", lambda: False)
        return _find_robot(name, launched).name, clock.now

    return find


def test_the_choice_waits_until_all_are_there(found):
    name, when = found("", tb3_1=(5.0, False), tb3_0=(6.0, False))
    assert (name, when < 12.0) == ("tb3_0", True)
    assert found("tb3_1", tb3_1=(5.0, False), tb3_0=(6.0, False))[0] == "tb3_1"


def test_a_robot_of_the_world_file_waits_for_others(found):
    assert found("", robot=(0.0, True))[0] == "robot"
    assert found("", robot=(0.0, True), spawned=(15.0, False))[0] == "spawned"


def test_nothing_comes(found):
    line = "no model 'cart' was spawned within 120 s; .* one of robot$"
    with pytest.raises(NodeError, match=line):
        found("cart", robot=(0.0, True))
