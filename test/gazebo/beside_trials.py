"""Short scenarios with boxes, balls and joints, each a function that plays it on a stage."""

import math
from functools import partial
from pathlib import Path

import yaml
from beside_scenarios import MODELS, PACKAGE, Played, Push

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


def inertial(moment, height=0.0):
    """Return the SDF of 1 kg at a height (m) with the same moment (kg m²) about each axis."""
    moments = "".join(f"<i{axis * 2}>{moment}</i{axis * 2}>" for axis in "xyz")
    return (
        f"<inertial><pose>0 0 {height} 0 0 0</pose><mass>1</mass><inertia>{moments}"
        "<ixy>0</ixy><ixz>0</ixz><iyz>0</iyz></inertia></inertial>"
    )


def body(shape, mu=1.0, restitution=None, static=False):
    """Return the SDF of a shape of 1 kg, about its middle."""
    geometry, moment = _SHAPES[shape]
    bounce = "" if restitution is None else (
        f"<bounce><restitution_coefficient>{restitution}</restitution_coefficient>"
        "<threshold>0</threshold></bounce>"
    )
    return (
        f'<sdf version="1.6"><model name="{shape}"><static>{int(static)}</static>'
        f'<link name="link">{inertial(moment)}<collision name="collision">'
        f"<geometry>{geometry}</geometry><surface>{bounce}<friction><ode><mu>{mu}</mu>"
        f"<mu2>{mu}</mu2></ode></friction></surface></collision></link></model></sdf>"
    )


def stand(stage, mu=1.0, yaw=0.0, shape="box", height=0.5 * BOX):
    """Have a shape stand at the origin for 0.5 s; return its name and its pose."""
    pose = Pose.from_rpy((0.0, 0.0, height), (0.0, 0.0, yaw))
    name = stage.spawn(body(shape, mu), pose)
    stage.run(0.5)
    return name, stage.state(name).pose


def way(begin, end):
    """Return x, y and z (m) from one pose to another."""
    return [b - a for a, b in zip(begin.position, end.position)]


def slide(stage, degrees):
    """A box with mu 0.5 that has 1.5 m/s in a direction."""
    name, begin = stand(stage, 0.5)
    angle = math.radians(degrees)
    stage.put(name, FrameState(begin, (1.5 * math.cos(angle), 1.5 * math.sin(angle), 0.0)))
    played = Played()
    for step in range(1, 11):
        stage.run(0.05)
        pose = stage.state(name).pose
        x, y, _ = way(begin, pose)
        played.path.append((0.05 * step, x, y, pose.yaw))
        if step in (2, 10):
            played.figures[f"x at {0.05 * step:.1f} s m"] = x
            played.figures[f"y at {0.05 * step:.1f} s m"] = y
    return played


def wrench(stage, mu=0.0, yaw=0.0, frame="", **push):
    """A push for 1 s on the box; what came of it after 1.5 s. Its frame is "link" or "model"."""
    name, begin = stand(stage, mu, yaw)
    link = f"{name}::link"
    frames = {"link": link, "model": name}
    stage.push(link, Push(frame=frames.get(frame, ""), **push))
    stage.run(1.5)
    end = stage.state(name)
    x, y, _ = way(begin, end.pose)
    return Played(
        {
            "x m": x,
            "y m": y,
            "vx m/s": end.linear[0],
            "vy m/s": end.linear[1],
            "wz rad/s": end.angular[2],
            "yaw rad": math.remainder(end.pose.yaw - begin.yaw, math.tau),
        }
    )


def slope(stage, degrees, mu):
    """A box on a ramp, for 1 s: how far down, and how fast."""
    tilt = Pose.from_rpy((0.0, 0.0, 20.0), (0.0, math.radians(degrees), 0.0))
    stage.spawn(body("ramp", static=True), tilt * Pose((0.0, 0.0, -0.1)))
    name = stage.spawn(body("box", mu), tilt * Pose((0.0, 0.0, 0.5 * BOX)))
    begin = stage.state(name).pose
    stage.run(1.0)
    end = stage.state(name)
    distance = math.hypot(*way(begin, end.pose))
    return Played({"way m": distance, "speed m/s": math.hypot(*end.linear)})


def drop(stage, ball, floor):
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


def roll(stage):
    """A ball with mu 1 that is thrown at 1 m/s along the floor."""
    name, begin = stand(stage, shape="ball", height=BALL)
    stage.put(name, FrameState(begin, (1.0, 0.0, 0.0)))
    stage.run(2.0)
    end = stage.state(name)
    x, _, _ = way(begin, end.pose)
    return Played({"x m": x, "vx m/s": end.linear[0], "wy rad/s": end.angular[1]})


