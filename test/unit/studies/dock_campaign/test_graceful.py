"""Tests of the control law, the filter and the stages of the controller beside ours."""

import math
from dataclasses import replace

import docking_standin as standin
import numpy as np
import pytest
from shared import cases

from bullet_lab.core import se2
from bullet_lab.docking.geometry import Viewpoint, corner_points
from bullet_lab.docking.types import CameraMount, DockingError
from bullet_lab.studies.dock_campaign.graceful import (
    NAV2,
    GracefulSettings,
    GracefulTask,
    filtered,
    graceful_command,
    marker_poses,
)


@cases("heading: [-2.0, 0.1]")
def test_a_target_straight_ahead_is_the_closed_form(heading):
    # With delta = 0 it is the slow subsystem's steering alone.
    v, w = graceful_command((1.5, 0.0, heading), NAV2)
    curvature = -2.0 * math.atan(3.0 * heading) / 1.5
    speed = 0.25 / (1.0 + 0.4 * curvature**2)
    assert w == pytest.approx(curvature * max(speed, 0.1))
    assert v == pytest.approx(max(speed, 0.1))


def test_speeds_are_limited_and_keep_the_arc():
    rng = np.random.default_rng(1)
    for target in rng.uniform(-1.0, 1.0, (300, 3)) * (2.0, 2.0, math.pi):
        v, w = graceful_command(target, NAV2)
        assert 0.0 < v <= 0.25
        assert abs(w) <= 0.75 + 1e-12
        mirrored = graceful_command(target * (1.0, -1.0, -1.0), NAV2)
        assert mirrored == pytest.approx((v, -w))
        # Backwards is forwards with the robot's back as its front.
        behind = graceful_command((-target[0], target[1], -target[2]), NAV2, backwards=True)
        assert behind == pytest.approx((-v, -w))


def test_it_leads_to_the_pose():
    settings = GracefulSettings(v_linear_min=0.01)
    for start in [(-2.0, 0.6, 0.5), (-1.0, -0.8, -1.0), (0.3, 1.5, 3.0)]:
        pose = np.array(start)
        for _ in range(4000):
            if math.hypot(pose[0], pose[1]) < 0.01:
                break
            v, w = graceful_command(se2.inverse(pose), settings)
            pose = se2.compose(pose, (0.02 * v, 0.0, 0.02 * w))
        assert math.hypot(pose[0], pose[1]) < 0.01
        assert abs(pose[2]) < 0.02


def test_the_filter_forgets_geometrically_and_over_the_half_turn():
    pose = np.array([0.0, 0.0, 3.1])
    for _ in range(20):
        pose = filtered(pose, np.array([1.0, -2.0, -3.1]), 0.1)
    left = 0.9**20
    assert pose[:2] == pytest.approx([1.0 - left, -2.0 + 2.0 * left])
    assert math.remainder(pose[2] + 3.1, math.tau) == pytest.approx(
        left * (6.2 - math.tau), abs=1e-12
    )


@pytest.mark.parametrize("mount", [standin.MOUNT, CameraMount(0.1, 0.05, 0.6, 0.02, 0.1, -0.2)])
def test_an_image_gives_the_pose_of_the_dock(mount):
    dock = np.array([1.2, 0.2, 0.4])
    corners = corner_points(np.array([*dock, 0.5, 0.0]), 0.2)
    view = Viewpoint(standin.CAMERA, mount)
    poses = marker_poses(view.pixels(view.optical(corners)), 0.2, standin.CAMERA, mount)
    assert min(np.abs(pose - dock).max() for pose in poses) < 1e-5


def test_what_is_no_marker_has_no_pose():
    assert marker_poses(np.zeros((4, 2)), 0.2, standin.CAMERA, standin.MOUNT) == []


def docking(start, seen=lambda seconds: True, settings=NAV2):
    """Dock with a robot that does at once what it is told to; return how it went."""

    class Task(GracefulTask):
        def add_observation(self, observation):
            hidden = replace(observation, sightings=())
            super().add_observation(observation if seen(observation.stamp) else hidden)

    stand = standin.Stand(start, walls=False, lag=0.0, settings=settings)
    dock = standin.make_dock(stand)
    feed = standin.Feed(Task(dock, dock.pose, standin.MOUNT, settings), stand)
    feed.run()
    return feed


@pytest.mark.parametrize(
    ("start", "seen", "retries"),
    [
        ((0.8, 0.1, 0.1), lambda seconds: True, 0),
        # Lost on the way, it goes back and tries again.
        ((1.0, 0.0, 0.0), lambda seconds: not 5.0 < seconds < 9.0, 1),
    ],
)
def test_it_stops_within_its_threshold(start, seen, retries):
    feed = docking(start, seen)
    result = feed.task.result
    ahead, beside, _ = se2.between(feed.stand.dock, feed.pose)
    assert result.success
    assert math.hypot(-ahead - 0.56, beside) < 0.06
    assert result.lateral == pytest.approx(beside, abs=0.005)
    assert result.retries >= retries


def test_it_waits_for_the_marker_and_then_says_that_it_is_not_there():
    feed = docking((0.8, 0.1, 0.1), seen=lambda seconds: False)
    assert feed.task.result.error == DockingError.NOT_DETECTED


def test_without_retries_it_says_why():
    settings = GracefulSettings(max_retries=0, dock_approach_timeout=2.0)
    result = docking((1.0, 0.0, 0.0), settings=settings).task.result
    assert result.error == DockingError.CONTROL_FAILED
    assert "not reached" in result.message
