"""One docking in the simulation, without ROS: the robot, its camera, the detector and the task."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import Dict, Optional

from bullet_lab.core.pose import Pose
from bullet_lab.core.se2 import wrap
from bullet_lab.docking.controllers import CONTROLLERS
from bullet_lab.docking.database import Dock, find_dock, read_docks
from bullet_lab.docking.types import (
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
from bullet_lab.simulation.simulation import ModelInstance, Simulation
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.sdf import read_world_file
from bullet_lab.vision.dictionaries import dictionary_named
from bullet_lab.vision.images import grey
from bullet_lab.vision.marker_detector import DetectorSettings, MarkerDetector

ROBOT = "package://bullet_lab/urdf/camera_robot.urdf"
MARKER_POSE: PlanarPose = (4.0, 0.0, 0.0)
"""True pose of the dock in all worlds of the package."""

DOCKS = "package://bullet_lab/config/docks.yaml"
FLOOR = "ground_plane"
TIME_LIMIT = 300.0
IMAGE_RATE = 5.0
TICK_STEPS = 50
CONTACT_RATE = 100.0
TURNING_RADIUS = 0.29
_SETTLE_STEPS = 100


@dataclass(frozen=True)
class DockingScenario:
    """What a docking is made of.

    Attributes:
        world: URI of the world.
        lighting: URI of another world whose light replaces this one's; empty: its own.
        start: of the robot in the world, m, m, rad.
        dock: its name in the database.
        dock_error: what the database's pose is wrong by, along the world's axes: m, m, rad.
        odometry: "odom" or "noisy_odom".
        odometry_std: of noisy_odom, by the report's rule.
        odometry_seed: of the noise.
        image_noise: standard deviation as a share of white.
        image_blur: standard deviation in px.
        image_seed: of the image noise.
        controller: of `CONTROLLERS`, what drives.
    """

    world: str = "package://bullet_lab/worlds/docking.world"
    lighting: str = ""
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


@dataclass(frozen=True)
class DockingOutcome:
    """How a docking went.

    Errors are those of the standing robot against the simulator's truth: positive is too far,
    to the left of the axis and turned to the left.

    Attributes:
        error_name: of `DockingError`; NONE where the robot says that it has docked.
        message: one line for the user.
        distance_error_m: along the axis.
        lateral_error_m: across it.
        yaw_error_deg: against it.
        wall_contacts: how often the robot began to touch anything but the floor.
        retries: how often it retreated to try again.
        sim_time_s: until the end.
        end: x, y (m) and yaw (rad) of the robot in the world, then.
        renderer: driver that drew the images; empty where there were none.
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


def run_docking(scenario: DockingScenario) -> DockingOutcome:
    """Dock once.

    Raises:
        LabError: the scenario names what does not exist, or noise that makes no sense.
    """
    with Simulation(_world(scenario), scenario.image_seed) as simulation:
        return _Drive(scenario, dock_of(scenario), simulation).run()


@functools.lru_cache(maxsize=None)
def _docks() -> Dict[str, Dock]:
    return read_docks(ResourceFinder.anywhere().find(DOCKS))


def dock_of(scenario: DockingScenario) -> Dock:
    """Return the entry of the database, with the true pose and the scenario's error of it."""
    x, y, yaw = (a + b for a, b in zip(MARKER_POSE, scenario.dock_error))
    return replace(find_dock(_docks(), scenario.dock), pose=(x, y, wrap(yaw)))


def _world(scenario: DockingScenario):
    finder = ResourceFinder.anywhere()
    world = read_world_file(finder.find(scenario.world))
    if not scenario.lighting:
        return world
    light = read_world_file(finder.find(scenario.lighting))
    return replace(world, lights=light.lights, ambient=light.ambient, background=light.background)


