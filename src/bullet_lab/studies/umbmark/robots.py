"""Robots on two wheels that are not what their odometry believes: on the floor, and ideal ones."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import List, Optional, Tuple

from bullet_lab.core.pose import Pose
from bullet_lab.core.se2 import PlanarPose
from bullet_lab.errors import LabError
from bullet_lab.noise.systematic import SystematicErrors
from bullet_lab.simulation.plugins.samples import OdometrySample, PlanarCommand
from bullet_lab.simulation.plugins.wheel_drives import DeadReckoning, DiffDrive
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import Collision, Link, Model, PluginTag, Visual
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.shapes import Box, Cylinder, Mesh, Sphere
from bullet_lab.simulation.world.urdf import read_urdf_file

WORLD = "package://bullet_lab/worlds/empty.world"
DRIVE = DiffDrive.filenames[0]
SETTLING_SECONDS = 0.5


class RobotError(LabError):
    """A robot that has no odometry by two wheels."""


@dataclass(frozen=True)
class Wheels:
    """Two wheels: their diameters and the distance of their contacts, in m."""

    left: float
    right: float
    base: float

    def times(self, errors: SystematicErrors) -> Wheels:
        """Return wheels that are so much larger than these.

        >>> Wheels(0.5, 0.5, 1.0).times(SystematicErrors(scale_error=0.5, base_error=0.25))
        Wheels(left=0.75, right=0.75, base=1.25)
        """
        left, right = errors.diameters
        return Wheels(self.left * left, self.right * right, self.base * (1.0 + errors.base_error))


class IdealRobot:
    """A robot whose wheels roll without slipping and turn as they are told, at once.

    Args:
        wheels: that roll.
        believed: what its odometry takes them for, which also makes wheel speeds of commands.
    """

    def __init__(self, wheels: Wheels, believed: Wheels):
        self.believed = believed
        self._rolled = DeadReckoning(wheels.base, 0.5 * wheels.left, 0.5 * wheels.right)
        self._counted = DeadReckoning(believed.base, 0.5 * believed.left, 0.5 * believed.right)
        self._angles = (0.0, 0.0)
        self.odometry: List[PlanarPose] = [self._counted.pose]

    def pose(self) -> PlanarPose:
        """Return where it really is: (m, m, rad)."""
        return self._rolled.pose

    def drive(self, ahead: float, turning: float, seconds: float) -> None:
        """Follow a command (m/s, rad/s), and report."""
        rim = 0.5 * self.believed.base * turning
        left, right = self._angles
        left += 2.0 * (ahead - rim) * seconds / self.believed.left
        right += 2.0 * (ahead + rim) * seconds / self.believed.right
        self._angles = (left, right)
        self._rolled.advance(left, right)
        self._counted.advance(left, right)
        self.odometry.append(self._counted.pose)

    def close(self) -> None:
        """There is nothing to give back."""


def wheeled_model(robot: str) -> Tuple[Model, PluginTag]:
    """Return a robot, and its plugin that drives two wheels.

    Args:
        robot: URDF or xacro file: a path or package://.

    Raises:
        LabError: it cannot be read, or has no such plugin.
    """
    model = read_urdf_file(ResourceFinder.anywhere().find(robot))
    for tag in model.plugins:
        if tag.filename == DRIVE:
            return model, tag
    raise RobotError(f"{robot}: there is no plugin {DRIVE}, whose odometry could be calibrated")


class FloorRobot:
    """A robot on the floor of an empty world, with odometry by its wheels.

    Its wheels are made larger and smaller than they were drawn, and its plugin is told another
    base, so that what rolls is to what the odometry believes as `errors` say. What the plugin
    believes then is changed by `correction`, as found by a calibration.

    Args:
        robot: URDF or xacro file.
        errors: with diameter_error and base_error.
        correction: likewise.
        yaw: rad, of the place that it starts from.

    Raises:
        LabError: it cannot be read, or has no wheels that its plugin could drive.
    """

    def __init__(
        self, robot: str, errors: SystematicErrors, correction: SystematicErrors, yaw: float = 0.0
    ):
        model, tag = wheeled_model(robot)
        self._simulation = Simulation.of(WORLD)
        try:
            drawn = self._drawn(model)
            believed = replace(drawn, base=drawn.base / (1.0 + errors.base_error))
            self.believed = believed.times(correction)
            model = _with_wheels(model, self._joints, errors)
            model = _told(model, tag, self.believed)
            start = Pose.from_rpy(model.pose.position, (0.0, 0.0, yaw))
            self._robot = self._simulation.add(model, pose=start)
            self._drive = self._plugin(self._robot.plugins)
            self._drive.odometry.connect(self._take)
            self.odometry: List[PlanarPose] = []
            self._last: Optional[PlanarPose] = None
            self.drive(0.0, 0.0, SETTLING_SECONDS)
        except BaseException:
            self.close()
            raise

    def _drawn(self, model: Model) -> Wheels:
        """Return what the plugin says of itself, on a copy of the robot."""
        copy = self._simulation.add(model, "copy")
        drive = self._plugin(copy.plugins)
        self._joints = tuple(wheel.joint for wheel in drive.wheels)
        self._simulation.remove("copy")
        left, right = (2.0 * radius for radius in drive.radii)
        return Wheels(left, right, drive.separation)

    @staticmethod
    def _plugin(plugins) -> DiffDrive:
        for plugin in plugins:
            if isinstance(plugin, DiffDrive):
                return plugin
        raise RobotError("the robot's plugin for its wheels does not work")

    def pose(self) -> PlanarPose:
        """Return where it really is: (m, m, rad)."""
        return _planar(self._robot.pose())

    def drive(self, ahead: float, turning: float, seconds: float) -> None:
        """Follow a command (m/s, rad/s)."""
        self._drive.command(PlanarCommand(vx=ahead, wz=turning))
        self._simulation.run_for(seconds)

    def close(self) -> None:
        """Give memory back."""
        self._simulation.close()

    def _take(self, sample: OdometrySample) -> None:
        self.odometry.append(_planar(sample.pose))


def _planar(pose: Pose) -> PlanarPose:
    x, y, _ = pose.position
    return x, y, pose.yaw


def _told(model: Model, tag: PluginTag, believed: Wheels) -> Model:
    """Return the model with a plugin that has encoders and believes in these wheels."""
    tags = {
        **tag.tags,
        "odometrySource": "encoder",
        "wheelSeparation": repr(believed.base),
        "leftWheelDiameter": repr(believed.left),
        "rightWheelDiameter": repr(believed.right),
    }
    told = replace(tag, tags=tags, element=None)
    return replace(model, plugins=tuple(told if one is tag else one for one in model.plugins))


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
