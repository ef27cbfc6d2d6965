"""What may be otherwise than docking knows: each stress by itself, or several together."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any, Callable, Dict, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.docking.database import Dock, DockTolerance
from bullet_lab.docking.types import Calibration
from bullet_lab.noise.systematic import SystematicErrors, SystematicPath
from bullet_lab.simulation.world.description import Link, Model, Visual, World
from bullet_lab.simulation.world.shapes import Box

FARTHEST_DOCK = 5.0
MOUNT_TURN, MOUNT_SHIFT = math.radians(2.0), 0.010
FOCAL_ERROR, SIZE_ERROR, ODOMETRY_ERROR = 0.02, 0.03, 0.05
LATEST_IMAGE, DROPPED = 0.2, 0.3
BIAS = math.radians(2.0)
COVER = (0.10, 0.25)
_IN_FRONT = 0.002
_ON_THE_WAY = 1000  # the stream of what is drawn on the way
_COVER_THICKNESS = 0.001

# Slips: on the mean one in so many metres; how long, m; how much more way is told, as a share,
# and what turn is told besides, rad/m.
SLIP_EVERY, SLIP_LENGTH, SLIP_WAY, SLIP_TURN = 2.0, (0.05, 0.2), 0.3, 0.1


@dataclass(frozen=True)
class Stress:
    """What is really there against what docking knows; the default is no difference.

    Attributes:
        dock_x_m: along the room, of the dock; the start is where it was, seen from the dock.
        dock_y_m: likewise.
        dock_yaw_deg: likewise.
        mount_x_m: of the camera from its known place, in its known frame.
        mount_y_m: likewise.
        mount_z_m: likewise.
        mount_roll_deg: likewise.
        mount_pitch_deg: likewise.
        mount_yaw_deg: likewise.
        focal_error: focal length / the known one - 1.
        size_error: of the print / the known one - 1.
        latest_image_s: each image is late by a time between 0 and this.
        dropped: probability that an image gets lost.
        scale_error: as in SystematicErrors, and so are the next two.
        base_error: .
        bias_rad_per_m: its gyro_bias_per_metre.
        slips_per_m: how often the wheels slip.
        hidden_corner: number of the marker's corner that something hides; -1: none.
        cover: edge of what hides it, as a share of the marker's.
        cover_grey: how light that is.
        seed: of what is drawn on the way: delays, losses and slips.
    """

    dock_x_m: float = 4.0
    dock_y_m: float = 0.0
    dock_yaw_deg: float = 0.0
    mount_x_m: float = 0.0
    mount_y_m: float = 0.0
    mount_z_m: float = 0.0
    mount_roll_deg: float = 0.0
    mount_pitch_deg: float = 0.0
    mount_yaw_deg: float = 0.0
    focal_error: float = 0.0
    size_error: float = 0.0
    latest_image_s: float = 0.0
    dropped: float = 0.0
    scale_error: float = 0.0
    base_error: float = 0.0
    bias_rad_per_m: float = 0.0
    slips_per_m: float = 0.0
    hidden_corner: int = -1
    cover: float = 0.0
    cover_grey: float = 0.0
    seed: int = 0

    @property
    def mount(self) -> Pose:
        """The camera's place in its known frame."""
        turn = (self.mount_roll_deg, self.mount_pitch_deg, self.mount_yaw_deg)
        place = (self.mount_x_m, self.mount_y_m, self.mount_z_m)
        return Pose.from_rpy(place, tuple(map(math.radians, turn)))

    @property
    def dock(self) -> PlanarPose:
        """True pose of the dock in the room."""
        return self.dock_x_m, self.dock_y_m, math.radians(self.dock_yaw_deg)

    def known_camera(self, camera: PinholeCamera) -> PinholeCamera:
        """Return what is known of a camera."""
        known = 1.0 / (1.0 + self.focal_error)
        return replace(camera, fx=known * camera.fx, fy=known * camera.fy)

    def known_dock(self, dock: Dock) -> Dock:
        """Return what is known of a dock."""
        size = dock.marker.size / (1.0 + self.size_error)
        return replace(dock, marker=replace(dock.marker, size=size))

    def costs(self, docked_distance: float) -> Tuple[float, float, float]:
        """Return by how much it sets a docked robot aside what nothing that it sees can tell.

        That is m along the axis, m across it and degrees. A print, or a focal length, that is
        wrong by a share makes the distance (m) wrong by as much; a camera that is set aside looks
        as an axis that is.

        >>> Stress(size_error=0.03, mount_y_m=-0.01).costs(0.4)
        (0.012, 0.01, 0.0)
        """
        share = abs((1.0 + self.size_error) * (1.0 + self.focal_error) - 1.0)
        return round(docked_distance * share, 12) + abs(self.mount_x_m), abs(self.mount_y_m), 0.0

    def allowed(self, tolerance: DockTolerance, docked_distance: float) -> DockTolerance:
        """Return a dock's tolerance with these costs."""
        along, across, yaw = self.costs(docked_distance)
        turned = tolerance.yaw + math.radians(yaw)
        return DockTolerance(tolerance.distance + along, tolerance.lateral + across, turned)


