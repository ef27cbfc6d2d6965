"""Robots on a floor, with encoder odometry that is wrong about their wheels."""

from __future__ import annotations

import contextlib
import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping, Sequence, Tuple

import yaml

from bullet_lab.core.pose import Pose
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.drive.square import CLOSED_LOOP_RATE
from bullet_lab.errors import LabError
from bullet_lab.noise.systematic import SystematicErrors
from bullet_lab.simulation.plugins.controllers.description import ControlParameters
from bullet_lab.simulation.plugins.controllers.diff_drive import DiffDriveController
from bullet_lab.simulation.plugins.plugin import Output
from bullet_lab.simulation.plugins.ros_control import RosControl
from bullet_lab.simulation.plugins.samples import OdometrySample, PlanarCommand
from bullet_lab.simulation.plugins.wheel_drives import DiffDrive
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import Collision, Link, Model, PluginTag, Visual
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.shapes import Box, Cylinder, Mesh, Sphere
from bullet_lab.simulation.world.urdf import read_urdf_file
from bullet_lab.simulation.world.xacro import expand_xacro, is_xacro
from bullet_lab.simulation.world.xml import read_text
from bullet_lab.studies.umbmark.robots import Wheels

WORLD = "package://bullet_lab/worlds/empty.world"
SETTLING_SECONDS = 0.5
MULTIPLIERS = (
    "left_wheel_radius_multiplier",
    "right_wheel_radius_multiplier",
    "wheel_separation_multiplier",
)
"""Parameters of diff_drive_controller."""

_KIND = next(iter(DiffDriveController.kinds))


class RobotError(LabError):
    """A robot that has no odometry by two wheels."""


def multipliers(errors: SystematicErrors) -> Dict[str, float]:
    """Return the `MULTIPLIERS` that undo errors.

    They keep the mean of the diameters: 2 / (E_d + 1), 2 / (1 / E_d + 1) and E_b.
    """
    return dict(zip(MULTIPLIERS, (*errors.diameters, 1.0 + errors.base_error)))


@dataclass(frozen=True)
class FloorPlan:
    """What a robot on the floor is made of.

    Attributes:
        robot: URDF or xacro file: a path or package://.
        controller: YAML file with the parameters of its diff_drive_controller; empty for a robot
            with the plugin libgazebo_ros_diff_drive.so.
    """

    robot: str
    controller: str = ""

    def build(self, errors: SystematicErrors, correction: SystematicErrors) -> FloorRobot:
        """Return the robot, standing at the origin.

        Args:
            errors: with diameter_error and base_error: what rolls, relative to what is believed.
            correction: likewise, as found by a calibration: undone in what is believed.

        Raises:
            LabError: a file cannot be read, or there are no wheels that could be driven.
        """
        with _quietly():
            return self._kind(self, errors, correction)

    def check(self) -> None:
        """Build the robot once, so that what is odd about it is said; raises LabError."""
        self._kind(self, SystematicErrors(), SystematicErrors()).close()

    @property
    def _kind(self) -> Any:
        return ControlledRobot if self.controller else PluginRobot


@contextlib.contextmanager
def _quietly() -> Iterator[None]:
    """Keep to oneself what is odd about a robot: it is built many times."""
    log = logging.getLogger("bullet_lab")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(level)


class FloorRobot:
    """A robot on the floor of an empty world, with odometry by its wheels.

    Its pose is that of the middle between its wheels, which is what they tell of.

    Attributes:
        odometry: what was reported so far: (m, m, rad).
        believed: what its odometry takes the wheels for.
    """

    believed: Wheels

    def __init__(self, model: Model):
        self._simulation = Simulation.of(WORLD)
        self._robot = self._simulation.add(model, pose=model.pose)
        self._axle = Pose()
        self.odometry: List[PlanarPose] = []

    def pose(self) -> PlanarPose:
        """Return where it really is: (m, m, rad)."""
        return _planar(self._robot.pose() * self._axle)

    def drive(self, ahead: float, turning: float, seconds: float) -> None:
        """Follow a command (m/s, rad/s)."""
        self._command(PlanarCommand(vx=ahead, wz=turning))
        self._simulation.run_for(seconds)

    def close(self) -> None:
        """Give memory back."""
        self._simulation.close()

    def _start(self, wheels: Sequence[str], odometry: Output, command: Any) -> None:
        """Get ready: wheels by the names of their joints."""
        model = self._robot.model
        links, children = model.links_by_name(), {j.name: j.child for j in model.joints}
        hubs = [links[children[name]].pose.position for name in wheels]
        x, y, z = (sum(values) / len(hubs) for values in zip(*hubs))
        self._axle = Pose((x, y, z))
        odometry.connect(self._take)
        self._command = command
        self.drive(0.0, 0.0, SETTLING_SECONDS)

    def _take(self, sample: OdometrySample) -> None:
        self.odometry.append(_planar(sample.pose))


class PluginRobot(FloorRobot):
    """A robot that the plugin of diff_drive drives.

    For errors of the diameters its wheels are made larger and smaller than they were drawn, which
    the plugin does not know; for one of the base the plugin is told another. It reports at
    least as often as the driver of squares looks, which could not stop where it must otherwise.
    """

    def __init__(self, plan: FloorPlan, errors: SystematicErrors, correction: SystematicErrors):
        model = _read(plan.robot)
        tags = [tag for tag in model.plugins if tag.filename in DiffDrive.filenames]
        if not tags:
            raise RobotError(
                f"{plan.robot}: there is no plugin {DiffDrive.filenames[0]}, and no controller"
            )
        drawn, joints = _drawn(model)
        believed = replace(drawn, base=drawn.base / (1.0 + errors.base_error))
        self.believed = believed.times(correction)
        model = _told(_with_wheels(model, joints, errors), tags[0], self.believed)
        super().__init__(model)
        plugin = _diff_drive(self._robot.plugins)
        self._start(joints, plugin.odometry, plugin.command)


