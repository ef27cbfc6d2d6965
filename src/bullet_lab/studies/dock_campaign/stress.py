"""Stresses: perturbations that docking does not know of, one at a time or several together."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any, Callable, Dict, Sequence

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.docking.database import Dock, DockTolerance
from bullet_lab.docking.types import CalibrationErrors
from bullet_lab.noise.systematic import SystematicErrors, SystematicPath
from bullet_lab.simulation.world.description import Link, Model, Visual, World
from bullet_lab.simulation.world.shapes import Box

FARTHEST_DOCK = 5.0
MOUNT_TURN, MOUNT_SHIFT = 2.0, 0.010  # degrees, m
FOCAL_ERROR, SIZE_ERROR, ODOMETRY_ERROR = 0.02, 0.03, 0.05
LATEST_IMAGE, DROPPED = 0.2, 0.3
BIAS = math.radians(2.0)
COVER = (0.10, 0.25)
# Ends of the names of columns with what docking has found, and factors; "" and 1 for the others.
_FOUND_UNITS = {
    **dict.fromkeys(("roll", "pitch", "yaw"), ("_deg", 180.0 / math.pi)),
    "height": ("_m", 1.0),
}
_IN_FRONT = 0.002
_RUN_STREAM = 1000  # random stream of the draws during a docking
_COVER_THICKNESS = 0.001

SLIP_EVERY = 2.0  # m, mean distance between slips
SLIP_LENGTH = (0.05, 0.2)  # m
SLIP_WAY = 0.3  # largest share by which the reported distance is too long in a slip
SLIP_TURN = 0.1  # rad/m, largest turn that a slip adds


@dataclass(frozen=True)
class Stress:
    """Differences between the truth and what docking knows; by default there are none."""

    #: Of the dock in the room; the start keeps its pose relative to the dock.
    dock_x_m: float = 4.0
    dock_y_m: float = 0.0
    dock_yaw_deg: float = 0.0
    #: Of the camera from its known pose, in its known frame.
    mount_x_m: float = 0.0
    mount_y_m: float = 0.0
    mount_z_m: float = 0.0
    mount_roll_deg: float = 0.0
    mount_pitch_deg: float = 0.0
    mount_yaw_deg: float = 0.0
    focal_error: float = 0.0  #: focal length / the known one - 1
    size_error: float = 0.0  #: of the print / the known one - 1
    latest_image_s: float = 0.0  #: largest delay of an image; it is uniform
    dropped: float = 0.0  #: probability that an image is lost
    #: As in SystematicErrors, the last as gyro_bias_per_metre.
    scale_error: float = 0.0
    base_error: float = 0.0
    bias_rad_per_m: float = 0.0
    slips_per_m: float = 0.0  #: mean number of slips
    hidden_corner: int = -1  #: number of the marker's corner that a cover hides; -1: none
    cover: float = 0.0  #: edge of the cover, as a share of the marker's
    cover_grey: float = 0.0  #: brightness of the cover, 0 to 1
    seed: int = 0  #: of the draws during a docking: delays, losses and slips

    @property
    def mount(self) -> Pose:
        """The camera's pose in its known frame."""
        turn = (self.mount_roll_deg, self.mount_pitch_deg, self.mount_yaw_deg)
        place = (self.mount_x_m, self.mount_y_m, self.mount_z_m)
        return Pose.from_rpy(place, tuple(map(math.radians, turn)))

    @property
    def dock(self) -> PlanarPose:
        """True pose of the dock in the room."""
        return self.dock_x_m, self.dock_y_m, math.radians(self.dock_yaw_deg)

    def known_camera(self, camera: PinholeCamera) -> PinholeCamera:
        """Return a camera as docking knows it."""
        known = 1.0 / (1.0 + self.focal_error)
        return replace(camera, fx=known * camera.fx, fy=known * camera.fy)

    def known_dock(self, dock: Dock) -> Dock:
        """Return a dock as docking knows it."""
        size = dock.marker.size / (1.0 + self.size_error)
        return replace(dock, marker=replace(dock.marker, size=size))

    def costs(self, docked_distance: float) -> tuple[float, float, float]:
        """Return the errors of a docked robot that it cannot observe: m, m and degrees.

        They are along the axis, across it, and in yaw. A relative error of the print or of the
        focal length is one of the distance; a shifted camera looks like a shifted axis.

        >>> Stress(size_error=0.03, mount_y_m=-0.01).costs(0.4)
        (0.012, 0.01, 0.0)
        """
        share = abs((1.0 + self.size_error) * (1.0 + self.focal_error) - 1.0)
        return round(docked_distance * share, 12) + abs(self.mount_x_m), abs(self.mount_y_m), 0.0

    def allowed(self, tolerance: DockTolerance, docked_distance: float) -> DockTolerance:
        """Return a dock's tolerance plus these costs."""
        along, across, _ = self.costs(docked_distance)
        return DockTolerance(tolerance.distance + along, tolerance.lateral + across, tolerance.yaw)


