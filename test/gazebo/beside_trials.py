"""Short scenarios with boxes, balls and joints, each a function that plays it on a stage."""

from __future__ import annotations

import math
from functools import partial
from typing import Callable, Dict

from beside_scenarios import PACKAGE, Played, Push, Stage

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.world.description import FrameState
from bullet_lab.simulation.world.urdf import read_urdf_text

BOX, BALL = 0.2, 0.1
"""Edge of the box and radius of the ball, in m; both have 1 kg."""

_SHAPES = {
    "box": (f"<box><size>{BOX} {BOX} {BOX}</size></box>", BOX**2 / 6.0),
    "ball": (f"<sphere><radius>{BALL}</radius></sphere>", 0.4 * BALL**2),
    "crate": ("<box><size>0.3 0.3 0.3</size></box>", 0.3**2 / 6.0),
    "ramp": ("<box><size>20 20 0.2</size></box>", 1.0),
}


def body(
    shape: str, mu: float = 1.0, restitution: float | None = None, static: bool = False
) -> str:
    """Return the SDF of a shape of 1 kg, about its middle."""
    geometry, moment = _SHAPES[shape]
    bounce = "" if restitution is None else (
        f"<bounce><restitution_coefficient>{restitution}</restitution_coefficient>"
        "<threshold>0</threshold></bounce>"
    )
    moments = "".join(f"<i{axis * 2}>{moment}</i{axis * 2}>" for axis in "xyz")
    return (
        f'<sdf version="1.6"><model name="{shape}"><static>{int(static)}</static>'
        f'<link name="link"><inertial><mass>1</mass><inertia>{moments}'
        f'<ixy>0</ixy><ixz>0</ixz><iyz>0</iyz></inertia></inertial><collision name="collision">'
        f"<geometry>{geometry}</geometry><surface>{bounce}<friction><ode><mu>{mu}</mu>"
        f"<mu2>{mu}</mu2></ode></friction></surface></collision></link></model></sdf>"
    )


def slide(degrees: float, stage: Stage) -> Played:
    """A box with mu 0.5 that has 1.5 m/s in a direction."""
    name = stage.spawn(body("box", 0.5), Pose((0.0, 0.0, 0.5 * BOX)))
    angle = math.radians(degrees)
    stage.run(0.5)
    begin = stage.state(name)
    speed = (1.5 * math.cos(angle), 1.5 * math.sin(angle), 0.0)
    stage.put(name, FrameState(begin.pose, speed))
    played = Played()
    for step in range(1, 11):
        stage.run(0.05)
        state = stage.state(name)
        (x, y, _), (x0, y0, _) = state.pose.position, begin.pose.position
        played.path.append((0.05 * step, x - x0, y - y0, state.pose.yaw))
        if step in (2, 10):
            played.figures[f"x at {0.05 * step:.1f} s m"] = x - x0
            played.figures[f"y at {0.05 * step:.1f} s m"] = y - y0
    return played


def beside_burger(trial: Callable[[Stage], Played], stage: Stage) -> Played:
    """A trial while a robot whose wheels have an fdir1 stands aside."""
    text = read_urdf_text(PACKAGE / "test/gazebo/models/burger.urdf.xacro")
    stage.spawn(text, Pose((5.0, 5.0, 0.0)))
    return trial(stage=stage)


def wrench(mu: float, push: Push, stage: Stage, yaw: float = 0.0, link: bool = False) -> Played:
    """A push for 1 s on the box; what came of it after 1.5 s. `link`: in the frame of its link."""
    place = Pose.from_rpy((0.0, 0.0, 0.5 * BOX), (0.0, 0.0, yaw))
    name = stage.spawn(body("box", mu), place)
    stage.run(0.5)
    begin = stage.state(name)
    if push.frame:
        push = Push(push.force, push.torque, push.point, f"{name}::link" if link else name)
    stage.push(f"{name}::link", push)
    stage.run(1.5)
    end = stage.state(name)
    way = [a - b for a, b in zip(end.pose.position, begin.pose.position)]
    turned = math.remainder(end.pose.yaw - begin.pose.yaw, math.tau)
    return Played(
        {
            "x m": way[0],
            "y m": way[1],
            "vx m/s": end.linear[0],
            "vy m/s": end.linear[1],
            "wz rad/s": end.angular[2],
            "yaw rad": turned,
        }
    )


