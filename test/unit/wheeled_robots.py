"""Robots on wheels as people bring them, written anew: each with a class of trouble."""

import math
import struct
from dataclasses import dataclass, replace

import numpy as np

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.urdf import read_urdf

FLOOR = "package://bullet_lab/worlds/empty.world"
# As it is often written: a little less than a right angle.
NEARLY_A_QUARTER = 1.57


@dataclass(frozen=True)
class Robot:
    """Two driven wheels on one axle and casters behind; masses in kg, lengths in m.

    `casters` are places (x, y) of small boxes that slide, or of balls if `balls`. Tags of the
    wheels' and the casters' links are given as Gazebo's.
    """

    mass: float = 0.9
    radius: float = 0.035
    width: float = 0.02
    separation: float = 0.16
    centre: tuple = (-0.005, 0.0, 0.02)
    casters: tuple = ((-0.08, 0.0),)
    balls: bool = False
    wheel_tags: str = "<mu1>0.1</mu1><mu2>0.1</mu2>"
    caster_tags: str = "<mu1>0.1</mu1><mu2>0.1</mu2>"
    wheel: str = ""
    torque: float = 10.0
    acceleration: float = 1.0
    source: str = "encoder"

    def model(self, folder=None):
        """Return it as a model; a wheel of "mesh" is written to the folder."""
        size = 2.0 * max(self.separation - self.width, abs(self.casters[0][0]))
        third = self.mass * size**2 / 12.0
        shape = self.wheel or f'<cylinder radius="{self.radius}" length="{self.width}"/>'
        if shape == "mesh":
            wheel_mesh(folder / "wheel.stl", self.radius, self.width)
            shape = '<mesh filename="wheel.stl"/>'
        wheels = "".join(
            _wheel(side, sign * 0.5 * self.separation, self.radius, 0.03 * self.mass, shape)
            + f'<gazebo reference="{side}_wheel">{self.wheel_tags}</gazebo>'
            for side, sign in (("left", 1.0), ("right", -1.0))
        )
        casters = "".join(
            _caster(n, *place, self.balls)
            + f'<gazebo reference="caster{n}">{self.caster_tags}</gazebo>'
            for n, place in enumerate(self.casters)
        )
        x, y, z = self.centre
        text = (
            '<robot name="wheeled"><link name="footprint"/><link name="base"><inertial>'
            f'<origin xyz="{x} {y} {z}"/><mass value="{self.mass}"/>'
            f'<inertia ixx="{third}" iyy="{third}" izz="{1.5 * third}"/></inertial><collision>'
            f'<origin xyz="0 0 {2 * self.radius + 0.03}"/><geometry>'
            f'<box size="{size} {size} 0.06"/></geometry></collision></link>'
            '<joint name="up" type="fixed"><parent link="footprint"/><child link="base"/></joint>'
            f"{wheels}{casters}<gazebo><plugin name='drive' "
            "filename='libgazebo_ros_diff_drive.so'><leftJoint>left</leftJoint>"
            f"<rightJoint>right</rightJoint><wheelSeparation>{self.separation}</wheelSeparation>"
            f"<wheelDiameter>{2 * self.radius}</wheelDiameter><updateRate>30</updateRate>"
            f"<wheelTorque>{self.torque}</wheelTorque><odometrySource>{self.source}"
            f"</odometrySource><wheelAcceleration>{self.acceleration}</wheelAcceleration>"
            "</plugin></gazebo></robot>"
        )
        return read_urdf(text, "wheeled", folder)


def _wheel(side, y, radius, mass, shape):
    along, across = 0.5 * mass * radius**2, 0.27 * mass * radius**2
    return (
        f'<link name="{side}_wheel"><inertial><mass value="{mass}"/>'
        f'<inertia ixx="{across}" iyy="{across}" izz="{along}"/></inertial>'
        f"<collision><geometry>{shape}</geometry></collision></link>"
        f'<joint name="{side}" type="continuous"><parent link="base"/>'
        f'<child link="{side}_wheel"/><origin xyz="0 {y} {radius}" '
        f'rpy="-{NEARLY_A_QUARTER} 0 0"/><axis xyz="0 0 1"/></joint>'
    )


def _caster(number, x, y, ball):
    shape = '<sphere radius="0.01"/>' if ball else '<box size="0.03 0.02 0.02"/>'
    return (
        f'<link name="caster{number}"><inertial><mass value="0.005"/>'
        '<inertia ixx="0.001" iyy="0.001" izz="0.001"/></inertial>'
        f"<collision><geometry>{shape}</geometry></collision></link>"
        f'<joint name="holder{number}" type="fixed"><parent link="base"/>'
        f'<child link="caster{number}"/><origin xyz="{x} {y} 0.0105"/></joint>'
    )


def wheel_mesh(path, radius, width):
    """Write a wheel about z as an STL file."""
    angles = np.arange(64) * math.tau / 64
    rim = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    low, high = -0.5 * width, 0.5 * width
    triangles = []
    for (ax, ay), (bx, by) in zip(rim, np.roll(rim, -1, axis=0)):
        triangles += [
            [(ax, ay, low), (bx, by, low), (bx, by, high)],
            [(ax, ay, low), (bx, by, high), (ax, ay, high)],
            [(0, 0, high), (ax, ay, high), (bx, by, high)],
            [(0, 0, low), (bx, by, low), (ax, ay, low)],
        ]
    write_stl(path, triangles)


def write_stl(path, triangles):
    """Write triangles (n, 3, 3) as a binary file."""
    records = np.zeros(len(triangles), [("normal", "<3f4"), ("corners", "<9f4"), ("rest", "<u2")])
    records["corners"] = np.reshape(triangles, (-1, 9))
    path.write_bytes(80 * b" " + struct.pack("<I", len(triangles)) + records.tobytes())


@dataclass(frozen=True)
class Drive:
    """What came of a drive: m and degrees in the robot's frame at its start, and by odometry."""

    x: float
    y: float
    yaw: float
    reckoned_x: float
    reckoned_y: float
    reckoned_yaw: float


def drive(model, command, seconds, heading=0.0, world=FLOOR):
    """Let a model stand, drive as commanded, stop, and stand again."""
    with Simulation.of(world) as simulation:
        start = Pose.from_rpy((0.3, -0.2, 0.0), (0.0, 0.0, math.radians(heading)))
        robot = simulation.add(model, pose=start)
        samples = []
        robot.listen("odom", samples.append)
        simulation.run_for(0.5)
        places = [(robot.pose(), samples[-1].pose)]
        for part, told in ((seconds, command), (1.0, replace(command, vx=0.0, wz=0.0))):
            robot.command("cmd_vel", told)
            for _ in range(round(part / 0.1)):
                simulation.run_for(0.1)
                places.append((robot.pose(), samples[-1].pose))
        true, reckoned = map(_moved, zip(*places))
        return Drive(*true, *reckoned)


def _moved(poses):
    """Return where something is by its start (m, m), with all its turns (degrees)."""
    x, y, _ = (poses[0].inverse() * poses[-1]).position
    turns = [math.remainder(b.yaw - a.yaw, math.tau) for a, b in zip(poses, poses[1:])]
    return x, y, math.degrees(sum(turns))


def straight(model, speed, **more):
    """Drive a metre at a speed (m/s)."""
    return drive(model, PlanarCommand(vx=speed), 1.0 / abs(speed), **more)


def turn(model, speed, degrees=360.0, **more):
    """Turn on the spot by an angle at a speed (rad/s)."""
    return drive(model, PlanarCommand(wz=speed), math.radians(degrees) / abs(speed), **more)
