"""A docking of a campaign: a random scenario, its run in the simulation, and its record."""

from __future__ import annotations

import functools
import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Callable

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.parameters import choice, choices, integer
from bullet_lab.core.pose import Pose
from bullet_lab.core.se2 import PlanarPose, wrap
from bullet_lab.docking.database import (
    ERRORS,
    Dock,
    docking_errors,
    judge,
    largest_errors,
    read_docks,
)
from bullet_lab.docking.types import (
    CalibrationErrors,
    CameraMount,
    DockingResult,
    Observation,
    Odometry,
    Sighting,
)
from bullet_lab.errors import LabError
from bullet_lab.noise.odometry_noise import NoisyPath, ReportRule
from bullet_lab.simulation.plugins.camera import Camera
from bullet_lab.simulation.plugins.lenses import Lens
from bullet_lab.simulation.plugins.samples import OdometrySample, PlanarCommand
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import Footprint, footprints
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.urdf import read_urdf_file
from bullet_lab.studies.dock_campaign.graceful import CONTROLLERS
from bullet_lab.studies.dock_campaign.stress import (
    STRESSES,
    Stress,
    StressedOdometry,
    draw_stress,
    found_columns,
    robot_under,
    stress_columns,
    world_under,
)
from bullet_lab.studies.study import MOST_SEED, Record, Settings
from bullet_lab.studies.worlds import LIGHTS, ROBOT, lit_world, read_world
from bullet_lab.vision.dictionaries import dictionary_named
from bullet_lab.vision.images import grey
from bullet_lab.vision.marker_detector import DetectorSettings, MarkerDetector

MARKER_POSE: PlanarPose = (4.0, 0.0, 0.0)
"""True pose of the dock in all worlds of the package."""

DATABASE = "package://bullet_lab/config/docks.yaml"
FLOOR = "ground_plane"
CAMERA_FRAME = "camera_link"
IMAGE_RATE = 5.0
TICK_STEPS = 50
CONTACT_RATE = 100.0
TURNING_RADIUS = 0.29

WORLDS = ("docking", "docking_dots", "docking_nested", "docking_decoy")
DOCKS = {"docking_nested": "nested_dock"}
"""Names of docks in the database by world; in other worlds it is "dock"."""

ODOMETRY = ("odom", "noisy_odom")
NONE, ALL, EACH = "none", "all", "each"
ROBOT_HEIGHT = 0.55
NEAREST, FARTHEST = 0.7, 5.0
WIDEST = math.radians(60.0)
DATABASE_ERROR = (0.3, 0.3, math.radians(10.0))
DOCK_MODEL = "docking_station"
UNKNOWN_CLEARANCE = 1.0
LARGEST_NOISES = (0.1, 0.02, 1.0)
"""Of the odometry's std, and of noise (share of white) and blur (px) of images."""

CRASHED = "crashed"
"""Result of a docking that did not end, beside those of `judge`."""

TOLERANCES = {name: name.replace("error", "tolerance") for name in ERRORS}
"""Names of the columns with the dock's own tolerances, by those of the errors."""

PART_SIZES = (64, 96, 128, 192, 256, 320, 416)
"""Of parts of a picture, px. They are few, as the renderer keeps a buffer for each of the last."""

MOST_PARTS = 4
"""Parts between two whole pictures."""

AROUND, AROUND_SHARE = 20.0, 0.2
"""What a part shows around the markers: px, and as a share of the largest marker's edge."""

# Columns with the cost of the stress, which is added to the tolerance.
_COSTS = [name.replace("error", "cost") for name in ERRORS]
_MOST_ATTEMPTS = 10_000
_SETTLE_STEPS = 100


@dataclass(frozen=True)
class DockingScenario:
    """Conditions of a docking.

    `start` and `dock_error` hold for the dock's pose in the world's file.
    """

    world: str  #: name of a world of the package
    light: str  #: name of its light, one of `worlds.LIGHTS`
    start: PlanarPose  #: of the robot in the world, m, m, rad
    dock_error: PlanarPose  #: of the dock's pose in the database, along the world's axes
    odometry: str  #: one of `ODOMETRY`
    odometry_std: float  #: of noisy_odom, by the report's rule
    odometry_seed: int  #: of the noise
    image_noise: float  #: standard deviation as a share of white
    image_blur: float  #: standard deviation in px
    image_seed: int  #: of the image noise
    controller: str  #: the one of `CONTROLLERS` under test
    stress: Stress  #: perturbations to apply


