"""The scenarios of the comparison, as data: what is spawned, and what then happens to it.

Two kinds: a `Drive` is a robot that is sent velocity commands, leg by leg; a `Trial` is a function
that plays something short with boxes, balls and joints (beside_trials.py). Both are played on a
`Stage`, which is a simulation in this process or a simulator on a ROS master.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Dict, List, Tuple, Union

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.simulation.world.urdf import read_urdf_text

PACKAGE = Path(__file__).resolve().parents[2]
MODELS = "test/gazebo/models"
SETTLE = 1.0
"""Simulated seconds that a robot stands before its first leg."""

SAMPLE = 0.1
"""Simulated seconds between two points of a path."""


Figure = Union[float, str, List[float]]


@dataclass
class Played:
    """What came of a scenario: figures by name, and the path as rows t, x, y, yaw (s, m, rad)."""

    figures: Dict[str, Figure] = field(default_factory=dict)
    path: List[Tuple[float, float, float, float]] = field(default_factory=list)


class Stage:
    """A simulator with a level floor. Time passes only in `run`, in whole steps of 1 ms."""

    def spawn(self, text, pose):
        """Add a model of URDF or SDF text, and return the name that it has got."""

    def clear(self):
        """Remove all that was spawned."""

    def state(self, name):
        """Return the FrameState of a model: pose and velocity in the world."""

    def put(self, name, state):
        """Place a model in motion."""

    def command(self, name, vx, vy, wz):
        """Send a robot a velocity command, in m/s and rad/s."""

    def push(self, body, push):
        """Let a force or torque, a `Push`, act on "model::link"."""

    def exert(self, name, joint, effort, seconds):
        """Let a torque (N m) act on a joint."""

    def joint(self, name, joint):
        """Return position and rate of a joint, in rad and rad/s."""

    def turn_joint(self, name, joint, position):
        """Place a joint, in rad."""

    def run(self, seconds):
        """Let time pass."""


@dataclass(frozen=True)
class Push:
    """A force (N) at a point (m) and a torque (N m), for some seconds; axes of a frame."""

    force: Vector = (0.0, 0.0, 0.0)
    torque: Vector = (0.0, 0.0, 0.0)
    point: Vector = (0.0, 0.0, 0.0)
    frame: str = ""
    seconds: float = 1.0


# ---- Drives ----


@dataclass(frozen=True)
class Leg:
    """A velocity command (m/s ahead and to the left, rad/s) that holds for some seconds."""

    vx: float
    vy: float
    wz: float
    seconds: float

    @property
    def stands(self):
        return not (self.vx or self.vy or self.wz)


STOP = Leg(0.0, 0.0, 0.0, 1.0)
# In which way a robot moves.
SLIDES, ROLLS, SLIPS = "slides", "rolls", "slips"


@dataclass(frozen=True)
class Drive:
    """A robot and its legs. `changes` are made in its text; `moves` says in which way it moves.

    `height` is that of its frame at rest (m), `heading` in degrees; `turned` lists by how much that
    heading was turned when Gazebo's figures were recorded. So many of its motions are judged by
    what all robots of its kind are allowed.
    """

    name: str
    robot: str
    legs: Tuple[Leg, ...]
    moves: str
    heading: float = 0.0
    height: float = 0.0
    changes: Tuple[Tuple[str, str], ...] = ()
    judged: int = 99
    turned: Tuple[float, ...] = (0.0,)

    def name_at(self, heading):
        """Return the name of its figures when its heading is turned by some degrees."""
        return self.name + (f"@{heading:g}" if heading else "")

    def text(self):
        """Return the robot's URDF."""
        text = read_urdf_text(PACKAGE / self.robot)
        for old, new in self.changes:
            if old not in text:
                raise ValueError(f"{self.name}: no '{old}' in {self.robot}")
            text = text.replace(old, new)
        return text


def motions(legs):
    """Return the ranges of legs that are one motion: a leg, with the stop after it."""
    begins = [number for number, leg in enumerate(legs) if not (number and leg.stands)]
    return list(zip(begins, [*begins[1:], len(legs)]))


def name_of(first, end):
    """Return the name of a motion of some legs."""
    return f"legs {first}-{end - 1}" if end - first > 1 else f"leg {first}"


