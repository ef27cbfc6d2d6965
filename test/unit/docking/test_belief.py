"""Tests of what becomes of sightings: one thing in the world is one track."""

from types import SimpleNamespace

import docking_standin as standin
import numpy as np
import pytest
from shared import cases

from bullet_lab.core import se2
from bullet_lab.docking.belief import DockBelief
from bullet_lab.docking.geometry import MarkerVisibility, extent_of
from bullet_lab.docking.types import Observation, Odometry, Sighting

STAND = standin.Stand((0.0, 0.0, 0.0), pixel_noise=0.15, dropout=0.0, tilt=0.0, walls=False)
MARKER, COPY = standin.Print(), standin.Print((0.0, 0.9, 0.0), 0.5, 0.35)


class Lookout:
    """A robot that looks at prints, and what is known from it."""

    def __init__(self, pose=(1.5, 0.0, 0.0)):
        self.rng = np.random.default_rng(2)
        self.pose, self.stamp = np.array(pose), 0.0
        dock = standin.make_dock(STAND)
        self.belief = DockBelief(dock, dock.pose, standin.MOUNT, STAND.settings, self.rng)
        self.belief.add_odometry(Odometry(0.0, tuple(self.pose)))

    def look(self, *prints, times=1, step=(0.0, 0.0, 0.0), changes=(np.copy, np.copy)):
        """Look at prints some times, after a step each; return the tracks."""
        for _ in range(times):
            self.pose = se2.compose(self.pose, step)
            self.stamp += 0.2
            self.belief.add_odometry(Odometry(self.stamp, tuple(self.pose)))
            robot = se2.between(STAND.dock, self.pose)
            seen = [standin.see_print(robot, shown, STAND, self.rng) for shown in prints]
            sightings = tuple(
                Sighting(0, standin.DICTIONARY, change(corners))
                for change, corners in zip(changes, seen)
            )
            self.belief.observe(Observation(self.stamp, standin.CAMERA, sightings))
        return self.belief.tracks


def test_the_same_look_again_tells_no_more_where_it_may_be_too_dark():
    particles = Lookout().belief.particles
    visibility = MarkerVisibility(standin.make_dock(STAND), standin.CAMERA, standin.MOUNT.z)
    camera = np.tile((-0.85 * visibility.farthest, 0.0, 0.0), (len(particles.poses), 1))
    left = []
    for _ in range(6):
        particles.learn(1.0 - 0.75 * visibility.found(camera, particles.reach))
        left.append(particles.mass)
    # It would be found in good light from there, so what is left is darker.
    assert 0.3 < left[-1] < left[0] < 0.6
    assert np.average(particles.reach, weights=particles.weights) < 0.8


def test_a_place_where_the_marker_was_missed_may_have_walls():
    belief = Lookout().belief
    for _ in range(8):
        belief.particles.learn(1.0 - 0.95 * (belief.particles.poses[:, 1] > 0.0))
    to_the_left = belief.particles.samples(400)[0][:, 1] > 0.0
    assert np.mean(to_the_left) < 0.01
    walls_to_the_left = se2.between(belief.pose, belief.samples(400))[:, 1] > 0.0
    assert 0.01 < np.mean(walls_to_the_left) < 0.05


def test_a_marker_found_twice_in_one_image_is_one_track_in_the_end():
    def white_border(corners):
        middle = corners.mean(axis=0)
        return middle + 1.15 * (corners - middle)

    lookout = Lookout()
    lookout.look(MARKER, times=6)
    first, _ = lookout.look(MARKER, MARKER, changes=(white_border, np.copy))
    # It takes the one that fits.
    assert first.frames == 7
    assert lookout.look(MARKER, times=3) == [first]


@cases("real, share: [[0.95, 1.0], [0.7, 0.7], [0.3, 0.5]]")
def test_as_many_of_the_docks_are_elsewhere_as_a_track_is_doubtful(real, share):
    belief = Lookout().belief
    track = SimpleNamespace(real=real, samples=lambda rng, count: np.full((count, 3), 50.0))
    belief.best = lambda: track
    assert np.mean(belief.samples(100)[:, 1] > 20.0) == share


def test_three_images_make_a_track_that_two_seconds_keep_in_sight():
    lookout = Lookout()
    for times, known in ((2, False), (1, True)):
        lookout.look(MARKER, times=times)
        belief = lookout.belief
        found = belief.best() is not None, belief.copies_seen(), belief.pending()
        assert found == (known, known, not known)
    for times, seen in ((9, True), (2, False)):
        lookout.look(times=times)
        assert lookout.belief.copies_seen() == seen


def test_of_many_prints_those_seen_often_stay():
    lookout = Lookout()
    (marker,) = lookout.look(MARKER, times=3)
    others = [standin.Print((0.0, 0.25 * place, 0.0), size=0.13) for place in range(-4, 5)]
    tracks = lookout.look(*others, changes=[np.copy] * 9)
    assert len(tracks) == 8
    assert marker in tracks


def test_the_image_cuts_a_marker_off_with_its_white_border():
    lookout = Lookout((2.8, 0.0, 0.0))
    (track,) = lookout.look(MARKER, times=8, step=(0.03, 0.0, 0.0))
    # Its upper edge leaves the image 0.335 m before the camera, the border's half 0.026 m before.
    for distance, cut in ((0.37, False), (0.35, True)):
        lookout.belief.add_odometry(Odometry(9.0, (3.84 - distance, 0.0, 0.0)))
        assert lookout.belief.cut_off(track) == cut


def test_a_print_that_a_wall_begins_to_hide_stays_the_same_track():
    def cut(corners):
        """The left edge is the wall's: a fortieth of the marker is hidden."""
        hidden = corners.copy()
        hidden[[0, 3]] += 0.03 * extent_of(corners) * np.array([1.0, 0.0])
        return hidden

    # Too high for the marker, and of any other size: nothing was driven so far that tells.
    large = standin.Print((0.0, 0.0, 0.0), 0.62, 0.8)
    lookout = Lookout((0.9, 0.3, -0.1))
    assert lookout.look(large, times=12)[0].sized < 0.5
    assert len(lookout.look(large, times=8, step=(-0.05, 0.0, 0.0), changes=(cut,))) == 1


def test_short_steps_move_the_particles_as_one_long_step_does():
    belief = Lookout().belief
    before = belief.particles.poses
    for count in range(1, 41):
        belief.add_odometry(Odometry(0.05 * count, (1.5 + 0.01 * count, 0.0, 0.0)))
    moved = belief.particles.poses - before
    assert np.mean(moved, axis=0) == pytest.approx((-0.4, 0.0, 0.0), abs=0.01)
    assert np.all(np.std(moved, axis=0) > 0.002)