Draw = Callable[[np.random.Generator], Dict[str, Any]]


def _even(*limits: Tuple[str, float]) -> Draw:
    """Return what draws fields evenly within ± a limit each."""

    def draw(rng: np.random.Generator) -> Dict[str, Any]:
        return {name: limit * rng.uniform(-1.0, 1.0) for name, limit in limits}

    return draw


def _fixed(**values: float) -> Draw:
    return lambda rng: values


def _corner(rng: np.random.Generator) -> Dict[str, Any]:
    return {
        "hidden_corner": int(rng.integers(4)),
        "cover": rng.uniform(*COVER),
        "cover_grey": rng.uniform(),
    }


_SHIFTS = tuple((f"mount_{axis}_m", MOUNT_SHIFT) for axis in "xyz")
_TURNS = tuple(
    (f"mount_{axis}_deg", math.degrees(MOUNT_TURN)) for axis in ("roll", "pitch", "yaw")
)

STRESSES: Dict[str, Draw] = {
    "pose": _even(*((f"dock_{axis}_m", FARTHEST_DOCK) for axis in "xy"), ("dock_yaw_deg", 180.0)),
    "mount": _even(*_SHIFTS, *_TURNS),
    "focal": _even(("focal_error", FOCAL_ERROR)),
    "size": _even(("size_error", SIZE_ERROR)),
    "latency": _fixed(latest_image_s=LATEST_IMAGE),
    "drops": _fixed(dropped=DROPPED),
    "odometry": _even(("scale_error", ODOMETRY_ERROR), ("base_error", ODOMETRY_ERROR)),
    "bias": _even(("bias_rad_per_m", BIAS)),
    "slip": _fixed(slips_per_m=1.0 / SLIP_EVERY),
    "corner": _corner,
}
"""What draws the fields of each stress. The random stream of each is its place here: new ones
come last."""


def draw_stress(names: Sequence[str], seed: int, index: int) -> Stress:
    """Return the stress of an index; none of those named changes what the others draw."""
    values: Dict[str, Any] = {}
    for number, (name, draw) in enumerate(STRESSES.items()):
        sequence = np.random.SeedSequence(seed, spawn_key=(index, number))
        if name in names:
            values.update(draw(np.random.default_rng(sequence)))
    sequence = np.random.SeedSequence(seed, spawn_key=(index, _ON_THE_WAY))
    return Stress(**values, seed=int(sequence.generate_state(1)[0])) if values else Stress()


def stress_columns(stress: Stress) -> Dict[str, Any]:
    """Return the columns of a record that say what was drawn."""
    return {name: value for name, value in asdict(stress).items() if name != "seed"}


def found_columns(calibration: Optional[Calibration]) -> Dict[str, Any]:
    """Return the columns of a record that say what docking found out; empty for None."""
    columns = {}
    for name, unit, scale in (
        *((axis, "_deg", 180.0 / math.pi) for axis in ("roll", "pitch", "yaw")),
        ("height", "_m", 1.0),
        *((error, "", 1.0) for error in ("way", "turn", "drift")),
    ):
        found = None if calibration is None else getattr(calibration, name)
        columns[f"found_{name}{unit}"] = None if found is None else scale * found.value
        columns[f"found_{name}_std{unit}"] = None if found is None else scale * found.deviation
    return columns


