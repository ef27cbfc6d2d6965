"""Robots on two wheels that differ from those that their odometry assumes, and their squares."""

from __future__ import annotations

import contextlib
import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Mapping, Sequence, Tuple, Union

import numpy as np
import yaml

from bullet_lab.core.pose import Pose
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.drive.square import CLOSED_LOOP, CLOSED_LOOP_RATE, Square, SquareDriver
from bullet_lab.errors import LabError
from bullet_lab.noise.systematic import SystematicErrors
from bullet_lab.simulation.plugins import Output
from bullet_lab.simulation.plugins.controllers.description import ControlParameters
from bullet_lab.simulation.plugins.controllers.diff_drive import DiffDriveController
from bullet_lab.simulation.plugins.ros_control import RosControl
from bullet_lab.simulation.plugins.samples import OdometrySample, PlanarCommand
from bullet_lab.simulation.plugins.wheel_drives import DeadReckoning, DiffDrive
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import Link, Model
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.shapes import Box, Cylinder, Mesh, Sphere
from bullet_lab.simulation.world.urdf import read_urdf_file
from bullet_lab.simulation.world.xacro import expand_xacro, is_xacro
from bullet_lab.simulation.world.xml import read_text
from bullet_lab.studies.study import UnfinishedError
from bullet_lab.studies.umbmark.runs import Run

WORLD = "package://bullet_lab/worlds/empty.world"
SETTLING_SECONDS = 0.5
REST_SECONDS = 0.5
PATIENCE = 3.0
"""Timeout of a square, as a multiple of the time that it takes at its speeds."""

MULTIPLIERS = (
    "left_wheel_radius_multiplier",
    "right_wheel_radius_multiplier",
    "wheel_separation_multiplier",
)
"""Parameters of diff_drive_controller."""

_CONTROLLER_TYPE = next(iter(DiffDriveController.kinds))


class RobotError(LabError):
    """A robot does not have odometry by two wheels."""


@dataclass(frozen=True)
class Wheels:
    """Two wheels: their diameters and the distance between their contacts, in m."""

    left: float
    right: float
    base: float

    def times(self, errors: SystematicErrors) -> Wheels:
        """Return these wheels, scaled by relative errors.

        >>> Wheels(0.5, 0.5, 1.0).times(SystematicErrors(scale_error=0.5, base_error=0.25))
        Wheels(left=0.75, right=0.75, base=1.25)
        """
        left, right = errors.diameters
        return Wheels(self.left * left, self.right * right, self.base * (1.0 + errors.base_error))


class IdealRobot:
    """A robot whose wheels roll without slip and follow commands at once.

    Args:
        wheels: the true ones.
        believed: those that its odometry assumes, and that make wheel speeds of commands.

    Attributes:
        odometry: the reported poses (m, m, rad), the newest last.
    """

    def __init__(self, wheels: Wheels, believed: Wheels):
        self.believed = believed
        self._rolled = DeadReckoning(wheels.base, 0.5 * wheels.left, 0.5 * wheels.right)
        self._counted = DeadReckoning(believed.base, 0.5 * believed.left, 0.5 * believed.right)
        self._angles = (0.0, 0.0)
        self.odometry: List[PlanarPose] = [self._counted.pose]

    def pose(self) -> PlanarPose:
        """Return the true pose: (m, m, rad)."""
        return self._rolled.pose

    def drive(self, ahead: float, turning: float, seconds: float) -> None:
        """Follow a command (m/s, rad/s) for a time, then report."""
        rim = 0.5 * self.believed.base * turning
        left, right = self._angles
        left += 2.0 * (ahead - rim) * seconds / self.believed.left
        right += 2.0 * (ahead + rim) * seconds / self.believed.right
        self._angles = (left, right)
        self._rolled.advance(left, right)
        self._counted.advance(left, right)
        self.odometry.append(self._counted.pose)

    def close(self) -> None:
        """Do nothing: it holds no resources."""


def multipliers(errors: SystematicErrors) -> Dict[str, float]:
    """Return the `MULTIPLIERS` that undo errors.

    They keep the mean of the diameters: 2 / (E_d + 1), 2 / (1 / E_d + 1) and E_b.
    """
    return dict(zip(MULTIPLIERS, (*errors.diameters, 1.0 + errors.base_error)))


@dataclass(frozen=True)
class FloorPlan:
    """The files of a robot on the floor.

    Attributes:
        robot: URDF or xacro file: a path or package://.
        controller: YAML file with the parameters of its diff_drive_controller; empty for a robot
            with the plugin libgazebo_ros_diff_drive.so.
    """

    robot: str
    controller: str = ""

    def build(self, errors: SystematicErrors, correction: SystematicErrors) -> FloorRobot:
        """Return the robot, at rest at the origin.

        Args:
            errors: diameter_error and base_error of the true wheels, relative to the assumed ones.
            correction: those that a calibration has found; the assumed wheels are corrected.

        Raises:
            LabError: a file cannot be read, or the robot has no driven wheels.
        """
        with _without_warnings():
            return self._robot(errors, correction)

    def check(self) -> None:
        """Build the robot once, so that its warnings are logged; raises LabError."""
        self._robot(SystematicErrors(), SystematicErrors()).close()

    def _robot(self, errors: SystematicErrors, correction: SystematicErrors) -> FloorRobot:
        kind = ControlledRobot if self.controller else PluginRobot
        return kind(self, errors, correction)