@dataclass(frozen=True)
class DrawSettings(Settings):
    """Values that scenarios are drawn from, each with equal probability."""

    seed: int = integer(1, "seed of all that is random", 0, MOST_SEED)
    worlds: tuple[str, ...] = choices(WORLDS, "worlds to draw from", WORLDS)
    lights: tuple[str, ...] = choices(
        LIGHTS, "lights to draw from; default is the world's own", LIGHTS
    )
    odometry: tuple[str, ...] = choices(ODOMETRY, "odometry to draw from", ODOMETRY)
    controller: str = choice(
        "ours", "the controller under test; it does not change the random draws", [*CONTROLLERS]
    )
    stress: tuple[str, ...] = choices(
        (NONE,),
        "perturbations to apply together; each: one campaign for each of them, and for all",
        (NONE, ALL, EACH, *STRESSES),
    )

    @property
    def stresses(self) -> tuple[str, ...]:
        """Names of the stresses that are drawn."""
        return tuple(STRESSES) if ALL in self.stress else self.stress


def draw_scenario(settings: DrawSettings, index: int) -> DockingScenario:
    """Return the scenario of an index, which depends on the settings and the index only.

    The start's distance from the plane of the back wall is uniform within `NEAREST` to
    `FARTHEST`. Its direction from the marker, within `WIDEST` of the dock's axis, and its heading
    are uniform too. They are drawn again until the robot is `TURNING_RADIUS` away from the dock,
    and `UNKNOWN_CLEARANCE` away from other obstacles, which a robot without a laser does not see.
    """
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(index,)))
    options = settings.worlds, settings.lights, settings.odometry
    world, light, odometry = (str(rng.choice(names)) for names in options)
    error = rng.uniform(-1.0, 1.0, 3) * DATABASE_ERROR
    std, noise, blur = (rng.uniform(0.0, most) for most in LARGEST_NOISES)
    odometry_seed, image_seed = rng.integers(2**31, size=2).tolist()
    # Last, because its number of draws varies.
    start = _draw_start(rng, obstacles(world))
    return DockingScenario(
        world=world,
        light=light,
        start=start,
        dock_error=tuple(error.tolist()),
        odometry=odometry,
        odometry_std=std if odometry == "noisy_odom" else 0.0,
        odometry_seed=odometry_seed,
        image_noise=noise,
        image_blur=blur,
        image_seed=image_seed,
        controller=settings.controller,
        stress=draw_stress(settings.stresses, settings.seed, index),
    )


@functools.lru_cache
def obstacles(world: str) -> tuple[Footprint, ...]:
    """Return the obstacles of the robot in a world of the package, by its name."""
    return footprints(read_world(world), below=ROBOT_HEIGHT)


def _draw_start(rng: np.random.Generator, walls: tuple[Footprint, ...]) -> PlanarPose:
    dock_x, dock_y, _ = MARKER_POSE
    distance = rng.uniform(NEAREST, FARTHEST)
    for _ in range(_MOST_ATTEMPTS):
        bearing = rng.uniform(-WIDEST, WIDEST)
        heading = rng.uniform(-math.pi, math.pi)
        x, y = dock_x - distance, dock_y + distance * math.tan(bearing)
        if all(wall.distance((x, y)) > _clearance(wall) for wall in walls):
            return x, y, heading
    raise LabError(f"{_MOST_ATTEMPTS} draws found no start with enough room for a robot")


def _clearance(wall: Footprint) -> float:
    return TURNING_RADIUS if wall.name == DOCK_MODEL else UNKNOWN_CLEARANCE


MEASURED = (
    *(*ERRORS, "wall_contacts", "retries", "sim_time_s"),
    *("end_x_m", "end_y_m", "end_yaw_deg", "renderer"),
)
"""Columns with what is measured: the errors of the robot at rest by the simulator's truth, see
`docking_errors`; how often the robot began to touch anything but the floor; the seconds until the
end; the robot's pose at that time, for the dock's pose in the world's file; and the driver that
drew the images, empty if there were none."""


def run_docking(scenario: DockingScenario) -> tuple[DockingResult, Record]:
    """Dock once; return what the robot reports, and the columns `MEASURED`.

    Raises:
        LabError: a world, dock or file of the scenario does not exist.
    """
    dock = dock_of(scenario)
    world = lit_world(scenario.world, scenario.light)
    world = world_under(scenario.stress, world, MARKER_POSE, dock)
    with Simulation(world, scenario.image_seed) as simulation:
        return _SimulatedDocking(scenario, dock, simulation).run()


def dock_of(scenario: DockingScenario) -> Dock:
    """Return the dock from the database, at its true pose plus the scenario's error of it."""
    x, y, yaw = (a + b for a, b in zip(scenario.stress.dock, scenario.dock_error))
    docks = read_docks(ResourceFinder.anywhere().find(DATABASE))
    return replace(docks[DOCKS.get(scenario.world, "dock")], pose=(x, y, wrap(yaw)))


