"""A docking station in a few lines: a robot that rolls, a camera that gives corners.

It stands in for the simulation where thousands of dockings are wanted. What it knows of walls and
sight is written anew here, so that an error in `bullet_lab.docking.geometry` shows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np
from recorded_paths import make_rule

from bullet_lab.core import se2
from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.docking.database import Dock, DockMarker, DockTolerance, DockUncertainty, DockWalls
from bullet_lab.docking.task import DockingTask
from bullet_lab.docking.types import CameraMount, DockingSettings, Observation, Odometry, Sighting
from bullet_lab.noise.odometry_noise import NoisyPath

CAMERA = PinholeCamera(640, 480, 502.3, 502.3, 319.5, 239.5)
MOUNT = CameraMount(0.16, 0.0, 0.44)
TICK = 0.05
DICTIONARY = "DICT_APRILTAG_36h10"
WALL_SEGMENTS = (  # inner outline of the U, in the dock's frame
    ((-2.0, 0.5), (0.0, 0.5)),
    ((-2.0, -0.5), (0.0, -0.5)),
    ((-2.0, 0.7), (0.2, 0.7)),
    ((-2.0, -0.7), (0.2, -0.7)),
    ((-2.0, 0.5), (-2.0, 0.7)),
    ((-2.0, -0.5), (-2.0, -0.7)),
    ((0.2, -0.7), (0.2, 0.7)),
    ((0.001, -0.5), (0.001, 0.5)),
)
WALL_BOXES = ((0.0, 0.2, -0.7, 0.7), (-2.0, 0.2, 0.5, 0.7), (-2.0, 0.2, -0.7, -0.5))


@dataclass(frozen=True)
class Print:
    """A printed marker: pose (x, y, yaw) of its face in the dock's frame, height, size (m)."""

    pose: Tuple[float, float, float] = (0.0, 0.0, 0.0)
    height: float = 0.5
    size: float = 0.2
    id: int = 0


@dataclass(frozen=True)
class Stand:
    """What a docking in the stand-in is made of."""

    start: Tuple[float, float, float]
    dock_error: Tuple[float, float, float] = (0.0, 0.0, 0.0)
    dock: Tuple[float, float, float] = (4.0, 0.0, 0.0)
    prints: Tuple[Print, ...] = (Print(),)
    walls: bool = True
    marker: DockMarker = DockMarker(DICTIONARY, 0, 0.2, 0.5)
    image_rate: float = 5.0
    pixel_noise: float = 0.2
    dropout: float = 0.03
    tilt: float = math.radians(0.05)
    model: str = "report"
    std: float = 0.0
    seed: int = 0
    obstacles: Tuple[Tuple[float, float, float, float], ...] = ()
    camera: CameraMount = MOUNT  #: where it really is
    settings: object = DockingSettings()  #: of the controller
    lag: float = 0.04  #: s, of the wheels
    late: float = 0.0  #: s, of the images


def make_dock(stand: Stand) -> Dock:
    """Return the database entry, wrong as the stand says."""
    x, y, yaw = (a + b for a, b in zip(stand.dock, stand.dock_error))
    return Dock(
        "dock", "odom", (x, y, yaw), stand.marker,
        DockWalls(1.0, 2.0, 0.2) if stand.walls else None,
        3.0, 0.40,
        DockTolerance(0.005, 0.005, math.radians(0.4)),
        DockUncertainty(0.3, math.radians(10.0)),
    )  # fmt: skip


def touches(pose, boxes) -> bool:
    """Say whether the robot's square touches boxes, all in one frame."""
    outline = [
        corner for e in np.linspace(-0.2, 0.2, 9) for side in (-0.2, 0.2)
        for corner in ((e, side, 0.0), (side, e, 0.0))
    ]  # fmt: skip
    x, y, _ = se2.compose(pose, np.array(outline)).T
    corners = [(x, y, 0.0) for x0, x1, y0, y1 in boxes for x in (x0, x1) for y in (y0, y1)]
    local = np.abs(se2.between(pose, np.array(corners))[:, :2])
    return (local <= 0.2).all(axis=1).any() or any(
        ((x0 <= x) & (x <= x1) & (y0 <= y) & (y <= y1)).any() for x0, x1, y0, y1 in boxes
    )


def _crosses(a, b, c, d) -> bool:
    """Say whether the segments ab and cd cross."""

    def side(p, q, r):
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    return side(a, b, c) * side(a, b, d) < 0.0 and side(c, d, a) * side(c, d, b) < 0.0


