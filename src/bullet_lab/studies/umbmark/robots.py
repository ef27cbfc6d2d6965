"""Robots on two wheels that differ from those that their odometry assumes, and their squares."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Mapping, Sequence

import numpy as np
import yaml

from bullet_lab.core.parameters import choice, integer, number, text
from bullet_lab.core.pose import Pose
from bullet_lab.core.schedule import Schedule
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.drive import CLOSED_LOOP, CLOSED_LOOP_RATE, Square, SquareDriver
from bullet_lab.errors import LabError
from bullet_lab.noise.odometry_noise import LARGEST_PARAMETER, MODELS, NoisyPath, derived_seed
from bullet_lab.noise.systematic import TICKS, SystematicErrors, SystematicPath
from bullet_lab.simulation.plugins.controllers import ControlParameters
from bullet_lab.simulation.plugins.controllers.diff_drive import DiffDriveController
from bullet_lab.simulation.plugins.ros_control import RosControl
from bullet_lab.simulation.plugins.samples import OdometrySample, PlanarCommand
from bullet_lab.simulation.plugins.wheel_drives import DeadReckoning, DiffDrive
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import Model
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.urdf import read_urdf_file, read_urdf_text
from bullet_lab.studies.study import MOST_SEED, Settings, UnfinishedError
from bullet_lab.studies.umbmark.estimate import CLOCKWISE, DIRECTIONS, SquareRun

WORLD = "package://bullet_lab/worlds/empty.world"
SETTLING_SECONDS = 0.5
REST_SECONDS = 0.5
PATIENCE = 3.0
"""Timeout of a square, as a multiple of the time that it takes at its speeds."""

LARGEST_ERROR = 0.1
# m, of ideal wheels.
DIAMETER = 0.2
NO_ERRORS = SystematicErrors()

MULTIPLIERS = (
    "left_wheel_radius_multiplier",
    "right_wheel_radius_multiplier",
    "wheel_separation_multiplier",
)
"""Parameters of diff_drive_controller."""

CONTROLLER_TYPE = "diff_drive_controller/DiffDriveController"


class IdealRobot:
    """A robot whose wheels roll without slip and follow commands at once.

    Args:
        base: nominal distance of the wheels, m.
        errors: of the true wheels, relative to the nominal ones.
        correction: of those that its odometry assumes, and that make wheel speeds of commands.

    Attributes:
        base: that its odometry assumes, m.
        odometry: the reported poses (m, m, rad), the newest last.
    """

    def __init__(self, base: float, errors: SystematicErrors, correction: SystematicErrors):
        self.base = base * (1.0 + correction.base_error)
        self._assumed = [DIAMETER * factor for factor in correction.diameters]
        left, right = (0.5 * (DIAMETER * factor) for factor in errors.diameters)
        self._rolled = DeadReckoning(base * (1.0 + errors.base_error), left, right)
        self._counted = DeadReckoning(self.base, *(0.5 * diameter for diameter in self._assumed))
        self._angles = (0.0, 0.0)
        self.odometry: list[PlanarPose] = [self._counted.pose]

    def pose(self) -> PlanarPose:
        """Return the true pose: (m, m, rad)."""
        return self._rolled.pose

    def drive(self, ahead: float, turning: float, seconds: float) -> None:
        """Follow a command (m/s, rad/s) for a time, then report."""
        rim = 0.5 * self.base * turning
        left, right = self._angles
        left += 2.0 * (ahead - rim) * seconds / self._assumed[0]
        right += 2.0 * (ahead + rim) * seconds / self._assumed[1]
        self._angles = (left, right)
        self._rolled.advance(left, right)
        self._counted.advance(left, right)
        self.odometry.append(self._counted.pose)

    def close(self) -> None:
        """Do nothing: it holds no resources."""


class FloorRobot:
    """A robot on the floor of an empty world, at rest at the origin, with odometry by its wheels.

    Its plugin or its controller gets other diameters and another base than the true ones. Poses are
    those of the midpoint between its wheels.

    Args:
        robot: URDF or xacro file: a path or package://.
        controller: YAML file with the parameters of its diff_drive_controller; empty for a robot
            with libgazebo_ros_diff_drive.so.
        errors: diameter_error and base_error of the true wheels, relative to the assumed ones.
        correction: those that a calibration has found; the assumed wheels are corrected.

    Attributes:
        odometry: the reported poses (m, m, rad), the newest last.
        base: that its odometry assumes, m.
        radii: of the left and the right wheel that it assumes, m.

    Raises:
        LabError: a file cannot be read, or the robot has no driven wheels.
    """

    def __init__(
        self, robot: str, controller: str, errors: SystematicErrors, correction: SystematicErrors
    ):
        file = ResourceFinder.anywhere().find(robot)
        model = read_urdf_file(file)
        factors = assumed_multipliers(errors, correction)
        self._simulation = Simulation.of(WORLD)
        self._robot = self._simulation.add(model, pose=model.pose)
        kind = RosControl if controller else DiffDrive
        drive = next((one for one in self._robot.plugins if isinstance(one, kind)), None)
        if drive is None:
            raise LabError(f"{robot}: there is no plugin {kind.filenames[0]} that works")
        if controller:
            drive = _load_controller(drive, read_urdf_text(file), controller, factors)
            joints = [joint.name for joint in drive.joints]
        else:
            _assume_others(drive, factors)
            joints = [wheel.joint for wheel in drive.wheels]
        self.base, self.radii = drive.separation, drive.radii
        self._axle = _middle(model, joints)
        self.odometry: list[PlanarPose] = []
        drive.odometry.connect(self._add_odometry)
        self._command = drive.command
        self.drive(0.0, 0.0, SETTLING_SECONDS)

    def pose(self) -> PlanarPose:
        """Return the true pose: (m, m, rad)."""
        return (self._robot.pose() * self._axle).planar

    def drive(self, ahead: float, turning: float, seconds: float) -> None:
        """Follow a command (m/s, rad/s) for a time."""
        self._command(PlanarCommand(vx=ahead, wz=turning))
        self._simulation.run_for(seconds)

    def close(self) -> None:
        """Close the simulation."""
        self._simulation.close()

    def _add_odometry(self, sample: OdometrySample) -> None:
        self.odometry.append(sample.pose.planar)


def _middle(model: Model, joints: Sequence[str]) -> Pose:
    """Return the point in the middle of the children of some joints."""
    links, children = model.links_by_name(), {j.name: j.child for j in model.joints}
    hubs = [links[children[name]].pose.position for name in joints]
    x, y, z = (sum(values) / len(hubs) for values in zip(*hubs))
    return Pose((x, y, z))


def _assume_others(drive: DiffDrive, factors: Mapping[str, float]) -> None:
    """Have a plugin assume its wheels times `factors`."""
    left, right, base = factors.values()
    drive.assume(base * drive.separation, (left * drive.radii[0], right * drive.radii[1]))
    # At least at the rate of the driver of squares, so that the robot stops in time.
    if drive.schedule.period > 1.0 / CLOSED_LOOP_RATE:
        drive.schedule = Schedule(CLOSED_LOOP_RATE)


def multipliers(errors: SystematicErrors) -> dict[str, float]:
    """Return the `MULTIPLIERS` that undo errors.

    They keep the mean of the diameters: 2 / (E_d + 1), 2 / (1 / E_d + 1) and E_b.
    """
    return dict(zip(MULTIPLIERS, (*errors.diameters, 1.0 + errors.base_error)))


def assumed_multipliers(
    errors: SystematicErrors, correction: SystematicErrors
) -> dict[str, float]:
    """Return the `MULTIPLIERS` of odometry with errors, and with a correction of them."""
    wrong, corrected = multipliers(errors), multipliers(correction)
    return {name: corrected[name] / wrong[name] for name in MULTIPLIERS}


def _load_controller(
    plugin: RosControl, urdf: str, file: str, factors: Mapping[str, float]
) -> DiffDriveController:
    """Start the diff_drive_controller of a file with its multipliers times `factors`."""
    tree, name = _find_controller(file)
    parameters = dict(tree[name])
    both = parameters.pop("wheel_radius_multiplier", None)
    if both is not None:
        parameters.update(dict.fromkeys(MULTIPLIERS[:2], both))
    parameters["publish_rate"] = max(CLOSED_LOOP_RATE, parameters.get("publish_rate", 0.0))
    for key, factor in factors.items():
        parameters[key] = parameters.get(key, 1.0) * factor
    manager = plugin.configure(urdf, tree)
    controller = manager.load(name, ControlParameters(parameters, f"{plugin.namespace}{name}"))
    manager.switch([name], [])
    return controller


def _find_controller(file: str) -> tuple[Mapping[str, Any], str]:
    """Return the mapping that holds the parameters of a diff_drive_controller, and its name."""
    path = Path(ResourceFinder.anywhere().find(file))
    try:
        trees = [yaml.safe_load(path.read_text())]
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise LabError(f"cannot read {file}: {' '.join(str(error).split())}") from None
    while trees:
        tree = trees.pop()
        for name, own in tree.items() if isinstance(tree, Mapping) else ():
            if isinstance(own, Mapping) and own.get("type") == CONTROLLER_TYPE:
                return tree, name
            trees.append(own)
    raise LabError(f"{file}: there is no controller of the type {CONTROLLER_TYPE}")


def _error(doc: str) -> Any:
    return number(0.0, doc, -LARGEST_ERROR, maximum=LARGEST_ERROR)


@dataclass(frozen=True)
class BenchmarkSettings(Settings):
    """The robot and its squares."""

    robot: str = text(
        "package://bullet_lab/urdf/camera_robot.urdf", "URDF of a robot on two wheels"
    )
    controller: str = text(
        "", "YAML file of its diff_drive_controller; else its plugin diff_drive drives it"
    )
    diameter_error: float = _error(
        "right / left diameter of the true wheels, relative to the assumed ones, - 1"
    )
    base_error: float = _error("base of the true wheels / the one that odometry assumes - 1")
    side: float = number(4.0, "m, of the square", 0.1, maximum=100.0)
    runs: int = integer(5, "squares in each direction", 1, 1000)
    speed: float = number(0.2, "m/s, on the sides", above=0.0)
    turn_speed: float = number(0.5236, "rad/s, at the corners", above=0.0)
    std: float = number(
        0.0005, "level of random noise on the odometry", 0.0, maximum=LARGEST_PARAMETER
    )
    model: str = choice("rate_invariant", "rule of the noise", MODELS)
    ticks_per_metre: float = TICKS
    seed: int = integer(1, "seed of the noise", 0, MOST_SEED)

    @property
    def errors(self) -> SystematicErrors:
        """Errors of the true wheels, relative to those that odometry assumes at first."""
        return SystematicErrors(diameter_error=self.diameter_error, base_error=self.base_error)

    def square(self, direction: str) -> Square:
        """Return the square in a direction."""
        turn = -self.turn_speed if direction == CLOCKWISE else self.turn_speed
        return Square(side=self.side, speed=self.speed, turn_speed=turn)

    def noise(self, number: int, laps: int, base: float) -> Callable[[PlanarPose], PlanarPose]:
        """Return a function that makes the pose with ticks and noise of each odometry pose.

        `base` (m) is the one that the odometry assumes.
        """
        encoders = SystematicErrors(ticks_per_metre=self.ticks_per_metre, wheel_base=base)
        counted = SystematicPath(encoders)
        if self.std == 0.0:
            return lambda pose: counted.update(*pose).pose
        rule = MODELS[self.model].at_level(self.std)
        path = NoisyPath(rule, derived_seed(derived_seed(self.seed, laps), number))
        return lambda pose: path.update(*counted.update(*pose).pose).pose


def drive_run(
    settings: BenchmarkSettings,
    correction: SystematicErrors,
    laps: int,
    ideal_base: float | None,
    number: int,
) -> SquareRun:
    """Drive a run, clockwise if its number is even.

    Args:
        settings: of the drive.
        correction: errors that an earlier calibration has found.
        laps: number of rounds of runs before this one; it selects the noise.
        ideal_base: m, of a robot whose wheels roll ideally; None for a robot on the floor.
        number: of the run, from 0 on.
    """
    direction = DIRECTIONS[number % len(DIRECTIONS)]
    if ideal_base is None:
        robot = FloorRobot(settings.robot, settings.controller, settings.errors, correction)
    else:
        robot = IdealRobot(ideal_base, settings.errors, correction)
    with contextlib.closing(robot):
        name = f"{direction} {number // len(DIRECTIONS) + 1}"
        noise = settings.noise(number, laps, robot.base)
        return drive_square(robot, settings.square(direction), name, noise)


def drive_square(
    robot: IdealRobot | FloorRobot,
    square: Square,
    name: str,
    noisy: Callable[[PlanarPose], PlanarPose] = lambda pose: pose,
) -> SquareRun:
    """Drive a square by odometry, clockwise if its turn speed is negative, with a rest after it.

    `noisy` returns the pose to drive by for each reported one, in order. Raises UnfinishedError if
    the robot does not complete the square in time.
    """
    driver = SquareDriver(square, CLOSED_LOOP)
    start, period = robot.pose(), 1.0 / driver.rate
    first = len(robot.odometry) - 1
    reported: list[PlanarPose] = []

    def newest() -> PlanarPose:
        reported.extend(map(noisy, robot.odometry[first + len(reported) :]))
        return reported[-1]

    seconds = square.sides * (square.side / square.speed + np.pi / abs(square.turn_speed))
    for _ in range(round(PATIENCE * seconds / period)):
        command = driver.command(newest())
        if command is None:
            robot.drive(0.0, 0.0, REST_SECONDS)
            newest()
            return SquareRun(name, np.array(reported), start, robot.pose(), robot.base)
        robot.drive(*command, period)
    raise UnfinishedError(f"{name}: the robot does not complete its square in time")
