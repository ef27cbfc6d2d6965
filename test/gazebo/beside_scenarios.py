"""The scenarios of the comparison, as data: what is spawned, and what then happens to it.

Two kinds: a `Drive` is a robot that is sent velocity commands, leg by leg; a `Trial` is a function
that plays something short with boxes, balls and joints (beside_trials.py). Both are played on a
stage: a simulation in this process (beside_direct.py) or a simulator on a ROS master
(beside_ros.py), with a level floor. Time passes only in `run`, in whole steps of 1 ms. It has

- spawn(text, pose): adds a model of URDF or SDF text, and returns the name that it has got;
- clear(): removes all that was spawned;
- state(name): returns the FrameState of a model, pose and velocity in the world;
- put(name, state): places a model in motion;
- command(name, vx, vy, wz): sends a robot a velocity command, in m/s and rad/s;
- push(body, push): lets a force or torque, a `Push`, act on "model::link";
- exert(name, joint, effort, seconds): lets a torque (N m) act on a joint;
- joint(name, joint): returns position and rate of a joint, in rad and rad/s;
- turn_joint(name, joint, position): places a joint, in rad;
- run(seconds): lets time pass.
"""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import yaml

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.simulation.world.urdf import read_urdf_text

PACKAGE = Path(__file__).resolve().parents[2]
MODELS = "test/gazebo/models"
SETTLE = 1.0
"""Simulated seconds that a robot stands before its first leg."""

SAMPLE = 0.1
"""Simulated seconds between two points of a path."""


@dataclass
class Played:
    """What came of a scenario: figures by name, and the path as rows t, x, y, yaw (s, m, rad)."""

    figures: dict = field(default_factory=dict)
    path: list = field(default_factory=list)


class Push(NamedTuple):
    """A force (N) at a point (m) and a torque (N m), for some seconds; axes of a frame."""

    force: Vector = (0.0, 0.0, 0.0)
    torque: Vector = (0.0, 0.0, 0.0)
    point: Vector = (0.0, 0.0, 0.0)
    frame: str = ""
    seconds: float = 1.0


# ---- Drives ----


class Leg(NamedTuple):
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


class Drive(NamedTuple):
    """A robot and its legs. `changes` are made in its text; `moves` says in which way it moves.

    `height` is that of its frame at rest (m), `heading` in degrees; `turned` lists by how much that
    heading was turned when Gazebo's figures were recorded. So many of its motions are judged by
    what all robots of its kind are allowed.
    """

    name: str
    robot: str
    legs: tuple
    moves: str
    heading: float = 0.0
    height: float = 0.0
    changes: tuple = ()
    judged: int = 99
    turned: tuple = (0.0,)

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


_TABLE = yaml.safe_load(Path(__file__).with_name("drives.yaml").read_text())
_LEGS = {name: Leg(*numbers) for name, numbers in _TABLE["legs"].items()}
DRIVES = tuple(
    Drive(**{**entry, "legs": tuple(_LEGS[name] for name in entry["legs"].split())})
    for entry in _TABLE["drives"]
)