class _SimulatedDocking:
    """A docking in progress."""

    def __init__(self, scenario: DockingScenario, dock: Dock, simulation: Simulation):
        self._dock, self._simulation = dock, simulation
        self._stress = stress = scenario.stress
        self._rng = np.random.default_rng((stress.seed, 0))
        start = _moved(scenario.start, MARKER_POSE, stress.dock)
        file = ResourceFinder.anywhere().find(ROBOT)
        robot = robot_under(stress, read_urdf_file(file), CAMERA_FRAME)
        self._robot = simulation.add(robot, pose=Pose.on_floor(*start))
        self._camera = next(d for d in self._robot.plugins if isinstance(d, Camera))
        self._camera.settings = replace(
            self._camera.settings, noise_stddev=scenario.image_noise, blur=scenario.image_blur
        )
        self._noise = NoisyPath(ReportRule(scenario.odometry_std), scenario.odometry_seed)
        self._known_camera = stress.known_camera(self._camera.camera)
        self._reported = StressedOdometry(stress, np.random.default_rng((stress.seed, 1)))
        # As docking knows it.
        place = self._robot.pose().inverse() * self._camera.pose() * stress.mount.inverse()
        self._mount = CameraMount(*place.position, *place.rpy())
        name = dictionary_named(dock.marker.dictionary).name
        detector = MarkerDetector(DetectorSettings(name, ids=(dock.marker.id,)))
        self._watch = MarkerWatch(self._camera, detector, dock.marker.dictionary)
        self._task = CONTROLLERS[scenario.controller](
            stress.known_dock(dock), dock.pose, self._mount, seed=scenario.odometry_seed
        )
        self._images = self._contacts = 0
        self._delayed: deque[tuple[float, Observation]] = deque()
        self._touching = False
        self._stamp = 0.0

    def run(self) -> tuple[DockingResult, Record]:
        """Drive to the end."""
        simulation = self._simulation
        simulation.run_until(_SETTLE_STEPS)
        self._robot.listen("odom", self._add_odometry)
        simulation.every(CONTACT_RATE, self._check_contact)
        next_image = simulation.seconds
        while self._task.result is None:
            simulation.run_until(simulation.step + TICK_STEPS)
            if simulation.seconds >= next_image - 1e-9:
                next_image += 1.0 / IMAGE_RATE
                if self._task.wants_images:
                    self._take_image()
            while self._delayed and self._delayed[0][0] <= simulation.seconds + 1e-9:
                self._task.add_observation(self._delayed.popleft()[1])
            v, w = self._task.tick(simulation.seconds)
            self._robot.command("cmd_vel", PlanarCommand(v, 0.0, w))
        seconds, result = simulation.seconds, self._task.result
        end = _moved(self._robot.pose().planar, self._stress.dock, MARKER_POSE)
        simulation.run_for(0.5)
        rest, ahead = self._robot.pose().planar, self._mount.x
        errors = docking_errors(rest, self._stress.dock, ahead, self._dock.docked_distance)
        return result, {
            **errors,
            "wall_contacts": self._contacts,
            "retries": result.retries,
            "sim_time_s": seconds,
            **_pose_columns("end", end),
            "renderer": simulation.renderer().driver if self._images else "",
        }

    def _add_odometry(self, sample: OdometrySample) -> None:
        """Give odometry to the task, with stress and noise."""
        noisy = self._noise.update(*self._reported.update(sample.pose.planar))
        seconds = sample.step / 1000.0 - self._stamp
        self._stamp = sample.step / 1000.0
        covariance = noisy.motion_covariance / seconds**2 if seconds > 0.0 else None
        self._task.add_odometry(Odometry(self._stamp, noisy.pose, covariance))

    def _take_image(self) -> None:
        """Take an image, and keep what is detected in it until its delay is over."""
        simulation, stress = self._simulation, self._stress
        # Both are drawn for each image, so that one stress does not change the draws of another.
        delay, lost = stress.latest_image_s * self._rng.uniform(), self._rng.uniform()
        self._images += 1
        if lost < stress.dropped:
            return
        sightings = self._watch.look(simulation.step)
        # The same object for all images, as it is one camera.
        observation = Observation(simulation.seconds, self._known_camera, sightings)
        self._delayed.append((simulation.seconds + delay, observation))

    def _check_contact(self, step: int) -> None:
        touching = bool(self._simulation.contacts(self._robot.name) - {FLOOR})
        self._contacts += touching and not self._touching
        self._touching = touching