def slope(degrees: float, mu: float, stage: Stage) -> Played:
    """A box on a ramp, for 1 s: how far down, and how fast."""
    tilt = Pose.from_rpy((0.0, 0.0, 20.0), (0.0, math.radians(degrees), 0.0))
    stage.spawn(body("ramp", static=True), tilt * Pose((0.0, 0.0, -0.1)))
    name = stage.spawn(body("box", mu), tilt * Pose((0.0, 0.0, 0.5 * BOX)))
    begin = stage.state(name).pose.position
    stage.run(1.0)
    end = stage.state(name)
    way = math.dist(end.pose.position, begin)
    return Played({"way m": way, "speed m/s": math.hypot(*end.linear)})


def drop(ball: float | None, floor: float | None, stage: Stage) -> Played:
    """A ball that falls 1 m on a slab: how high it rises again, and where it is after 3 s."""
    top = 0.2
    slab = body("ramp", restitution=floor, static=True)
    stage.spawn(slab, Pose((0.0, 0.0, top - 0.1)))
    name = stage.spawn(body("ball", restitution=ball), Pose((0.0, 0.0, top + 1.0 + BALL)))
    stage.run(0.46)
    heights = []
    for _ in range(50):
        stage.run(0.05)
        heights.append(stage.state(name).pose.position[2] - top - BALL)
    return Played({"rebound m": max(heights), "end m": heights[-1]})


def roll(stage: Stage) -> Played:
    """A ball with mu 1 that is thrown at 1 m/s along the floor."""
    name = stage.spawn(body("ball"), Pose((0.0, 0.0, BALL)))
    stage.run(0.5)
    begin = stage.state(name)
    stage.put(name, FrameState(begin.pose, (1.0, 0.0, 0.0)))
    stage.run(2.0)
    end = stage.state(name)
    return Played(
        {
            "x m": end.pose.position[0] - begin.pose.position[0],
            "vx m/s": end.linear[0],
            "wy rad/s": end.angular[1],
        }
    )


def fall(stage: Stage) -> Played:
    """A box that falls freely for 0.5 s."""
    name = stage.spawn(body("box"), Pose((0.0, 0.0, 10.0)))
    stage.run(0.5)
    state = stage.state(name)
    return Played({"z m": state.pose.position[2], "vz m/s": state.linear[2]})


def set_state(stage: Stage) -> Played:
    """A box that is placed in motion: where it is then, a step later, and 100 steps later."""
    name = stage.spawn(body("box"), Pose((0.0, 0.0, 1.0)))
    pose = Pose.from_rpy((1.0, 2.0, 3.0), (0.1, 0.2, 0.3))
    stage.put(name, FrameState(pose, (1.0, 0.0, 0.0), (0.0, 0.0, 2.0)))
    played = Played()
    for when, seconds in (("now", 0.0), ("after 1 ms", 0.001), ("after 100 ms", 0.099)):
        stage.run(seconds)
        state = stage.state(name)
        for key, value in zip("xyz", state.pose.position):
            played.figures[f"{when} {key} m"] = value
        for key, value in zip(("roll", "pitch", "yaw"), state.pose.rpy()):
            played.figures[f"{when} {key} rad"] = value
        played.figures[f"{when} vz m/s"] = state.linear[2]
        played.figures[f"{when} wz rad/s"] = state.angular[2]
    return played


def push_block(stage: Stage) -> Played:
    """The block robot drives at 0.2 m/s into a crate of 1 kg with mu 0.5, for 5 s."""
    text = read_urdf_text(PACKAGE / "urdf/block_robot.urdf")
    robot = stage.spawn(text, Pose())
    crate = stage.spawn(body("crate", 0.5), Pose((0.5, 0.0, 0.15)))
    stage.run(1.0)
    stage.command(robot, 0.2, 0.0, 0.0)
    played = Played()
    for step in range(1, 51):
        stage.run(0.1)
        place = stage.state(robot).pose
        played.path.append((0.1 * step, *place.position[:2], place.yaw))
    end = stage.state(crate).pose
    played.figures = {
        "robot x m": place.position[0],
        "robot turned deg": math.degrees(place.yaw),
        "crate x m": end.position[0],
        "crate y m": end.position[1],
        "crate turned deg": math.degrees(end.yaw),
    }
    return played


def stack(stage: Stage) -> Played:
    """Three boxes on each other, 1 s and 6 s later."""
    heights = [0.5 * BOX + number * BOX for number in range(3)]
    names = [stage.spawn(body("box"), Pose((0.0, 0.0, z))) for z in heights]
    played = Played()
    for when, seconds in (("at 1 s", 1.0), ("at 6 s", 5.0)):
        stage.run(seconds)
        places = [stage.state(name).pose.position for name in names]
        aside = max(math.hypot(x, y) for x, y, _ in places)
        played.figures[f"{when} farthest aside m"] = aside
        played.figures[f"{when} top z m"] = places[-1][2]
    return played