class _Drive:
    """A docking under way."""

    def __init__(self, scenario: DockingScenario, dock: Dock, simulation: Simulation):
        self._dock, self._simulation = dock, simulation
        x, y, yaw = scenario.start
        self._robot = simulation.spawn(ROBOT, pose=Pose.from_rpy((x, y, 0.0), (0.0, 0.0, yaw)))
        self._camera = next(d for d in self._robot.plugins if isinstance(d, Camera))
        self._camera.settings = replace(
            self._camera.settings, noise_stddev=scenario.image_noise, blur=scenario.image_blur
        )
        std = scenario.odometry_std if scenario.odometry == "noisy_odom" else 0.0
        self._noise = NoisyPath(ReportRule(std), scenario.odometry_seed)
        marker = dock.marker
        self._dictionary = marker.dictionary
        name = dictionary_named(marker.dictionary).name
        self._detector = MarkerDetector(DetectorSettings(dictionary=name, ids=(marker.id,)))
        self._task = CONTROLLERS[scenario.controller](
            dock,
            dock.pose,
            _mount_of(self._robot, self._camera),
            time_limit=TIME_LIMIT,
            seed=scenario.odometry_seed,
        )
        self._images = self._contacts = 0
        self._touching = False
        self._odometry: Optional[OdometrySample] = None
        self._stamp = 0.0

    def run(self) -> DockingOutcome:
        """Drive to the end."""
        simulation = self._simulation
        simulation.run_until(_SETTLE_STEPS)
        self._robot.listen("odom", self._take_odometry)
        simulation.every(CONTACT_RATE, self._check_contact)
        next_image = simulation.seconds
        while self._task.result is None:
            simulation.run_until(simulation.step + TICK_STEPS)
            self._feed_odometry()
            if simulation.seconds >= next_image - 1e-9:
                next_image += 1.0 / IMAGE_RATE
                if self._task.wants_images:
                    self._look()
            v, w = self._task.tick(simulation.seconds)
            self._robot.command("cmd_vel", PlanarCommand(v, 0.0, w))
        seconds, end = simulation.seconds, _planar(self._robot)
        simulation.run_for(0.5)
        return self._outcome(seconds, end)

    def _take_odometry(self, sample: OdometrySample) -> None:
        self._odometry = sample

    def _feed_odometry(self) -> None:
        sample, self._odometry = self._odometry, None
        if sample is None:
            return
        x, y, _ = sample.pose.position
        noisy = self._noise.update(x, y, sample.pose.yaw)
        seconds = sample.step / 1000.0 - self._stamp
        self._stamp = sample.step / 1000.0
        covariance = noisy.motion_covariance / seconds**2 if seconds > 0.0 else None
        velocity = (sample.velocity.vx, sample.velocity.wz)
        self._task.add_odometry(Odometry(self._stamp, noisy.pose, velocity, covariance))

    def _look(self) -> None:
        simulation, camera = self._simulation, self._camera
        image = camera.take(simulation.step)
        found = self._detector.detect(grey(image, "rgb8"), camera.camera).markers
        sightings = tuple(Sighting(m.id, self._dictionary, m.corners) for m in found)
        self._task.add_observation(Observation(simulation.seconds, camera.camera, sightings))
        self._images += 1

    def _check_contact(self, step: int) -> None:
        touching = any(other != FLOOR for other in self._simulation.contacts(self._robot.name))
        if touching and not self._touching:
            self._contacts += 1
        self._touching = touching

    def _outcome(self, seconds: float, end: PlanarPose) -> DockingOutcome:
        result = self._task.result
        ahead = _mount_of(self._robot, self._camera).x
        errors = docking_errors(
            _planar(self._robot), MARKER_POSE, ahead, self._dock.docked_distance
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
        )


def _planar(robot: ModelInstance) -> PlanarPose:
    pose = robot.pose()
    return pose.position[0], pose.position[1], pose.yaw


def _mount_of(robot: ModelInstance, camera: Camera) -> CameraMount:
    """Return where the camera is on the robot, by the description of the robot."""
    place = robot.pose().inverse() * camera.pose()
    roll, pitch, yaw = place.rpy()
    return CameraMount(*place.position, roll, pitch, yaw)
