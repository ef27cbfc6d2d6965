"""Tests of driving out of a dock."""

import math

import docking_standin as standin
import pytest
from test_docking_task import PLAIN, Feed

from bullet_lab.docking.task import UndockingTask
from bullet_lab.docking.types import DockingError

DOCKED = (3.44, 0.0, 0.0)
DOCK = standin.make_dock(PLAIN)


class UndockFeed(Feed):
    """Feeds an undocking, which has no states."""

    def run(self, seconds):
        end = self.now + seconds
        while self.now < end and self.task.result is None:
            self.tick()


def test_backs_out_by_a_distance():
    feed = UndockFeed(UndockingTask(0.8, DOCK, DOCK.pose, None), DOCKED)
    feed.run(30.0)
    assert feed.task.result.success
    assert feed.task.remaining == 0.0
    assert feed.pose == pytest.approx((2.64, 0.0, 0.0), abs=0.01)


def test_backs_out_until_it_stands_before_the_dock():
    task = UndockingTask(0.0, DOCK, DOCK.pose, standin.MOUNT)
    feed = UndockFeed(task, (3.44, 0.02, math.radians(3.0)))
    feed.run(60.0)
    assert task.result.success
    assert feed.pose[0] == pytest.approx(1.0, abs=0.03)
    # Straight back it would be 0.13 m off by now; the marker told it where the axis is.
    assert abs(feed.pose[1]) < 0.03


def test_without_a_camera_it_goes_straight():
    task = UndockingTask(0.0, DOCK, DOCK.pose, None)
    feed = UndockFeed(task, DOCKED)
    feed.images = False
    feed.run(60.0)
    assert task.result.success
    assert feed.pose[0] == pytest.approx(1.0, abs=0.2)


def test_stops_when_blocked():
    feed = UndockFeed(UndockingTask(1.0, DOCK, DOCK.pose, None), DOCKED)
    feed.blocked = True
    feed.run(20.0)
    assert feed.task.result.error == DockingError.BLOCKED


def test_odometry_that_stops_is_noticed():
    feed = UndockFeed(UndockingTask(1.0, DOCK, DOCK.pose, None), DOCKED)
    feed.run(1.0)
    feed.odometry = False
    feed.run(5.0)
    assert feed.task.result.error == DockingError.ODOMETRY_LOST
