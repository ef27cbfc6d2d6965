"""Tests of the parts of pictures in which a campaign looks for markers."""

from dataclasses import replace

import numpy as np
import pytest

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.camera import Camera
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.studies.dock_campaign.trial import MarkerWatch
from bullet_lab.studies.worlds import ROBOT, read_world
from bullet_lab.vision.images import grey
from bullet_lab.vision.marker_detector import DetectorSettings, MarkerDetector


class Watched:
    """A robot before the dock, and the widths of the pictures that its camera takes."""

    def __init__(self, simulation):
        self.robot = simulation.spawn(ROBOT, pose=Pose((2.0, 0.1, 0.0)))
        self.camera = next(one for one in self.robot.plugins if isinstance(one, Camera))
        # A part would have other noise than a whole picture.
        self.camera.settings = replace(self.camera.settings, noise_mean=0.0, noise_stddev=0.0)
        self.detector = MarkerDetector(DetectorSettings(ids=(0,)))
        self.watch = MarkerWatch(self.camera, self.detector, "apriltag_36h10")
        self.widths, take = [], self.camera.take

        def noted(step):
            self.widths.append(self.camera.camera.width)
            return take(step)

        self.camera.take = noted

    def turn(self, yaw):
        self.robot.place(Pose.from_rpy((2.0, 0.1, 0.0), (0.0, 0.0, yaw)))

    def check(self):
        """Check that the watch finds the marker where it is in a whole picture."""
        (found,) = self.watch.look(0)
        (marker,) = self.detector.detect(grey(self.camera.take(0), "rgb8")).markers
        self.widths.pop()
        assert found.corners == pytest.approx(marker.corners, abs=0.05)


@pytest.fixture
def watched():
    with Simulation(read_world("docking"), 1) as simulation:
        yield Watched(simulation)


def test_a_part_shows_what_the_whole_picture_shows(watched):
    for _ in range(6):
        watched.check()
    assert watched.widths[0] == watched.widths[5] == 640
    assert max(watched.widths[1:5]) <= 192


def test_a_part_follows_a_marker_that_moves_on(watched):
    for yaw in np.arange(4) * 0.04:
        watched.turn(yaw)
        watched.check()
    assert max(watched.widths[-2:]) <= 192


def test_a_marker_that_is_not_in_the_part_is_looked_for_in_the_whole_picture(watched):
    watched.watch.look(0)
    watched.turn(0.4)
    watched.check()
    watched.turn(3.0)
    assert watched.watch.look(0) == watched.watch.look(0) == ()
    assert watched.widths[-1] == watched.widths[-2] == 640