class ControlledRobot(FloorRobot):
    """A robot that ros_control's diff_drive_controller drives.

    Errors are in its multipliers: it believes in other wheels than those that are there.
    """

    def __init__(self, plan: FloorPlan, errors: SystematicErrors, correction: SystematicErrors):
        found = ResourceFinder.anywhere().find(plan.robot)
        super().__init__(_read(plan.robot))
        plugin = next((p for p in self._robot.plugins if isinstance(p, RosControl)), None)
        if plugin is None:
            raise RobotError(f"{plan.robot}: there is no plugin {RosControl.filenames[0]}")
        around, name = _controller_in(plan.controller)
        told = _both_sides(around[name])
        told["publish_rate"] = max(CLOSED_LOOP_RATE, told.get("publish_rate", 0.0))
        for key, wrong in multipliers(errors).items():
            told[key] = told.get(key, 1.0) / wrong * multipliers(correction)[key]
        urdf = expand_xacro(found) if is_xacro(found) else read_text(found)
        manager = plugin.configure(urdf, around)
        controller = manager.load(name, ControlParameters(told, f"{plugin.namespace}{name}"))
        manager.switch([name], [])
        left, right = (2.0 * radius for radius in controller.radii)
        self.believed = Wheels(left, right, controller.separation)
        wheels = [joint.name for joint in controller.joints]
        self._start(wheels, controller.odometry, controller.command)


def _read(robot: str) -> Model:
    return read_urdf_file(ResourceFinder.anywhere().find(robot))


def _controller_in(file: str) -> Tuple[Mapping[str, Any], str]:
    """Return the parameters around those of the diff_drive_controller in a file, and its name."""
    path = Path(ResourceFinder.anywhere().find(file))
    try:
        tree = yaml.safe_load(path.read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise RobotError(f"cannot read {file}: {' '.join(str(error).split())}") from None
    waiting = [tree]
    while waiting:
        around = waiting.pop()
        for name, own in around.items() if isinstance(around, Mapping) else ():
            if isinstance(own, Mapping) and own.get("type") == _KIND:
                return around, name
            waiting.append(own)
    raise RobotError(f"{file}: there is no controller of the type {_KIND}")


def _both_sides(parameters: Mapping[str, Any]) -> Dict[str, Any]:
    """Return parameters that say each multiplier on its own."""
    told = dict(parameters)
    both = told.pop("wheel_radius_multiplier", None)
    return told if both is None else {**told, MULTIPLIERS[0]: both, MULTIPLIERS[1]: both}


def _drawn(model: Model) -> Tuple[Wheels, Tuple[str, ...]]:
    """Return what the plugin of diff_drive says of its wheels, and its joints."""
    with _quietly(), Simulation.of(WORLD) as simulation:
        drive = _diff_drive(simulation.add(model).plugins)
        left, right = (2.0 * radius for radius in drive.radii)
        return Wheels(left, right, drive.separation), tuple(wheel.joint for wheel in drive.wheels)


def _diff_drive(plugins) -> DiffDrive:
    for plugin in plugins:
        if isinstance(plugin, DiffDrive):
            return plugin
    raise RobotError("the robot's plugin for its wheels does not work")


def _planar(pose: Pose) -> PlanarPose:
    x, y, _ = pose.position
    return x, y, pose.yaw


def _told(model: Model, tag: PluginTag, believed: Wheels) -> Model:
    """Return the model with a plugin that has encoders and believes in these wheels."""
    tags = {
        **tag.tags,
        "odometrySource": "encoder",
        "updateRate": _often_enough(tag.tags.get("updateRate", "")),
        "wheelSeparation": repr(believed.base),
        "leftWheelDiameter": repr(believed.left),
        "rightWheelDiameter": repr(believed.right),
    }
    told = replace(tag, tags=tags, element=None)
    return replace(model, plugins=tuple(told if one is tag else one for one in model.plugins))


def _often_enough(rate: str) -> str:
    """Return an updateRate (Hz, 0: always) at which squares can be driven."""
    try:
        rarely = 0.0 < float(rate) < CLOSED_LOOP_RATE
    except ValueError:
        # The plugin has its own.
        return rate
    return str(CLOSED_LOOP_RATE) if rarely else rate


def _with_wheels(model: Model, joints: Tuple[str, ...], errors: SystematicErrors) -> Model:
    """Return the model with the wheels on its left and right joint as much larger as said."""
    factors = dict(zip(joints, errors.diameters))
    of_link = {j.child: factors[j.name] for j in model.joints if j.name in factors}
    links = (_larger(link, of_link.get(link.name, 1.0)) for link in model.links)
    return replace(model, links=tuple(links))


def _larger(link: Link, factor: float) -> Link:
    def larger(shape: object) -> object:
        assert isinstance(shape, (Collision, Visual))
        position = tuple(factor * value for value in shape.pose.position)
        pose = replace(shape.pose, position=position)
        return replace(shape, geometry=_larger_shape(shape.geometry, factor), pose=pose)

    if factor == 1.0:
        return link
    return replace(
        link,
        collisions=tuple(map(larger, link.collisions)),
        visuals=tuple(map(larger, link.visuals)),
    )


def _larger_shape(shape, factor: float):
    if isinstance(shape, (Cylinder, Sphere)):
        return replace(shape, radius=factor * shape.radius)
    if isinstance(shape, Box):
        return replace(shape, size=tuple(factor * side for side in shape.size))
    if isinstance(shape, Mesh):
        return replace(shape, scale=tuple(factor * part for part in shape.scale))
    return shape
