"""One docking in the simulation, without ROS: the robot, its camera, the detector and the task."""

from __future__ import annotations

import functools
from collections import deque
from dataclasses import dataclass, replace
from typing import Deque, Dict, Optional, Tuple

import numpy as np

from bullet_lab.core import se2
from bullet_lab.core.pose import Pose
from bullet_lab.core.se2 import wrap
from bullet_lab.docking.controllers import CONTROLLERS
from bullet_lab.docking.database import Dock, find_dock, read_docks
from bullet_lab.docking.types import (
    Calibration,
    CameraMount,
    DockingError,
    Observation,
    Odometry,
    PlanarPose,
    Sighting,
)
from bullet_lab.docking.verdict import docking_errors
from bullet_lab.noise.odometry_noise import NoisyPath, ReportRule
from bullet_lab.simulation.plugins.camera import Camera
from bullet_lab.simulation.plugins.samples import OdometrySample, PlanarCommand
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import Model
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.urdf import read_urdf_file
from bullet_lab.studies.dock_campaign.stress import (
    Stress,
    StressedOdometry,
    robot_under,
    world_under,
)
from bullet_lab.studies.worlds import DEFAULT_LIGHT, ROBOT, lit_world
from bullet_lab.vision.dictionaries import dictionary_named
from bullet_lab.vision.images import grey
from bullet_lab.vision.marker_detector import DetectorSettings, MarkerDetector

MARKER_POSE: PlanarPose = (4.0, 0.0, 0.0)
"""True pose of the dock in all worlds of the package."""

DOCKS = "package://bullet_lab/config/docks.yaml"
FLOOR = "ground_plane"
CAMERA_FRAME = "camera_link"
TIME_LIMIT = 300.0
IMAGE_RATE = 5.0
TICK_STEPS = 50
CONTACT_RATE = 100.0
TURNING_RADIUS = 0.29
_SETTLE_STEPS = 100


@dataclass(frozen=True)
class DockingScenario:
    """Conditions of a docking.

    Attributes:
        world: name of a world of the package.
        light: name of its light, one of `worlds.LIGHTS`.
        start: of the robot in the world, m, m, rad.
        dock: its name in the database.
        dock_error: error of the dock's pose in the database, along the world's axes: m, m, rad.
        odometry: "odom" or "noisy_odom".
        odometry_std: of noisy_odom, by the report's rule.
        odometry_seed: of the noise.
        image_noise: standard deviation as a share of white.
        image_blur: standard deviation in px.
        image_seed: of the image noise.
        controller: the one of `CONTROLLERS` under test.
        stress: perturbations to apply. `start` and `dock_error` hold for the dock's pose in the
            world's file.
    """

    world: str = "docking"
    light: str = DEFAULT_LIGHT
    start: PlanarPose = (0.0, 0.0, 0.0)
    dock: str = "dock"
    dock_error: PlanarPose = (0.0, 0.0, 0.0)
    odometry: str = "odom"
    odometry_std: float = 0.0
    odometry_seed: int = 0
    image_noise: float = 0.0
    image_blur: float = 0.0
    image_seed: int = 0
    controller: str = "ours"
    stress: Stress = Stress()


@dataclass(frozen=True)
class DockingOutcome:
    """Result of a docking.

    Errors are those of the robot at rest against the simulator's truth: positive is too far, to the
    left of the axis, and turned to the left.

    Attributes:
        error_name: of `DockingError`; NONE if the robot reports that it has docked.
        message: one line for the user.
        distance_error_m: along the axis.
        lateral_error_m: across it.
        yaw_error_deg: against it.
        wall_contacts: number of times that the robot began to touch anything but the floor.
        retries: number of times that it retreated to try again.
        sim_time_s: until the end.
        end: x, y (m) and yaw (rad) of the robot at that time, for the dock's pose in the world's
            file.
        renderer: driver that drew the images; empty if there were none.
        calibration: learned on the way; None if the marker was not found.
    """

    error_name: str
    message: str
    distance_error_m: float
    lateral_error_m: float
    yaw_error_deg: float
    wall_contacts: int
    retries: int
    sim_time_s: float
    end: PlanarPose
    renderer: str = ""
    calibration: Optional[Calibration] = None


def run_docking(scenario: DockingScenario) -> DockingOutcome:
    """Dock once.

    Raises:
        LabError: a world, dock or file of the scenario does not exist.
    """
    dock = dock_of(scenario)
    world = lit_world(scenario.world, scenario.light)
    world = world_under(scenario.stress, world, MARKER_POSE, dock)
    with Simulation(world, scenario.image_seed) as simulation:
        return _Drive(scenario, dock, simulation).run()


@functools.lru_cache(maxsize=None)
def _docks() -> Dict[str, Dock]:
    return read_docks(ResourceFinder.anywhere().find(DOCKS))


@functools.lru_cache(maxsize=None)
def _robot() -> Model:
    return read_urdf_file(ResourceFinder.anywhere().find(ROBOT))


def dock_of(scenario: DockingScenario) -> Dock:
    """Return the dock from the database, at its true pose plus the scenario's error of it."""
    x, y, yaw = (a + b for a, b in zip(scenario.stress.dock, scenario.dock_error))
    return replace(find_dock(_docks(), scenario.dock), pose=(x, y, wrap(yaw)))


