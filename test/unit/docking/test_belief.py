"""Tests of what becomes of sightings: one thing in the world is one track."""

from pathlib import Path
from types import SimpleNamespace

import docking_standin as standin
import numpy as np
import pytest
import yaml
from alike import assert_as_before, lines_of
from shared import cases

from bullet_lab.core import se2
from bullet_lab.docking.belief import DockBelief, _association_cost, _inside
from bullet_lab.docking.geometry import MarkerVisibility, Viewpoint, extent_of
from bullet_lab.docking.types import Observation, Odometry, Sighting

STAND = standin.Stand((0.0, 0.0, 0.0), pixel_noise=0.15, dropout=0.0, tilt=0.0, walls=False)


class Lookout:
    """A robot that looks at prints, and what is known from it."""

    def __init__(self, pose=(1.5, 0.0, 0.0)):
        self.rng = np.random.default_rng(2)
        self.pose, self.stamp = np.array(pose), 0.0
        dock = standin.make_dock(STAND)
        self.belief = DockBelief(dock, dock.pose, standin.MOUNT, STAND.settings, self.rng)
        self.belief.add_odometry(Odometry(0.0, tuple(self.pose)))

    def look(self, prints, times=1, step=(0.0, 0.0, 0.0), border=1.0, hidden=0.0):
        """Look at prints some times, after a step each.

        The first is found with so much of its border, and so much of its left is hidden.
        """
        for _ in range(times):
            self.pose = se2.compose(self.pose, step)
            self.stamp += 0.2
            self.belief.add_odometry(Odometry(self.stamp, tuple(self.pose)))
            robot = se2.between(STAND.dock, self.pose)
            shown = [standin.Print(**one) for one in prints]
            seen = [standin.see_print(robot, one, STAND, self.rng) for one in shown]
            seen = [corners for corners in seen if corners is not None]
            for corners in seen[:1]:
                middle = corners.mean(axis=0)
                corners[:] = middle + border * (corners - middle)
                corners[[0, 3], 0] += hidden * extent_of(corners)
            self.seen = tuple(Sighting(0, standin.DICTIONARY, corners) for corners in seen)
            self.belief.observe(Observation(self.stamp, standin.CAMERA, self.seen))

    def known(self):
        """Return all that is known."""
        belief, best = self.belief, self.belief.best()
        tracks = [(t.frames, t.last_seen, t.real, t.sized) for t in belief.tracks]
        view = Viewpoint(standin.CAMERA, standin.MOUNT)
        fits = [_association_cost(t, s, view) for t in belief.tracks for s in self.seen]
        said = [belief.copies_seen(), belief.pending(), belief.copy is None, belief.stands_free()]
        return {
            "tracks": (np.array(tracks), fits),
            "said": [*said, best and belief.cut_off(best)],
            "estimate": belief.estimate(),
            "obstacles": belief.obstacles(),
            "samples": (belief.samples(40)[::13], belief.particles.poses.mean(axis=0)),
        }


