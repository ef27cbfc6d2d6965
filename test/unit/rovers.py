"""Robots on rows of wheels that steer by slipping, and what Coulomb's law says of them."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.wheel_drives import Wheel
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import (
    Box,
    Collision,
    Cylinder,
    Inertia,
    Joint,
    Link,
    Model,
    World,
)

G = 9.8
Y = (0.0, 1.0, 0.0)
LYING = Pose.from_rpy((0.0, 0.0, 0.0), (0.5 * math.pi, 0.0, 0.0))
ROUND = Collision(Cylinder(0.1, 0.05), LYING)


@dataclass(frozen=True)
class Rover:
    """Rows of two wheels each at y = ±width/2, from x = length/2 to -length/2; lengths in m.

    `centre` is that of the base's mass (kg); `wheel` what the shapes of the wheels have besides.
    """

    length: float = 0.4
    width: float = 0.5
    rows: int = 2
    radius: float = 0.1
    mass: float = 8.0
    wheel_mass: float = 0.5
    centre: tuple = (0.0, 0.0, 0.1)
    wheel: dict = field(default_factory=dict)
    torque: float = 20.0

    def places(self):
        """Return where the wheels stand, (n, 2), the left one of each row first."""
        rows = np.linspace(0.5 * self.length, -0.5 * self.length, self.rows)
        return np.array([(x, y) for x in rows for y in (0.5 * self.width, -0.5 * self.width)])

    def model(self):
        shape = Collision(Cylinder(self.radius, 0.05), LYING, **self.wheel)
        rim = self.wheel_mass * self.radius**2
        inertia = Inertia(self.wheel_mass, (0.0, 0.0, 0.0), rim * np.diag((0.3, 0.5, 0.3)))
        links = [Link("base", Pose(), Inertia(self.mass, self.centre, np.diag((0.2, 0.2, 0.3))))]
        joints = []
        for n, (x, y) in enumerate(self.places()):
            pose = Pose((x, y, self.radius))
            links.append(Link(f"w{n}", pose, inertia, (), (shape,)))
            joints.append(Joint(f"j{n}", "continuous", "base", f"w{n}", pose, Y))
        return Model("rover", tuple(links), tuple(joints))


def even_inertia(mass, moment):
    """An inertia with the same moment about each axis through the origin."""
    return Inertia(mass, (0.0, 0.0, 0.0), moment * np.eye(3))


def wheels(*places, shape=ROUND, axis=Y, kind="continuous", parent="base", **joint):
    """Links with a shape at places, and their joints to a parent."""
    links = [Link(f"{parent}_w{n}", Pose(p), collisions=(shape,)) for n, p in enumerate(places)]
    joints = [
        Joint(f"{parent}_j{n}", kind, parent, link.name, link.pose, axis, **joint)
        for n, link in enumerate(links)
    ]
    return links, joints


def ramp(slope=0.0, towards=0.0, friction=1.0):
    """A floor that rises by an angle in a direction (rad), and the pose of its upper side.

    Friction is by Coulomb's law.
    """
    turn = Pose.from_rpy((0.0, 0.0, 0.0), (0.0, -slope, 0.0))
    tilt = Pose.from_rpy((0.0, 0.0, 0.0), (0.0, 0.0, towards)) * turn
    ground = Collision(Box((40.0, 40.0, 0.2)), Pose((0.0, 0.0, -0.1)), friction=friction)
    floor = Model("floor", (Link("l", Pose(), None, (), (ground,)),), pose=tilt, static=True)
    return World("w", (floor,), (), (0.0, 0.0, -G), coulomb=True), tilt


class Drive:
    """A rover that stands on a ramp with a heading on it (rad), and its wheels driven at speeds."""

    def __init__(self, rover, heading=0.0, slope=0.0, towards=0.0, models=(), friction=1.0):
        world, self.tilt = ramp(slope, towards, friction)
        world = replace(world, models=(*world.models, *models))
        self.simulation = Simulation(world)
        place = self.tilt * Pose.from_rpy((0.0, 0.0, 0.0), (0.0, 0.0, heading))
        self.robot = self.simulation.add(rover.model(), pose=place)
        self.rover, self.body = rover, self.robot.bodies["base"]
        self.wheels = [Wheel(self.body, name, rover.torque) for name in self.body.joint_names]

    def __enter__(self):
        self.go(0.0, 0.0, 0.2)
        return self

    def __exit__(self, *_):
        self.simulation.close()

    def go(self, left, right, seconds):
        """Drive the rims of both sides at speeds in m/s."""
        for _ in range(round(seconds / 0.01)):
            for n, wheel in enumerate(self.wheels):
                wheel.follow((right if n % 2 else left) / self.rover.radius)
            self.simulation.run_for(0.01)

    def twist(self):
        """Return the velocity of the base on the ramp, by its heading: m/s, m/s, rad/s."""
        linear, angular = self.body.origin_velocity()
        back = self.robot.pose().inverse()
        return np.array((*back.rotate(linear)[:2], back.rotate(angular)[2]))

    def steady_twist(self, left, right):
        """Return it after a while, as a mean over the turns of the engine's leftovers."""
        self.go(left, right, 0.5)
        twists = []
        for _ in range(20):
            self.go(left, right, 0.01)
            twists.append(self.twist())
        return np.mean(twists, axis=0)

    def loads(self):
        """Return what each wheel carries, in N."""
        loads = np.zeros(len(self.wheels))
        for point in self.body.near_points():
            loads[point[3]] += point[9]
        return loads


def coulomb_twist(places, loads, left, right, coefficients=(1.0, 1.0), pull=(0.0, 0.0)):
    """Return the steady twist (vx, vy, wz) of a body on point contacts that rub.

    All friction together does nothing, or what holds against a pull (N) along x and y. It is the
    twist that dissipates least, Σ N·|(μ1·slip along, μ2·slip across)| less what the pull does,
    which is convex. Wheels at places (n, 2) drive along x, those at positive y on the left.
    """
    x, y = np.transpose(places)
    speeds = np.where(y > 0.0, left, right)
    (one, other), size = coefficients, max(abs(left), abs(right))

    def dissipation(twist, rounding):
        vx, vy, wz = twist
        along, across = one * (vx - wz * y - speeds), other * (vy + wz * x)
        slip = np.sqrt(along**2 + across**2 + rounding**2)
        tx, ty = one * loads * along / slip, other * loads * across / slip
        gradient = (tx.sum() - pull[0], ty.sum() - pull[1], (ty * x - tx * y).sum())
        return (loads * slip).sum() - vx * pull[0] - vy * pull[1], np.array(gradient)

    twist = np.array((0.5 * (left + right), 0.0, 0.0))
    for rounding in size * 10.0 ** -np.arange(1.0, 6.0):
        told = {"jac": True, "method": "BFGS", "options": {"gtol": 1e-9}}
        twist = minimize(dissipation, twist, args=(rounding,), **told).x
    return twist