Draw = Callable[[np.random.Generator], Dict[str, Any]]


def _uniform(*limits: tuple[str, float]) -> Draw:
    """Return a function that draws fields, each uniformly within ± a limit."""

    def draw(rng: np.random.Generator) -> dict[str, Any]:
        return {name: limit * rng.uniform(-1.0, 1.0) for name, limit in limits}

    return draw


def _fixed(**values: float) -> Draw:
    return lambda rng: values


def _corner(rng: np.random.Generator) -> dict[str, Any]:
    return {
        "hidden_corner": int(rng.integers(4)),
        "cover": rng.uniform(*COVER),
        "cover_grey": rng.uniform(),
    }


_SHIFTS = [(f"mount_{axis}_m", MOUNT_SHIFT) for axis in "xyz"]
_TURNS = [(f"mount_{axis}_deg", MOUNT_TURN) for axis in ("roll", "pitch", "yaw")]

STRESSES: dict[str, Draw] = {
    "pose": _uniform(
        ("dock_x_m", FARTHEST_DOCK), ("dock_y_m", FARTHEST_DOCK), ("dock_yaw_deg", 180.0)
    ),
    "mount": _uniform(*_SHIFTS, *_TURNS),
    "focal": _uniform(("focal_error", FOCAL_ERROR)),
    "size": _uniform(("size_error", SIZE_ERROR)),
    "latency": _fixed(latest_image_s=LATEST_IMAGE),
    "drops": _fixed(dropped=DROPPED),
    "odometry": _uniform(("scale_error", ODOMETRY_ERROR), ("base_error", ODOMETRY_ERROR)),
    "bias": _uniform(("bias_rad_per_m", BIAS)),
    "slip": _fixed(slips_per_m=1.0 / SLIP_EVERY),
    "corner": _corner,
}
"""Functions that draw the fields of each stress. The number of its random stream is its place
here, so that new ones must come last."""


def draw_stress(names: Sequence[str], seed: int, index: int) -> Stress:
    """Return the stress of an index; the draws of a name do not depend on the other names."""
    values: dict[str, Any] = {}
    for number, (name, draw) in enumerate(STRESSES.items()):
        sequence = np.random.SeedSequence(seed, spawn_key=(index, number))
        if name in names:
            values.update(draw(np.random.default_rng(sequence)))
    sequence = np.random.SeedSequence(seed, spawn_key=(index, _RUN_STREAM))
    return Stress(**values, seed=int(sequence.generate_state(1)[0])) if values else Stress()


def stress_columns(stress: Stress) -> dict[str, Any]:
    """Return the columns of a record with the values that were drawn."""
    return {name: value for name, value in asdict(stress).items() if name != "seed"}


def found_columns(calibration: CalibrationErrors | None) -> dict[str, Any]:
    """Return the columns of a record with the errors that docking estimated; empty for None."""
    columns = {}
    for name, found in zip(CalibrationErrors._fields, calibration or 7 * [(None, None)]):
        unit, scale = _FOUND_UNITS.get(name, ("", 1.0))
        for part, value in zip(("", "_std"), found):
            columns[f"found_{name}{part}{unit}"] = None if value is None else scale * value
    return columns