# From where the robot looks, and how often at which prints; {} is the marker.
LOOKS = """
found twice in one image, once with the white border, it is one track in the end:
  - [1.5, 0.0, 0.0]
  - {prints: [{}], times: 6}
  - {prints: [{}, {}], border: 1.15}
  - {prints: [{}], times: 3}
three images make a track that two seconds keep in sight:
  - [1.5, 0.0, 0.0]
  - {prints: [{}], times: 2}
  - {prints: [{}]}
  - {prints: [], times: 9}
  - {prints: [], times: 2}
of many prints those seen often stay:
  - [1.5, 0.0, 0.0]
  - {prints: [{}], times: 3}
  - prints:
    - {pose: [0.0, -1.0, 0.0], size: 0.13}
    - {pose: [0.0, -0.75, 0.0], size: 0.13}
    - {pose: [0.0, -0.5, 0.0], size: 0.13}
    - {pose: [0.0, -0.25, 0.0], size: 0.13}
    - {pose: [0.0, 0.0, 0.0], size: 0.13}
    - {pose: [0.0, 0.25, 0.0], size: 0.13}
    - {pose: [0.0, 0.5, 0.0], size: 0.13}
    - {pose: [0.0, 0.75, 0.0], size: 0.13}
    - {pose: [0.0, 1.0, 0.0], size: 0.13}
# Its upper edge leaves the image 0.335 m before the camera, the border's half 0.026 m before.
the image cuts it off with its white border:
  - [2.8, 0.0, 0.0]
  - {prints: [{}], times: 8, step: [0.03, 0.0, 0.0]}
  - {prints: [], step: [0.43, 0.0, 0.0]}
  - {prints: [], step: [0.02, 0.0, 0.0]}
# Too high for the marker, and of any other size: nothing was driven so far that tells.
a print that a wall begins to hide stays the same track:
  - [0.9, 0.3, -0.1]
  - {prints: [{height: 0.62, size: 0.8}], times: 12}
  - {prints: [{height: 0.62, size: 0.8}], times: 8, step: [-0.05, 0.0, 0.0], hidden: 0.03}
short steps move the particles as one long step does:
  - [1.5, 0.0, 0.0]
  - {prints: [], times: 40, step: [0.01, 0.0, 0.002]}
  - {prints: [], step: [0.4, 0.0, 0.0]}
a larger copy is on the dock's wall:
  - [0.5, 0.2, 0.0]
  - {prints: [{pose: [0.0, 0.05, 0.0], height: 0.45, size: 0.8}], times: 30, step: [0.05, 0.0, 0.0]}
  - {prints: [{pose: [0.0, 0.05, 0.0], height: 0.45, size: 0.8}, {}], times: 4}
"""


def test_what_becomes_of_sightings_is_as_before():
    found = {}
    for name, (pose, *looks) in yaml.safe_load(LOOKS).items():
        lookout = Lookout(pose)
        for number, look in enumerate(looks):
            lookout.look(**look)
            found[f"{name} {number}"] = lookout.known()
        belief = lookout.belief
        if belief.estimate() is not None:
            belief.concentrate(belief.estimate(), 0.3)
            belief.forget(belief.best())
            found[f"{name}, forgotten"] = lookout.known()
    # The size of a print that a wall hides depends on how the processor adds.
    assert_as_before(lines_of(found, ""), Path(__file__).with_name("looks.txt"), within=1e-5)


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


@cases("real, share: [[0.95, 1.0], [0.7, 0.7], [0.3, 0.5]]")
def test_as_many_of_the_docks_are_elsewhere_as_a_track_is_doubtful(real, share):
    belief = Lookout().belief
    track = SimpleNamespace(real=real, samples=lambda rng, count: np.full((count, 3), 50.0))
    belief.best = lambda: track
    assert np.mean(belief.samples(100)[:, 1] > 20.0) == share


def test_short_steps_move_the_particles_as_one_long_step_does():
    belief = Lookout().belief
    before = belief.particles.poses
    for count in range(1, 41):
        belief.add_odometry(Odometry(0.05 * count, (1.5 + 0.01 * count, 0.0, 0.0)))
    moved = belief.particles.poses - before
    assert np.mean(moved, axis=0) == pytest.approx((-0.4, 0.0, 0.0), abs=0.01)
    assert np.all(np.std(moved, axis=0) > 0.002)


@cases("""
left, top, right, bottom, within:
  - [3.0, 5.0, 600.0, 470.0, 3.0]
  - [9.0, -1.0, 600.0, 470.0, -1.0]
  - [9.0, 9.0, 637.0, 470.0, 2.0]
  - [9.0, 9.0, 630.0, 478.5, 0.5]
""")
def test_how_far_corners_are_within_an_image(left, top, right, bottom, within):
    corners = np.array([(left, top), (right, top), (right, bottom), (left, bottom)])
    assert _inside(corners, standin.CAMERA) == pytest.approx(within)