@contextlib.contextmanager
def _without_warnings() -> Iterator[None]:
    """Log no warnings: a robot is built many times, and `check` has logged them."""
    log = logging.getLogger("bullet_lab")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(level)


class FloorRobot:
    """A robot on the floor of an empty world, with odometry by its wheels.

    Its pose is that of the midpoint between its wheels, as is that of its odometry.

    Attributes:
        odometry: the reported poses (m, m, rad), the newest last.
        believed: the wheels that its odometry assumes.
    """

    believed: Wheels

    def __init__(self, model: Model):
        self._simulation = Simulation.of(WORLD)
        self._robot = self._simulation.add(model, pose=model.pose)
        self._axle = Pose()
        self.odometry: List[PlanarPose] = []

    def pose(self) -> PlanarPose:
        """Return the true pose: (m, m, rad)."""
        return _planar(self._robot.pose() * self._axle)

    def drive(self, ahead: float, turning: float, seconds: float) -> None:
        """Follow a command (m/s, rad/s) for a time."""
        self._command(PlanarCommand(vx=ahead, wz=turning))
        self._simulation.run_for(seconds)

    def close(self) -> None:
        """Close the simulation."""
        self._simulation.close()

    def _start(self, wheels: Sequence[str], odometry: Output, command: Any) -> None:
        """Connect odometry and command, and settle; the wheels are names of joints."""
        model = self._robot.model
        links, children = model.links_by_name(), {j.name: j.child for j in model.joints}
        hubs = [links[children[name]].pose.position for name in wheels]
        x, y, z = (sum(values) / len(hubs) for values in zip(*hubs))
        self._axle = Pose((x, y, z))
        odometry.connect(self._add_odometry)
        self._command = command
        self.drive(0.0, 0.0, SETTLING_SECONDS)

    def _add_odometry(self, sample: OdometrySample) -> None:
        self.odometry.append(_planar(sample.pose))


class PluginRobot(FloorRobot):
    """A robot with a diff_drive plugin.

    For errors of the diameters, its wheels become larger and smaller than in the file, without
    the plugin's knowledge. For an error of the base, the plugin gets another base. The plugin
    reports at least at the rate of the driver of squares, so that the robot stops in time.
    """

    def __init__(self, plan: FloorPlan, errors: SystematicErrors, correction: SystematicErrors):
        model = _read(plan.robot)
        tag = next((tag for tag in model.plugins if tag.filename in DiffDrive.filenames), None)
        if tag is None:
            raise RobotError(
                f"{plan.robot}: there is no plugin {DiffDrive.filenames[0]}, and no controller"
            )
        drawn, joints = _drawn_wheels(model)
        believed = replace(drawn, base=drawn.base / (1.0 + errors.base_error))
        self.believed = believed.times(correction)
        tags = {
            **tag.tags,
            "odometrySource": "encoder",
            "updateRate": _update_rate(tag.tags.get("updateRate", "")),
            "wheelSeparation": repr(self.believed.base),
            "leftWheelDiameter": repr(self.believed.left),
            "rightWheelDiameter": repr(self.believed.right),
        }
        changed = replace(tag, tags=tags, element=None)
        plugins = tuple(changed if one is tag else one for one in model.plugins)
        super().__init__(replace(_scaled_wheels(model, joints, errors), plugins=plugins))
        plugin = _diff_drive(self._robot.plugins)
        self._start(joints, plugin.odometry, plugin.command)


class ControlledRobot(FloorRobot):
    """A robot with a diff_drive_controller of ros_control.

    Errors are in the controller's multipliers: it assumes other wheels than the true ones.
    """

    def __init__(self, plan: FloorPlan, errors: SystematicErrors, correction: SystematicErrors):
        found = ResourceFinder.anywhere().find(plan.robot)
        super().__init__(_read(plan.robot))
        plugin = next((p for p in self._robot.plugins if isinstance(p, RosControl)), None)
        if plugin is None:
            raise RobotError(f"{plan.robot}: there is no plugin {RosControl.filenames[0]}")
        tree, name = _find_controller(plan.controller)
        parameters = dict(tree[name])
        both = parameters.pop("wheel_radius_multiplier", None)
        if both is not None:
            parameters.update(dict.fromkeys(MULTIPLIERS[:2], both))
        parameters["publish_rate"] = max(CLOSED_LOOP_RATE, parameters.get("publish_rate", 0.0))
        for key, wrong in multipliers(errors).items():
            parameters[key] = parameters.get(key, 1.0) / wrong * multipliers(correction)[key]
        urdf = expand_xacro(found) if is_xacro(found) else read_text(found)
        manager = plugin.configure(urdf, tree)
        controller = manager.load(name, ControlParameters(parameters, f"{plugin.namespace}{name}"))
        manager.switch([name], [])
        left, right = (2.0 * radius for radius in controller.radii)
        self.believed = Wheels(left, right, controller.separation)
        wheels = [joint.name for joint in controller.joints]
        self._start(wheels, controller.odometry, controller.command)


