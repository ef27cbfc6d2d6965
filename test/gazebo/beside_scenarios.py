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
from bullet_lab.simulation.world.description import FrameState
from bullet_lab.simulation.world.urdf import read_urdf_text

PACKAGE = Path(__file__).resolve().parents[2]
MODELS = Path(__file__).resolve().parent / "models"
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

    def spawn(self, text: str, pose: Pose) -> str:
        """Add a model of URDF or SDF text, and return the name that it has got."""
        raise NotImplementedError

    def clear(self) -> None:
        """Remove all that was spawned."""
        raise NotImplementedError

    def state(self, name: str) -> FrameState:
        """Return pose and velocity of a model in the world."""
        raise NotImplementedError

    def put(self, name: str, state: FrameState) -> None:
        """Place a model in motion."""
        raise NotImplementedError

    def command(self, name: str, vx: float, vy: float, wz: float) -> None:
        """Send a robot a velocity command, in m/s and rad/s."""
        raise NotImplementedError

    def push(self, body: str, push: Push) -> None:
        """Let a force or torque act on "model::link"."""
        raise NotImplementedError

    def exert(self, name: str, joint: str, effort: float, seconds: float) -> None:
        """Let a torque (N m) act on a joint."""
        raise NotImplementedError

    def joint(self, name: str, joint: str) -> Tuple[float, float]:
        """Return position and rate of a joint, in rad and rad/s."""
        raise NotImplementedError

    def turn_joint(self, name: str, joint: str, position: float) -> None:
        """Place a joint, in rad."""
        raise NotImplementedError

    def run(self, seconds: float) -> None:
        """Let time pass."""
        raise NotImplementedError


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
    def stands(self) -> bool:
        return not (self.vx or self.vy or self.wz)

    def __str__(self) -> str:
        words = [f"{self.vx:g} m/s"] * bool(self.vx) + [f"{self.vy:g} m/s left"] * bool(self.vy)
        words += [f"{self.wz:g} rad/s"] * bool(self.wz)
        return f"{', '.join(words) or 'stop'} for {self.seconds:g} s"


def stop(seconds: float = 1.0) -> Leg:
    return Leg(0.0, 0.0, 0.0, seconds)


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

    def name_at(self, heading: float) -> str:
        """Return the name of its figures when its heading is turned by some degrees."""
        return self.name + (f"@{heading:g}" if heading else "")

    def text(self) -> str:
        """Return the robot's URDF."""
        text = read_urdf_text(PACKAGE / self.robot)
        for old, new in self.changes:
            if old not in text:
                raise ValueError(f"{self.name}: no '{old}' in {self.robot}")
            text = text.replace(old, new)
        return text


def motions(legs: Tuple[Leg, ...]) -> List[Tuple[int, int]]:
    """Return the ranges of legs that are one motion: a leg, with the stop after it."""
    found: List[Tuple[int, int]] = []
    for number, leg in enumerate(legs):
        if leg.stands and found:
            found[-1] = (found[-1][0], number + 1)
        else:
            found.append((number, number + 1))
    return found


def name_of(first: int, end: int) -> str:
    """Return the name of a motion of some legs."""
    return f"legs {first}-{end - 1}" if end - first > 1 else f"leg {first}"


def play_drive(drive: Drive, stage: Stage, heading: float, start: Vector = (0, 0, 0)) -> Played:
    """Play a drive from a place, with the robot's heading turned by some degrees."""
    yaw = math.radians(drive.heading + heading)
    place = Pose.from_rpy((start[0], start[1], drive.height), (0.0, 0.0, yaw))
    name = stage.spawn(drive.text(), place)
    stage.run(SETTLE)
    track = _Track(stage.state(name))
    played = Played()
    for first, end in motions(drive.legs):
        begin, turned = track.state, track.turned
        for number in range(first, end):
            before, turned_before = track.state, track.turned
            leg = drive.legs[number]
            stage.command(name, leg.vx, leg.vy, leg.wz)
            for _ in range(round(leg.seconds / SAMPLE)):
                stage.run(SAMPLE)
                played.path.append(track.go(stage.state(name)))
            if end - first > 1:
                _note(played, f"leg {number}", before, track.state, track.turned - turned_before)
        _note(played, name_of(first, end), begin, track.state, track.turned - turned)
    stage.clear()
    return played


def _note(played: Played, which: str, begin: FrameState, end: FrameState, turned: float) -> None:
    """Note where something is by the heading that it had before."""
    yaw = Pose.from_rpy(begin.pose.position, (0.0, 0.0, begin.pose.yaw))
    ahead, left, _ = (yaw.inverse() * end.pose).position
    played.figures[f"{which} ahead m"] = ahead
    played.figures[f"{which} left m"] = left
    played.figures[f"{which} turned deg"] = math.degrees(turned)


