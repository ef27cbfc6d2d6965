"""Wrenches on links and efforts on joints, for a while."""

import math

import numpy as np
import pytest
from shared import cases, refuses

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.forces import Effort, ForceError, Period, Wrench
from bullet_lab.simulation.models import find_link, model_entity
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import FrameState, Inertia, Joint, Link, Model, World

ZERO = (0.0, 0.0, 0.0)
FOR_EVER = Period(0, math.inf)


@pytest.fixture
def space():
    with Simulation(World("space", gravity=ZERO)) as simulation:
        yield simulation


def inertia(centre=ZERO, mass=2.0, moment=0.5):
    return Inertia(mass, centre, moment * np.eye(3))


def add_ball(space, yaw=0.0, **more):
    """Add a ball of 2 kg at (1, 2, 3)."""
    model = Model("ball", (Link("l", inertia=inertia(**more)),))
    return space.add(model, pose=at([1.0, 2.0, 3.0, yaw]))


@pytest.fixture
def ball(space):
    return add_ball(space)


@pytest.fixture
def hinge(space):
    links = (Link("foot", inertia=inertia(mass=1e6, moment=1e6)), Link("arm", inertia=inertia()))
    joint = Joint("j", "continuous", "foot", "arm", axis=(0.0, 0.0, 1.0))
    return space.add(Model("hinge", links, (joint,)))


def at(place):
    """Return the pose of x, y, z (m) and a yaw (degrees)."""
    return Pose.from_rpy(place[:3], (0.0, 0.0, math.radians(place[3])))


def push(space, x=0.0, name="ball::l", frame=None, period=FOR_EVER, **more):
    """Push with a force of x N along x, or with another force, a torque, at a point."""
    wrench = {"force": (x, 0.0, 0.0), "torque": ZERO, "point": ZERO, **more}
    vectors = {key: tuple(vector) for key, vector in wrench.items()}
    frame = frame and FrameState(at(frame))
    space.forces.add(
        Wrench.at_point(frame, find_link(space.models, name), period=period, **vectors)
    )


def speed(instance):
    """Return the speed along x, which is the only one."""
    along, *across = model_entity(instance).state().linear
    assert across == pytest.approx([0.0, 0.0], abs=1e-6)
    return along


def rate(model):
    return model.state().joints["j"][1]


@cases("""
start, duration, first, end:
  # Start and duration (s) of what is asked for at step 100, and its steps.
  - [0.0, 0.05, 100, 150]
  - [0.2001, 0.05, 201, 251]
  - [0.0, -1.0, 100, .inf]
  - [0.0, 0.0, 100, 100]
  - [0.0, 1.0e-5, 100, 101]
""")
def test_periods_are_whole_steps(start, duration, first, end):
    assert Period.after(100, start, duration) == Period(first, end)


def test_a_force_acts_for_its_time_and_not_longer(space, ball):
    push(space, 4.0, period=Period.after(0, 0.1, 0.25))
    for until, expected in ((0.1, 0.0), (0.2, 0.2), (0.35, 0.5), (1.0, 0.5)):
        space.run_for(until - space.seconds)
        assert speed(ball) == pytest.approx(expected, abs=1e-9)
    assert not space.forces.active


def test_forces_add_up_and_are_cleared_together(space, ball):
    for force in (1.0, 2.0):
        push(space, force)
    space.run_for(1.0)
    space.forces.clear(Wrench, (ball, "l"))
    space.run_for(1.0)
    assert speed(ball) == pytest.approx(1.5, abs=1e-6)