def _read(robot: str) -> Model:
    return read_urdf_file(ResourceFinder.anywhere().find(robot))


def _planar(pose: Pose) -> PlanarPose:
    x, y, _ = pose.position
    return x, y, pose.yaw


def _find_controller(file: str) -> Tuple[Mapping[str, Any], str]:
    """Return the mapping that holds the parameters of a diff_drive_controller, and its name."""
    path = Path(ResourceFinder.anywhere().find(file))
    try:
        trees = [yaml.safe_load(path.read_text())]
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise RobotError(f"cannot read {file}: {' '.join(str(error).split())}") from None
    while trees:
        tree = trees.pop()
        for name, own in tree.items() if isinstance(tree, Mapping) else ():
            if isinstance(own, Mapping) and own.get("type") == _CONTROLLER_TYPE:
                return tree, name
            trees.append(own)
    raise RobotError(f"{file}: there is no controller of the type {_CONTROLLER_TYPE}")


def _drawn_wheels(model: Model) -> Tuple[Wheels, Tuple[str, ...]]:
    """Return the wheels of the diff_drive plugin, and the names of their joints."""
    with _without_warnings(), Simulation.of(WORLD) as simulation:
        drive = _diff_drive(simulation.add(model).plugins)
        left, right = (2.0 * radius for radius in drive.radii)
        return Wheels(left, right, drive.separation), tuple(wheel.joint for wheel in drive.wheels)


def _diff_drive(plugins: Sequence[Any]) -> DiffDrive:
    for plugin in plugins:
        if isinstance(plugin, DiffDrive):
            return plugin
    raise RobotError("the robot's diff_drive plugin does not work; see the warnings")


def _update_rate(rate: str) -> str:
    """Return an updateRate (Hz, 0: always) that is high enough for squares."""
    try:
        too_low = 0.0 < float(rate) < CLOSED_LOOP_RATE
    except ValueError:
        # The plugin uses its default.
        return rate
    return str(CLOSED_LOOP_RATE) if too_low else rate


def _scaled_wheels(model: Model, joints: Sequence[str], errors: SystematicErrors) -> Model:
    """Return the model with the wheels on its left and right joint scaled by their errors."""
    factors = dict(zip(joints, errors.diameters))
    of_link = {j.child: factors[j.name] for j in model.joints if j.name in factors}
    links = (_scaled_link(link, of_link.get(link.name, 1.0)) for link in model.links)
    return replace(model, links=tuple(links))


def _scaled_link(link: Link, factor: float) -> Link:
    def scaled(part: Any) -> Any:
        position = tuple(factor * value for value in part.pose.position)
        pose = replace(part.pose, position=position)
        return replace(part, geometry=_scaled_shape(part.geometry, factor), pose=pose)

    if factor == 1.0:
        return link
    return replace(
        link,
        collisions=tuple(map(scaled, link.collisions)),
        visuals=tuple(map(scaled, link.visuals)),
    )


def _scaled_shape(shape: Any, factor: float) -> Any:
    if isinstance(shape, (Cylinder, Sphere)):
        return replace(shape, radius=factor * shape.radius)
    if isinstance(shape, Box):
        return replace(shape, size=tuple(factor * side for side in shape.size))
    if isinstance(shape, Mesh):
        return replace(shape, scale=tuple(factor * part for part in shape.scale))
    return shape


def drive_square(
    robot: Union[IdealRobot, FloorRobot],
    square: Square,
    name: str,
    noisy: Callable[[PlanarPose], PlanarPose] = lambda pose: pose,
) -> Run:
    """Drive a square by odometry, with a rest after it.

    Args:
        robot: that stands still.
        square: clockwise if its turn speed is negative.
        name: of the run.
        noisy: returns the pose to drive by for each reported one, in order.

    Raises:
        UnfinishedError: the robot does not complete the square in time.
    """
    driver = SquareDriver(square, CLOSED_LOOP)
    start, period = robot.pose(), 1.0 / driver.rate
    first = len(robot.odometry) - 1
    reported: List[PlanarPose] = []

    def newest() -> PlanarPose:
        while first + len(reported) < len(robot.odometry):
            reported.append(noisy(robot.odometry[first + len(reported)]))
        return reported[-1]

    seconds = square.sides * (square.side / square.speed + np.pi / abs(square.turn_speed))
    for _ in range(round(PATIENCE * seconds / period)):
        command = driver.command(newest())
        if command is None:
            robot.drive(0.0, 0.0, REST_SECONDS)
            newest()
            return Run(name, np.array(reported), start, robot.pose())
        robot.drive(*command, period)
    raise UnfinishedError(f"{name}: the robot does not complete its square in time")
