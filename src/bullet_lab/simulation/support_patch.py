"""Friction between a robot that stands flat on the floor and that floor.

Gazebo's planar_move sets the robot's velocity before each step and friction takes some of it
away during the step. In the published run (`docs/contact_model.md`) it took 0.0098 m/s of the
translation and 0.060 rad/s of the rotation at each step of 1 ms. Bullet's own contact, four
points at the corners of the block, reproduces the first and takes 0.41 rad/s of the second,
which all but stops the turn. The friction of a planar_move robot is therefore that of one
support patch, worked out here; Bullet keeps what it is good at, the floor that carries the
robot and the walls that stop it.

A patch that slides and spins at once has one friction budget for both. The model is the
ellipsoidal limit surface of Howe and Cutkosky (1996, "Practical force-motion models for sliding
manipulation"): force F and moment M about the vertical satisfy (F/μN)² + (M/μNr)² = 1, with N
the load and r the effective radius of the patch, and oppose the slip. For pure translation
this is Coulomb's μN, for pure rotation the moment μNr.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Tuple

# From the three turns in data/fig1_paths.csv: 90.14°, 90.13° and 90.67° in 34 commands at 10 Hz,
# 0.4636 rad/s where 0.5236 was asked for; r = 0.0600 rad/s · Izz / (m·g·dt).
PUBLISHED_RADIUS = 0.0102


@dataclass(frozen=True)
class SupportPatch:
    """Where a robot touches the floor.

    Attributes:
        friction: Coulomb's coefficient μ.
        radius: effective radius r in metres; a disc of radius R under even pressure has 2R/3.
        mass: of the robot, kg.
        inertia: of the robot about the vertical through its centre of mass, kg m².
    """

    friction: float
    radius: float
    mass: float
    inertia: float

    def slow_down(
        self, vx: float, vy: float, wz: float, load: float, dt: float
    ) -> Tuple[float, float, float]:
        """Return the velocity that friction leaves after a time `dt`.

        Args:
            vx: velocity in m/s along any horizontal axis.
            vy: velocity in m/s across it.
            wz: angular velocity in rad/s about the vertical.
            load: force in N with which the robot stands on the floor.
            dt: duration in s, short enough for the force to be constant.

        Friction brings the robot to rest and never reverses it.
        """
        spin = self.radius * wz
        slip = math.sqrt(vx * vx + vy * vy + spin * spin)
        if slip == 0.0 or load <= 0.0:
            return vx, vy, wz
        impulse = self.friction * load * dt / slip
        keep_linear = max(0.0, 1.0 - impulse / self.mass)
        keep_angular = max(0.0, 1.0 - impulse * self.radius * self.radius / self.inertia)
        return keep_linear * vx, keep_linear * vy, keep_angular * wz