def _arm(axis: str, below: float, damping: float, friction: float) -> str:
    """Return the SDF of a stand that is fixed to the world, and of an arm on a joint.

    The arm has 1 kg, so far below the joint (m), and 0.01 kg m² about each axis through it.
    """
    moments = "".join(f"<i{key * 2}>0.01</i{key * 2}>" for key in "xyz")
    inertia = f"<inertia>{moments}<ixy>0</ixy><ixz>0</ixz><iyz>0</iyz></inertia>"
    return (
        '<sdf version="1.6"><model name="stand"><link name="base"><inertial><mass>1</mass>'
        f'{inertia}</inertial></link><joint name="fixed" type="fixed"><parent>world</parent>'
        '<child>base</child></joint><link name="arm"><inertial>'
        f"<pose>0 0 {-below} 0 0 0</pose><mass>1</mass>{inertia}</inertial></link>"
        '<joint name="joint" type="revolute"><parent>base</parent><child>arm</child><axis>'
        f"<xyz>{axis}</xyz><limit><lower>-1e16</lower><upper>1e16</upper></limit><dynamics>"
        f"<damping>{damping}</damping><friction>{friction}</friction></dynamics></axis></joint>"
        "</model></sdf>"
    )


def turn(damping: float, friction: float, stage: Stage) -> Played:
    """0.01 N m for 1 s on an arm of 0.01 kg m²."""
    text = _arm("0 0 1", 0.0, damping, friction)
    name = stage.spawn(text, Pose((0.0, 0.0, 1.0)))
    stage.exert(name, "joint", 0.01, 1.0)
    return _swing(name, 2, 1.0, stage)


def pendulum(damping: float, stage: Stage) -> Played:
    """A pendulum of 1 kg, 0.01 kg m² and 0.5 m that is let go at 0.5 rad."""
    text = _arm("0 1 0", 0.5, damping, 0.0)
    name = stage.spawn(text, Pose((0.0, 0.0, 2.0)))
    stage.turn_joint(name, "joint", 0.5)
    return _swing(name, 6, 1.0, stage)


def _swing(name: str, count: int, seconds: float, stage: Stage) -> Played:
    played = Played()
    for number in range(1, count + 1):
        stage.run(seconds)
        position, rate = stage.joint(name, "joint")
        played.figures[f"at {number * seconds:g} s rad"] = position
        played.figures[f"at {number * seconds:g} s rad/s"] = rate
    return played


_X = (1.0, 0.0, 0.0)
_SIX = partial(wrench, 0.5, Push((6.0, 0.0, 0.0)))
_BOUNCE = (("none", None), ("0.7", 0.7))

TRIALS: Dict[str, Callable[[Stage], Played]] = {
    **{f"slide_{angle}": partial(slide, angle) for angle in (0, 30, 45)},
    "push_1N_mu0": partial(wrench, 0.0, Push(_X)),
    "push_1N_mu0.5": partial(wrench, 0.5, Push(_X)),
    "push_6N_mu0.5": _SIX,
    "push_1N_aside": partial(wrench, 0.0, Push(_X, point=(0.0, 0.1, 0.0))),
    "torque_z": partial(wrench, 0.0, Push(torque=(0.0, 0.0, 0.01))),
    "push_in_link": partial(wrench, 0.0, Push(_X, frame="link"), yaw=0.5 * math.pi, link=True),
    "push_in_model": partial(wrench, 0.0, Push(_X, frame="model"), yaw=0.5 * math.pi),
    "slope20_mu0.5": partial(slope, 20.0, 0.5),
    "slope35_mu0.5": partial(slope, 35.0, 0.5),
    "slope20_mu0": partial(slope, 20.0, 0.0),
    **{
        f"drop_ball_{one}_floor_{other}": partial(drop, ball, floor)
        for one, ball in _BOUNCE
        for other, floor in _BOUNCE
    },
    "roll": roll,
    "turn": partial(turn, 0.0, 0.0),
    "turn_damping": partial(turn, 0.01, 0.0),
    "turn_friction": partial(turn, 0.0, 0.005),
    "pendulum": partial(pendulum, 0.0),
    "pendulum_damping": partial(pendulum, 0.05),
    "push_block": push_block,
    "stack": stack,
    "set_model_state": set_state,
    "fall": fall,
    # Last of all, since the world may remember.
    "push_6N_beside_burger": partial(beside_burger, _SIX),
    "slide_30_beside_burger": partial(beside_burger, partial(slide, 30)),
}
THROUGH_ROS = ("push_in_link", "push_in_model")
"""Trials of what only a service does."""