def see_print(robot, shown: Print, stand: Stand, rng) -> Optional[np.ndarray]:
    """Return the corners of a print for a robot pose in the dock's frame; None if not found."""
    mount, half = stand.camera, 0.5 * shown.size
    left_and_up = half * np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
    offsets = np.zeros((4, 3))
    offsets[:, 1] = left_and_up[:, 0]
    corners = se2.compose(shown.pose, offsets)
    eye = se2.compose(robot, (mount.x, mount.y, 0.0))
    there = se2.between(eye, corners)
    there[:, 2] = shown.height + left_and_up[:, 1] - mount.z
    ahead, left, rise = (there @ mount.rotation).T
    tilt = rng.normal(0.0, stand.tilt) if stand.tilt else 0.0
    rise = rise - tilt * ahead
    if np.min(ahead) < 0.05:
        return None
    behind, aside, _ = se2.between(shown.pose, eye)
    range_ = math.hypot(behind, aside)
    if -behind / range_ < math.cos(math.radians(65.0)):
        return None
    pixels = CAMERA.project(np.column_stack([-left, -rise, ahead]))
    if np.min(pixels) < 3.0 or np.any(pixels > (636.0, 476.0)):
        return None
    extent = CAMERA.fy * shown.size / range_
    if extent * -behind / range_ < 12.0 or extent < 18.0:
        return None
    if stand.walls:
        quiet = se2.compose(shown.pose, 1.25 * offsets)
        if abs(shown.pose[0]) < 0.1:  # what is printed on the back wall ends there
            quiet[:, 1] = np.clip(quiet[:, 1], -0.48, 0.48)
        ends = quiet[:, :2] - (2e-3, 0.0)
        if any(_crosses(eye, end, *segment) for end in ends for segment in WALL_SEGMENTS):
            return None
    if rng.random() < stand.dropout + (0.2 if extent < 22.0 else 0.0):
        return None
    return pixels + rng.normal(0.0, stand.pixel_noise, (4, 2))


class Feed:
    """Feeds a task with what its robot sees, and moves the robot; things go wrong when asked to.

    Attributes:
        pose: true, of the robot.
        now: s since the start.
        moved: the way (m) and turn (rad) so far, together.
        contact: whether the robot touches a wall, which ends the run.
        images: whether any come; likewise `odometry`.
        blocked: whether the wheels turn in vain.
    """

    def __init__(self, task, stand: Stand):
        self.task, self.stand = task, stand
        self.pose = np.array(stand.start, dtype=float)
        self.now = self.moved = 0.0
        self.images = self.odometry = True
        self.blocked = self.contact = False
        self.speeds = np.zeros(2)
        self._rng = np.random.default_rng((stand.seed, 77))
        self._noise = NoisyPath(make_rule(stand.model, stand.std), stand.seed)
        self._boxes = (WALL_BOXES if stand.walls else ()) + stand.obstacles
        self._next_image, self._waiting = 0.0, []
        # Of a difference in speed, after a tick.
        self._left = math.exp(-TICK / stand.lag) if stand.lag else 0.0

    def run(self, seconds: float = math.inf, until=None) -> None:
        """Tick for some time, or until a state; stops with the task."""
        end = self.now + seconds
        while self.now < end and self.task.result is None and not self.contact:
            self.tick()
            if until is not None and self.task.state == until:
                return
        assert until is None, f"never {until}: {self.task.result}"

    def tick(self) -> None:
        """Give what has come since the tick before, and do what the task commands."""
        noisy = self._noise.update(*self.pose.tolist())
        if self.odometry:
            covariance = noisy.motion_covariance / TICK**2
            self.task.add_odometry(Odometry(self.now, noisy.pose, covariance))
        robot = se2.between(self.stand.dock, self.pose)
        if self.now >= self._next_image - 1e-9:
            self._next_image += 1.0 / self.stand.image_rate
            if self.images and self.task.wants_images:
                self._waiting.append(Observation(self.now, CAMERA, self._sightings(robot)))
        while self._waiting and self._waiting[0].stamp <= self.now - self.stand.late + 1e-9:
            self.task.add_observation(self._waiting.pop(0))
        self.contact = bool(self._boxes) and touches(robot, self._boxes)
        command = np.array(self.task.tick(self.now))
        self.speeds += (1.0 - self._left) * (command - self.speeds)
        if not self.blocked:
            way, turn = TICK * self.speeds
            # Along the chord of the arc.
            self.pose = se2.compose(self.pose, (0.0, 0.0, 0.5 * turn))
            self.pose = se2.compose(self.pose, (way * np.sinc(0.5 * turn / np.pi), 0.0, 0.5 * turn))
            self.moved += abs(way) + abs(turn)
        self.now += TICK

    def _sightings(self, robot) -> Tuple[Sighting, ...]:
        found = [(s, see_print(robot, s, self.stand, self._rng)) for s in self.stand.prints]
        return tuple(Sighting(s.id, DICTIONARY, c) for s, c in found if c is not None)


def run(stand: Stand) -> Feed:
    """Dock once."""
    dock = make_dock(stand)
    task = DockingTask(dock, dock.pose, MOUNT, settings=stand.settings, seed=stand.seed)
    feed = Feed(task, stand)
    feed.run()
    return feed