def world_under(stress: Stress, world: World, known_dock: PlanarPose, dock: Dock) -> World:
    """Return a world with its dock where it is, and what stands about it, and a corner hidden.

    Args:
        stress: what is otherwise.
        world: as its file says.
        known_dock: pose of the dock there.
        dock: what is true of it.
    """
    models = world.models
    if stress.dock != known_dock:
        x, y, yaw = se2.compose(stress.dock, se2.inverse(known_dock)).tolist()
        moved = Pose.from_rpy((x, y, 0.0), (0.0, 0.0, yaw))
        models = tuple(_moved(model, moved) for model in models)
    if stress.hidden_corner >= 0:
        models = (*models, _cover(stress, dock))
    return replace(world, models=models)


def _moved(model: Model, moved: Pose) -> Model:
    # A plane looks the same from everywhere, and the floor's picture has its middle at the origin.
    return model if model.name == "ground_plane" else replace(model, pose=moved * model.pose)


def _cover(stress: Stress, dock: Dock) -> Model:
    """Return what hides a corner: a little square before the marker that nothing touches."""
    half, grey = 0.5 * dock.marker.size, stress.cover_grey
    edge = stress.cover * dock.marker.size
    left = 1.0 if stress.hidden_corner in (0, 3) else -1.0
    up = 1.0 if stress.hidden_corner in (0, 1) else -1.0
    place = (-_IN_FRONT, left * half, dock.marker.height + up * half)
    square = Visual(
        Box((_COVER_THICKNESS, edge, edge)), Pose(place), (grey, grey, grey, 1.0), "cover"
    )
    x, y, yaw = stress.dock
    pose = Pose.from_rpy((x, y, 0.0), (0.0, 0.0, yaw))
    return Model("cover", (Link("link", visuals=(square,)),), pose=pose, static=True)


def robot_under(stress: Stress, robot: Model, camera_frame: str) -> Model:
    """Return a robot with its camera where it really is; the frame is one of `robot.frames`."""
    keeper, pose = robot.frames[camera_frame]
    return replace(
        robot, frames={**robot.frames, camera_frame: (keeper, pose * stress.mount)}
    )


class StressedOdometry:
    """What odometry tells of true poses: with systematic errors, and with slips.

    While wheels slip they turn more than the robot moves.
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
        self._before: Optional[PlanarPose] = None
        self._told: PlanarPose = (0.0, 0.0, 0.0)
        self._until_slip, self._slip_left = self._next_slip(), 0.0
        self._slip = (0.0, 0.0)

    def update(self, pose: PlanarPose) -> PlanarPose:
        """Return what is told of a true pose (m, m, rad)."""
        pose = self._path.update(*pose).pose
        if self._rate == 0.0:
            return pose
        before, self._before = self._before, pose
        if before is None:
            self._told = pose
            return pose
        step = se2.between(before, pose)
        way = math.hypot(step[0], step[1])
        more, turn = self._slipping(way)
        step = step * (1.0 + more, 1.0 + more, 1.0) + (0.0, 0.0, turn * way)
        self._told = tuple(se2.compose(self._told, step).tolist())
        return self._told

    def _slipping(self, way: float) -> Tuple[float, float]:
        """Return how much more way is told on these metres, and what turn on each."""
        if self._slip_left > 0.0:
            self._slip_left -= way
            return self._slip
        self._until_slip -= way
        if self._until_slip <= 0.0:
            self._until_slip = self._next_slip()
            self._slip_left = self._rng.uniform(*SLIP_LENGTH)
            self._slip = (
                self._rng.uniform(0.0, SLIP_WAY), self._rng.uniform(-SLIP_TURN, SLIP_TURN)
            )  # fmt: skip
        return 0.0, 0.0

    def _next_slip(self) -> float:
        return self._rng.exponential(1.0 / self._rate) if self._rate else math.inf