@cases("""
wrench, body, linear, angular:
  # What acts for a step on a ball at (1, 2, 3) with a yaw (degrees) and a centre of mass, and its
  # velocities in mm/s and mrad/s. The frame is a place and a yaw; without one, it is the world's.
  - [{force: [1, 0, 0], point: [0, 0.5, 0]}, {}, [0.5, 0, 0], [0, 0, -1]]
  - [{force: [4, 0, 0]}, {centre: [0, 0.3, 0]}, [2, 0, 0], [0, 0, 0]]
  # The ball's centre is 3 m above the frame's origin.
  - [{frame: [1, 2, 0, 90], force: [2, 0, 0], torque: [0, 0.5, 0], point: [0, 0, 3]}, {},
     [0, 1, 0], [-1, 0, 0]]
  # Gazebo 11.1: 1 N along x of `b` or of `b::link`, which is at a yaw of 90 degrees, is along the
  # world's x. gazebo_ros_api_plugin.cpp:2007 turns the force into the axes of the body; those
  # numbers act in the world's.
  - [{frame: [1, 2, 3, 90], force: [2, 0, 0]}, {yaw: 90}, [1, 0, 0], [0, 0, 0]]
  - [{frame: [1, 2, 3, 90], torque: [0.5, 0, 0]}, {yaw: 90}, [0, 0, 0], [1, 0, 0]]
  - [{force: [2, 0, 0]}, {yaw: 90}, [1, 0, 0], [0, 0, 0]]
  - [{frame: [1, 2, 3, 0], force: [2, 0, 0]}, {yaw: 90}, [0, -1, 0], [0, 0, 0]]
  - [{frame: [1.5, 2, 3, 0], force: [0, 2, 0]}, {yaw: 90}, [1, 0, 0], [0, 0, 2]]
""")
def test_a_wrench_is_given_at_a_point_of_a_frame(space, wrench, body, linear, angular):
    ball = add_ball(space, **body)
    push(space, period=Period(0, 1), **wrench)
    space.run_for(0.001)
    state = model_entity(ball).state()
    found = 1000.0 * np.array([state.linear, state.angular])
    np.testing.assert_allclose(found, [linear, angular], rtol=0.0, atol=1e-7)


def test_a_force_keeps_its_direction_while_the_body_turns(space, ball):
    ball.move(ball.pose(), ZERO, (0.0, 0.0, 5.0))
    push(space, 2.0, frame=(1.0, 2.0, 3.0, 0.0))
    space.run_for(1.0)
    assert speed(ball) == pytest.approx(1.0, abs=1e-6)


def test_an_effort_turns_a_joint_until_it_is_cleared(space, hinge):
    space.forces.add(Effort(hinge, "j", 0.25, FOR_EVER))
    for _ in range(2):
        space.run_for(1.0)
        assert rate(hinge) == pytest.approx(0.5, rel=1e-3)
        space.forces.clear(Effort, (hinge, "j"))
    assert not space.forces.active


def test_clearing_a_link_leaves_joints_and_other_models_alone(space, ball, hinge):
    push(space, 1.0)
    space.forces.add(Effort(hinge, "j", 0.25, FOR_EVER))
    push(space, name="hinge::arm", torque=(0.0, 0.0, 1.0))
    space.forces.clear(Wrench, (hinge, "arm"))
    space.run_for(1.0)
    assert speed(ball) == pytest.approx(0.5, abs=1e-6)
    assert rate(hinge) == pytest.approx(0.5, rel=1e-3)


def test_forces_go_with_their_model_and_with_time(space, ball, hinge):
    push(space, 1.0)
    space.remove("ball")
    assert not space.forces.active
    space.run_for(0.01)
    push(space, 1.0, "hinge::arm", period=Period.after(10, 5.0, 1.0))
    space.reset_simulation()
    assert not space.forces.active


@cases("force: [.nan, -10000000000.0]")
def test_absurd_forces_are_refused(space, ball, hinge, force):
    with refuses("not within", ForceError):
        push(space, force)
    with refuses("not within", ForceError):
        space.forces.add(Effort(hinge, "j", force, FOR_EVER))
    with refuses("not within 1e\\+06 m", ForceError):
        push(space, 1.0, point=(1e300, 0.0, 0.0))
    assert not space.forces.active


def test_nothing_pushes_what_is_static(space):
    space.add(Model("wall", (Link("l"),), static=True))
    with refuses("'wall' is static", ForceError):
        push(space, 1.0, "wall::l")