def world_under(stress: Stress, world: World, known_dock: PlanarPose, dock: Dock) -> World:
    """Return a world with its models moved along with the dock, and the cover of a corner.

    `known_dock` is the pose of the dock in the world's file.
    """
    models = world.models
    if stress.dock != known_dock:
        moved = Pose.on_floor(*se2.compose(stress.dock, se2.inverse(known_dock)).tolist())
        # A plane looks the same from everywhere, and the floor's texture is centred at the origin.
        models = tuple(
            model if model.name == "ground_plane" else replace(model, pose=moved * model.pose)
            for model in models
        )
    if stress.hidden_corner >= 0:
        models = (*models, _cover(stress, dock))
    return replace(world, models=models)


def _cover(stress: Stress, dock: Dock) -> Model:
    """Return a small square in front of a corner of the marker, without collisions."""
    half, grey = 0.5 * dock.marker.size, stress.cover_grey
    edge = stress.cover * dock.marker.size
    left = 1.0 if stress.hidden_corner in (0, 3) else -1.0
    up = 1.0 if stress.hidden_corner in (0, 1) else -1.0
    place = (-_IN_FRONT, left * half, dock.marker.height + up * half)
    square = Visual(
        Box((_COVER_THICKNESS, edge, edge)), Pose(place), (grey, grey, grey, 1.0), "cover"
    )
    pose = Pose.on_floor(*stress.dock)
    return Model("cover", (Link("link", visuals=(square,)),), pose=pose, static=True)


def robot_under(stress: Stress, robot: Model, camera_frame: str) -> Model:
    """Return a robot with its camera at the true pose; the frame is one of `robot.frames`."""
    link, pose = robot.frames[camera_frame]
    return replace(robot, frames={**robot.frames, camera_frame: (link, pose * stress.mount)})


class StressedOdometry:
    """Odometry of true poses, with systematic errors and slips.

    While wheels slip, they turn more than the robot moves.
    """

    def __init__(self, stress: Stress, rng: np.random.Generator):
        self._path = SystematicPath(
            SystematicErrors(
                scale_error=stress.scale_error,
                base_error=stress.base_error,
                gyro_bias_per_metre=stress.bias_rad_per_m,
            )
        )
        self._rate, self._rng = stress.slips_per_m, rng
        self._before: PlanarPose | None = None
        self._reported: PlanarPose = (0.0, 0.0, 0.0)
        self._until_slip, self._slip_left = self._next_slip(), 0.0
        self._slip = 0.0, 0.0

    def update(self, pose: PlanarPose) -> PlanarPose:
        """Return the reported pose for a true pose (m, m, rad)."""
        pose = self._path.update(*pose).pose
        if self._rate == 0.0:
            return pose
        before, self._before = self._before, pose
        if before is None:
            self._reported = pose
            return pose
        step = se2.between(before, pose)
        distance = math.hypot(step[0], step[1])
        more, turn = self._slip_of(distance)
        step = step * (1.0 + more, 1.0 + more, 1.0) + (0.0, 0.0, turn * distance)
        self._reported = tuple(se2.compose(self._reported, step).tolist())
        return self._reported

    def _slip_of(self, distance: float) -> tuple[float, float]:
        """Return the share of distance and the turn (rad/m) that a slip adds to some metres."""
        if self._slip_left > 0.0:
            self._slip_left -= distance
            return self._slip
        self._until_slip -= distance
        if self._until_slip <= 0.0:
            self._until_slip = self._next_slip()
            self._slip_left = self._rng.uniform(*SLIP_LENGTH)
            more = self._rng.uniform(0.0, SLIP_WAY)
            self._slip = more, self._rng.uniform(-SLIP_TURN, SLIP_TURN)
        return 0.0, 0.0

    def _next_slip(self) -> float:
        return self._rng.exponential(1.0 / self._rate) if self._rate else math.inf