def play_drive(drive, stage, heading):
    """Play a drive from the origin, with the robot's heading turned by some degrees."""
    yaw = math.radians(drive.heading + heading)
    place = Pose.from_rpy((0.0, 0.0, drive.height), (0.0, 0.0, yaw))
    name = stage.spawn(drive.text(), place)
    stage.run(SETTLE)
    played = Played()
    # Before the first leg, and after each: the pose, and by how much it has turned in all, in rad.
    poses, turns = [stage.state(name).pose], [0.0]
    for leg in drive.legs:
        pose, turned = poses[-1], turns[-1]
        stage.command(name, leg.vx, leg.vy, leg.wz)
        for _ in range(round(leg.seconds / SAMPLE)):
            stage.run(SAMPLE)
            before, pose = pose, stage.state(name).pose
            turned += math.remainder(pose.yaw - before.yaw, math.tau)
            seconds = round(SAMPLE * (len(played.path) + 1), 3)
            played.path.append((seconds, *pose.position[:2], pose.yaw))
        poses.append(pose)
        turns.append(turned)
    for first, end in motions(drive.legs):
        legs = [(n, n + 1) for n in range(first, end)] if end - first > 1 else []
        for part in (*legs, (first, end)):
            begin, last = (poses[n] for n in part)
            # By the heading that it had before.
            flat = Pose.from_rpy(begin.position, (0.0, 0.0, begin.yaw))
            ahead, left, _ = (flat.inverse() * last).position
            turned = math.degrees(turns[part[1]] - turns[part[0]])
            for word, value in (("ahead m", ahead), ("left m", left), ("turned deg", turned)):
                played.figures[f"{name_of(*part)} {word}"] = value
    stage.clear()
    return played


_AHEAD = Leg(0.2, 0.0, 0.0, 5.0)
_TURN = Leg(0.0, 0.0, 0.5, 5.0)
_USUAL = (_AHEAD, STOP, _TURN, STOP)
_TWO = (0.0, 45.0)
_ALL_ROUND = (0.0, 30.0, 45.0, 90.0)
_SIDE = Leg(0.2, 0.0, 0.0, 10.0)
_CORNER = Leg(0.0, 0.0, -0.5236, 3.4)
_BACK = Leg(0.0, 0.0, 0.5236, 3.4)
_BLOCK = (_SIDE, _CORNER, STOP, Leg(0.2, 0.0, 0.3, 5.0), Leg(0.0, 0.2, 0.0, 2.0), STOP)
_PLAIN = f"{MODELS}/plain_block.urdf"
_IZZ = 'izz="7.5e-3"'
_TUTORIALS = "test/tutorials/urdf"
_TAGS = "".join(
    f'<gazebo reference="{end}_{side}"><kp>1e6</kp><kd>1</kd></gazebo>'
    for end in ("front", "back")
    for side in ("left", "right")
)
_SOFT = (("</robot>", f"{_TAGS}</robot>"),)
_SQUARE = (*_SOFT, ('xyz="0.12 ', 'xyz="0.2 '), ('xyz="-0.12 ', 'xyz="-0.2 '))


def _four_wheels(name, **more):
    robot = f"{_TUTORIALS}/four_wheels.urdf.xacro"
    return Drive(name, robot, _USUAL, SLIPS, height=0.1, turned=_ALL_ROUND, **more)


def _casters(name, **more):
    robot = f"{MODELS}/casters.urdf.xacro"
    return Drive(name, robot, (_AHEAD,), ROLLS, height=0.1, judged=0, turned=_TWO, **more)


def _block(name, *legs, **more):
    return Drive(name, _PLAIN, legs, SLIDES, **more)


DRIVES = (
    # Its turn is the report's, by a tag that Gazebo ignores.
    Drive("block", "urdf/block_robot.urdf", _BLOCK, SLIDES, judged=1),
    # Its arc by planar_move rocks in Gazebo, in a cycle of two steps: chance decides where it ends.
    _block("cpmr_block", *_BLOCK, judged=2),
    _block("block45", _SIDE, _CORNER, _BACK, heading=45.0),
    _block("block45_fast", Leg(0.0, 0.0, 1.5, 3.4), heading=45.0),
    _block("izz0663", *((_SIDE, _CORNER) * 4), changes=((_IZZ, 'izz="0.0663"'),)),
    _block("izz075", *((_SIDE, _CORNER) * 2), changes=((_IZZ, 'izz="0.075"'),)),
    Drive("sensor_robot", "urdf/sensor_robot.urdf", _USUAL, SLIDES),
    Drive("camera_robot", "urdf/camera_robot.urdf", _USUAL, ROLLS, turned=_TWO),
    Drive("burger", f"{MODELS}/burger.urdf.xacro", _USUAL, ROLLS, turned=_TWO),
    Drive("rover", f"{_TUTORIALS}/rover.urdf.xacro", _USUAL, ROLLS, turned=_TWO),
    _four_wheels("four_wheels"),
    _four_wheels("four_wheels_soft", changes=_SOFT),
    # Friction along and across balance, so that how far it turns proves nothing.
    _four_wheels("four_wheels_square", changes=_SQUARE, judged=1),
    Drive(
        "husky", f"{MODELS}/husky.urdf.xacro", _USUAL, SLIPS, height=0.13228, turned=_ALL_ROUND
    ),
    _casters("two_casters"),
    _casters("rear_caster", changes=(('xyz="0.15 0 -0.05"', 'xyz="0.15 0 0"'),)),
)