class _Drive:
    """A docking in progress."""

    def __init__(self, scenario: DockingScenario, dock: Dock, simulation: Simulation):
        self._dock, self._simulation = dock, simulation
        self._stress = stress = scenario.stress
        self._rng = np.random.default_rng((stress.seed, 0))
        x, y, yaw = _moved(scenario.start, MARKER_POSE, stress.dock)
        robot = robot_under(stress, _robot(), CAMERA_FRAME)
        place = Pose.from_rpy((x, y, 0.0), (0.0, 0.0, yaw))
        self._robot = simulation.add(robot, pose=place)
        self._camera = next(d for d in self._robot.plugins if isinstance(d, Camera))
        self._camera.settings = replace(
            self._camera.settings, noise_stddev=scenario.image_noise, blur=scenario.image_blur
        )
        std = scenario.odometry_std if scenario.odometry == "noisy_odom" else 0.0
        self._noise = NoisyPath(ReportRule(std), scenario.odometry_seed)
        self._known_camera = stress.known_camera(self._camera.camera)
        self._reported = StressedOdometry(stress, np.random.default_rng((stress.seed, 1)))
        self._mount = self._known_mount()
        marker = dock.marker
        self._dictionary = marker.dictionary
        name = dictionary_named(marker.dictionary).name
        self._detector = MarkerDetector(DetectorSettings(dictionary=name, ids=(marker.id,)))
        self._task = CONTROLLERS[scenario.controller](
            stress.known_dock(dock),
            dock.pose,
            self._mount,
            time_limit=TIME_LIMIT,
            seed=scenario.odometry_seed,
        )
        self._images = self._contacts = 0
        self._delayed: Deque[Tuple[float, Observation]] = deque()
        self._touching = False
        self._odometry: Optional[OdometrySample] = None
        self._stamp = 0.0

    def run(self) -> DockingOutcome:
        """Drive to the end."""
        simulation = self._simulation
        simulation.run_until(_SETTLE_STEPS)
        self._robot.listen("odom", self._keep_odometry)
        simulation.every(CONTACT_RATE, self._check_contact)
        next_image = simulation.seconds
        while self._task.result is None:
            simulation.run_until(simulation.step + TICK_STEPS)
            self._add_odometry()
            if simulation.seconds >= next_image - 1e-9:
                next_image += 1.0 / IMAGE_RATE
                if self._task.wants_images:
                    self._take_image()
            while self._delayed and self._delayed[0][0] <= simulation.seconds + 1e-9:
                self._task.add_observation(self._delayed.popleft()[1])
            v, w = self._task.tick(simulation.seconds)
            self._robot.command("cmd_vel", PlanarCommand(v, 0.0, w))
        seconds, end = simulation.seconds, _moved(self._pose(), self._stress.dock, MARKER_POSE)
        simulation.run_for(0.5)
        return self._outcome(seconds, end)

    def _keep_odometry(self, sample: OdometrySample) -> None:
        self._odometry = sample

    def _add_odometry(self) -> None:
        """Give the newest odometry to the task, with stress and noise."""
        sample, self._odometry = self._odometry, None
        if sample is None:
            return
        x, y, _ = sample.pose.position
        noisy = self._noise.update(*self._reported.update((x, y, sample.pose.yaw)))
        seconds = sample.step / 1000.0 - self._stamp
        self._stamp = sample.step / 1000.0
        covariance = noisy.motion_covariance / seconds**2 if seconds > 0.0 else None
        velocity = (sample.velocity.vx, sample.velocity.wz)
        self._task.add_odometry(Odometry(self._stamp, noisy.pose, velocity, covariance))

    def _take_image(self) -> None:
        """Take an image, and keep what is detected in it until its delay is over."""
        simulation, camera, stress = self._simulation, self._camera, self._stress
        # Both are drawn for each image, so that one stress does not change the draws of another.
        delay, lost = stress.latest_image_s * self._rng.uniform(), self._rng.uniform()
        self._images += 1
        if lost < stress.dropped:
            return
        image = camera.take(simulation.step)
        found = self._detector.detect(grey(image, "rgb8"), camera.camera).markers
        sightings = tuple(
            Sighting(m.id, self._dictionary, m.corners, m.deviations) for m in found
        )
        # The same object for all images, as it is one camera.
        observation = Observation(simulation.seconds, self._known_camera, sightings)
        self._delayed.append((simulation.seconds + delay, observation))

    def _check_contact(self, step: int) -> None:
        touching = any(other != FLOOR for other in self._simulation.contacts(self._robot.name))
        if touching and not self._touching:
            self._contacts += 1
        self._touching = touching

    def _pose(self) -> PlanarPose:
        pose = self._robot.pose()
        return pose.position[0], pose.position[1], pose.yaw

    def _known_mount(self) -> CameraMount:
        """Return the pose of the camera on the robot, as docking knows it."""
        place = self._robot.pose().inverse() * self._camera.pose() * self._stress.mount.inverse()
        return CameraMount(*place.position, *place.rpy())

    def _outcome(self, seconds: float, end: PlanarPose) -> DockingOutcome:
        result = self._task.result
        errors = docking_errors(
            self._pose(), self._stress.dock, self._mount.x, self._dock.docked_distance
        )
        return DockingOutcome(
            DockingError(result.error).name,
            result.message,
            *errors.values(),
            self._contacts,
            result.retries,
            seconds,
            end,
            self._simulation.renderer().driver if self._images else "",
            result.calibration,
        )


def _moved(pose: PlanarPose, before: PlanarPose, after: PlanarPose) -> PlanarPose:
    """Return a pose after a motion that takes one frame to another."""
    if before == after:
        return pose
    return tuple(se2.compose(after, se2.between(before, pose)).tolist())