def fall(stage):
    """A box that falls freely for 0.5 s."""
    name, pose = stand(stage, height=10.0)
    return Played({"z m": pose.position[2], "vz m/s": stage.state(name).linear[2]})


def set_state(stage):
    """A box that is placed in motion: where it is then, a step later, and 100 steps later."""
    name = stage.spawn(body("box"), Pose((0.0, 0.0, 1.0)))
    pose = Pose.from_rpy((1.0, 2.0, 3.0), (0.1, 0.2, 0.3))
    stage.put(name, FrameState(pose, (1.0, 0.0, 0.0), (0.0, 0.0, 2.0)))
    figures = {}
    for when, seconds in (("now", 0.0), ("after 1 ms", 0.001), ("after 100 ms", 0.099)):
        stage.run(seconds)
        state = stage.state(name)
        values = (*state.pose.position, *state.pose.rpy(), state.linear[2], state.angular[2])
        figures.update({f"{when} {what}": value for what, value in zip(SET, values)})
    return Played(figures)


SET = ("x m", "y m", "z m", "roll rad", "pitch rad", "yaw rad", "vz m/s", "wz rad/s")


def push_block(stage):
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


def stack(stage):
    """Three boxes on each other, 1 s and 6 s later."""
    heights = [0.5 * BOX + number * BOX for number in range(3)]
    names = [stage.spawn(body("box"), Pose((0.0, 0.0, z))) for z in heights]
    figures = {}
    for when, seconds in (("at 1 s", 1.0), ("at 6 s", 5.0)):
        stage.run(seconds)
        places = [stage.state(name).pose.position for name in names]
        figures[f"{when} farthest aside m"] = max(math.hypot(x, y) for x, y, _ in places)
        figures[f"{when} top z m"] = places[-1][2]
    return Played(figures)


def _arm(stage, height, axis, below, damping, friction):
    """Spawn a stand that is fixed to the world at a height (m), and an arm on a joint.

    The arm has 1 kg, so far below the joint (m), and 0.01 kg m² about each axis through it.
    """
    text = (
        f'<sdf version="1.6"><model name="stand"><link name="base">{inertial(0.01)}</link>'
        '<joint name="fixed" type="fixed"><parent>world</parent><child>base</child></joint>'
        f'<link name="arm">{inertial(0.01, -below)}</link>'
        '<joint name="joint" type="revolute"><parent>base</parent><child>arm</child><axis>'
        f"<xyz>{axis}</xyz><limit><lower>-1e16</lower><upper>1e16</upper></limit><dynamics>"
        f"<damping>{damping}</damping><friction>{friction}</friction></dynamics></axis></joint>"
        "</model></sdf>"
    )
    return stage.spawn(text, Pose((0.0, 0.0, height)))


def turn(stage, damping=0.0, friction=0.0):
    """0.01 N m for 1 s on an arm of 0.01 kg m²."""
    name = _arm(stage, 1.0, "0 0 1", 0.0, damping, friction)
    stage.exert(name, "joint", 0.01, 1.0)
    return _swing(name, 2, stage)


def pendulum(stage, damping):
    """A pendulum of 1 kg, 0.01 kg m² and 0.5 m that is let go at 0.5 rad."""
    name = _arm(stage, 2.0, "0 1 0", 0.5, damping, 0.0)
    stage.turn_joint(name, "joint", 0.5)
    return _swing(name, 6, stage)


def _swing(name, seconds, stage):
    figures = {}
    for second in range(1, seconds + 1):
        stage.run(1.0)
        position, rate = stage.joint(name, "joint")
        figures[f"at {second} s rad"] = position
        figures[f"at {second} s rad/s"] = rate
    return Played(figures)


_FUNCTIONS = (
    *(slide, wrench, slope, drop, roll, turn, pendulum),
    *(push_block, stack, set_state, fall),
)


def _played(stage, play, beside_burger=False, **more):
    """Play a trial of the table, perhaps while a robot whose wheels have an fdir1 stands aside."""
    if beside_burger:
        text = read_urdf_text(PACKAGE / MODELS / "burger.urdf.xacro")
        stage.spawn(text, Pose((5.0, 5.0, 0.0)))
    return {function.__name__: function for function in _FUNCTIONS}[play](stage, **more)


TRIALS = {
    name: partial(_played, **entry)
    for name, entry in yaml.safe_load(Path(__file__).with_name("trials.yaml").read_text()).items()
}
"""What plays each, on a `stage`, and returns a Played; by name."""

THROUGH_ROS = ("push_in_link", "push_in_model")
"""Trials of what only a service does."""