class MarkerWatch:
    """Finds markers in the pictures of a camera without distortion.

    While they are in sight, a picture is only a part of a whole one: where they should be if they
    move on as between the two pictures before. Each fifth picture is a whole one, and so is one
    whose part does not show all of them. What comes into sight is found within a second.
    """

    def __init__(self, camera: Camera, detector: MarkerDetector, dictionary: str):
        self._camera, self._detector, self._dictionary = camera, detector, dictionary
        self._whole = camera.camera
        # Corners (n, 4, 2) in the last picture and in the one before, px.
        self._last = self._before = np.empty((0, 4, 2))
        self._parts = 0

    def look(self, step: int) -> tuple[Sighting, ...]:
        """Return the markers in the present picture; its noise depends on the step."""
        part = self._part() if len(self._last) and self._parts < MOST_PARTS else None
        seen = () if part is None else self._find(step, *part)
        self._parts += 1
        if part is None or len(seen) < len(self._last):
            seen = self._find(step, np.zeros(2), (self._whole.width, self._whole.height))
            self._parts = 0
        self._before, self._last = self._last, np.array([one.corners for one in seen])
        return seen

    def _part(self) -> tuple[np.ndarray, tuple[int, int]] | None:
        """Return the first pixel and the size of the part to draw; None: all."""
        corners, whole = self._last, (self._whole.width, self._whole.height)
        if len(self._before) == len(corners):
            corners = corners + (corners - self._before).mean(axis=(0, 1))
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        around = AROUND + AROUND_SHARE * np.ptp(corners, axis=1).max()
        needed = (high - low).max() + 2.0 * around
        for size in PART_SIZES:
            if needed <= size <= min(whole):
                first = np.rint(0.5 * (low + high - size))
                return np.clip(first, 0, np.subtract(whole, size)), (size, size)
        return None

    def _find(self, step: int, first: np.ndarray, size: tuple[int, int]) -> tuple[Sighting, ...]:
        """Draw a part of the picture and return the markers in it, in px of the whole."""
        centre = np.array((self._whole.cx, self._whole.cy)) - first
        part = replace(self._whole, width=size[0], height=size[1], cx=centre[0], cy=centre[1])
        lens, self._camera.lens = self._camera.lens, Lens(part)
        picture = self._camera.take(step)
        self._camera.lens = lens
        found = self._detector.detect(grey(picture, "rgb8"), part).markers
        return tuple(
            Sighting(m.id, self._dictionary, m.corners + first, m.deviations) for m in found
        )


def _moved(pose: PlanarPose, before: PlanarPose, after: PlanarPose) -> PlanarPose:
    """Return a pose after a motion that takes one frame to another."""
    if before == after:
        return pose
    return tuple(se2.compose(after, se2.between(before, pose)).tolist())


def run_trial(
    settings: DrawSettings,
    index: int,
    dock: Callable[[DockingScenario], tuple[DockingResult, Record]] = run_docking,
) -> Record:
    """Run the docking of an index and return its record; an error becomes a crashed record."""
    scenario = draw_scenario(settings, index)
    try:
        result, measured = dock(scenario)
    except Exception as error:  # one docking must not end the campaign
        return crashed_record(settings, index, f"{type(error).__name__}: {error}")
    known = dock_of(scenario)
    tolerance = scenario.stress.allowed(known.tolerance, known.docked_distance)
    verdict = judge(result.error, measured, tolerance, measured["wall_contacts"])
    return _record(index, scenario, verdict, result.message, measured, result.calibration)


def crashed_record(settings: DrawSettings, index: int, why: str) -> Record:
    """Return the record of a docking that did not end."""
    words, nothing = " ".join(why.split()), dict.fromkeys(MEASURED)
    return _record(index, draw_scenario(settings, index), CRASHED, words, nothing, None)


def _record(
    index: int,
    scenario: DockingScenario,
    result: str,
    message: str,
    measured: Record,
    calibration: CalibrationErrors | None,
) -> Record:
    dock = dock_of(scenario)
    return {
        "index": index,
        "world": scenario.world,
        "light": scenario.light,
        **_pose_columns("start", scenario.start),
        **_pose_columns("database_error", scenario.dock_error),
        "odometry": scenario.odometry,
        "odometry_std": scenario.odometry_std,
        "image_noise": scenario.image_noise,
        "image_blur_px": scenario.image_blur,
        **dict(zip(TOLERANCES.values(), largest_errors(dock.tolerance).values())),
        **stress_columns(scenario.stress),
        **dict(zip(_COSTS, scenario.stress.costs(dock.docked_distance))),
        "result": result,
        "message": message,
        **measured,
        **found_columns(calibration),
    }


def _pose_columns(name: str, pose: PlanarPose) -> dict[str, float]:
    x, y, yaw = pose
    return {f"{name}_x_m": x, f"{name}_y_m": y, f"{name}_yaw_deg": math.degrees(yaw)}