class _Track:
    """Where a robot is, and how far it has turned in all, in rad."""

    def __init__(self, state: FrameState):
        self.state, self.turned, self.seconds = state, 0.0, 0.0

    def go(self, state: FrameState) -> Tuple[float, float, float, float]:
        """Take the state of the next sample, and return the point of the path."""
        self.turned += math.remainder(state.pose.yaw - self.state.pose.yaw, math.tau)
        self.state = state
        self.seconds += SAMPLE
        x, y, _ = state.pose.position
        return round(self.seconds, 3), x, y, state.pose.yaw


_MODELS = "test/gazebo/models"
_AHEAD = Leg(0.2, 0.0, 0.0, 5.0)
_TURN = Leg(0.0, 0.0, 0.5, 5.0)
_USUAL = (_AHEAD, stop(), _TURN, stop())
_TWO = (0.0, 45.0)
_ALL_ROUND = (0.0, 30.0, 45.0, 90.0)
_SIDE = Leg(0.2, 0.0, 0.0, 10.0)
_CORNER = Leg(0.0, 0.0, -0.5236, 3.4)
_BLOCK = (_SIDE, _CORNER, stop(), Leg(0.2, 0.0, 0.3, 5.0), Leg(0.0, 0.2, 0.0, 2.0), stop())
_PLAIN = f"{_MODELS}/plain_block.urdf"
_IZZ = 'izz="7.5e-3"'
_LIFTED = (('xyz="0.15 0 -0.05"', 'xyz="0.15 0 0"'),)
_TUTORIALS = "test/tutorials/urdf"
_SOFT = (
    "</robot>",
    "".join(
        f'<gazebo reference="{end}_{side}"><kp>1e6</kp><kd>1</kd></gazebo>'
        for end in ("front", "back")
        for side in ("left", "right")
    )
    + "</robot>",
)
_SQUARE = (_SOFT, ('xyz="0.12 ', 'xyz="0.2 '), ('xyz="-0.12 ', 'xyz="-0.2 '))


def _four_wheels(name: str, *changes: Tuple[str, str], judged: int = 99) -> Drive:
    return Drive(
        name,
        f"{_TUTORIALS}/four_wheels.urdf.xacro",
        _USUAL,
        SLIPS,
        height=0.1,
        changes=changes,
        judged=judged,
        turned=_ALL_ROUND,
    )


def _casters(name: str, *changes: Tuple[str, str]) -> Drive:
    robot = f"{_MODELS}/casters.urdf.xacro"
    legs = (_AHEAD,)
    return Drive(name, robot, legs, ROLLS, 0.0, 0.1, changes, judged=0, turned=_TWO)


DRIVES = (
    # Its turn is the report's, by a tag that Gazebo ignores.
    Drive("block", "urdf/block_robot.urdf", _BLOCK, SLIDES, judged=1),
    # Its arc by planar_move rocks in Gazebo, in a cycle of two steps: chance decides where it ends.
    Drive("cpmr_block", _PLAIN, _BLOCK, SLIDES, judged=2),
    Drive(
        "block45",
        _PLAIN,
        (_SIDE, _CORNER, Leg(0.0, 0.0, 0.5236, 3.4)),
        SLIDES,
        heading=45.0,
    ),
    Drive("block45_fast", _PLAIN, (Leg(0.0, 0.0, 1.5, 3.4),), SLIDES, heading=45.0),
    Drive(
        "izz0663", _PLAIN, (_SIDE, _CORNER) * 4, SLIDES, changes=((_IZZ, 'izz="0.0663"'),)
    ),
    Drive("izz075", _PLAIN, (_SIDE, _CORNER) * 2, SLIDES, changes=((_IZZ, 'izz="0.075"'),)),
    Drive("sensor_robot", "urdf/sensor_robot.urdf", _USUAL, SLIDES),
    Drive("camera_robot", "urdf/camera_robot.urdf", _USUAL, ROLLS, turned=_TWO),
    Drive("burger", f"{_MODELS}/burger.urdf.xacro", _USUAL, ROLLS, turned=_TWO),
    Drive("rover", f"{_TUTORIALS}/rover.urdf.xacro", _USUAL, ROLLS, turned=_TWO),
    _four_wheels("four_wheels"),
    _four_wheels("four_wheels_soft", _SOFT),
    # Friction along and across balance, so that how far it turns proves nothing.
    _four_wheels("four_wheels_square", *_SQUARE, judged=1),
    Drive(
        "husky",
        f"{_MODELS}/husky.urdf.xacro",
        _USUAL,
        SLIPS,
        height=0.13228,
        turned=_ALL_ROUND,
    ),
    _casters("two_casters"),
    _casters("rear_caster", *_LIFTED),
)
