"""Wrenches on links and efforts on joints, for a while."""

import math

import numpy as np
import pytest

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.forces import Effort, ForceError, Period, Wrench
from bullet_lab.simulation.models import find_link, model_entity
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import FrameState, Inertia, Joint, Link, Model, World

THERE = Pose((1.0, 2.0, 3.0))
ZERO = (0.0, 0.0, 0.0)
MASS = 2.0
BALL = Inertia(MASS, ZERO, 0.5 * np.eye(3))
FOR_EVER = Period(0, math.inf)


@pytest.fixture
def space():
    with Simulation(World("space", gravity=ZERO)) as simulation:
        yield simulation


@pytest.fixture
def ball(space):
    return space.add(Model("ball", (Link("l", inertia=BALL),)), pose=THERE)


def push(space, name="ball::l", frame=None, force=ZERO, torque=ZERO, point=ZERO, period=FOR_EVER):
    link = find_link(space.models, name)
    given_in = frame and FrameState(frame)
    space.forces.add(Wrench.at_point(given_in, link, force, torque, point, period))


def velocity(instance):
    return model_entity(instance).state().linear


@pytest.mark.parametrize(
    ("now", "start", "duration", "expected"),
    [
        (100, 0.0, 0.05, Period(100, 150)),
        (100, 0.2001, 0.05, Period(201, 251)),
        (100, 0.0, -1.0, Period(100, math.inf)),
        (100, 0.0, 0.0, Period(100, 100)),
        (100, 0.0, 1e-5, Period(100, 101)),
    ],
)
def test_periods_are_whole_steps(now, start, duration, expected):
    assert Period.after(now, start, duration) == expected


def test_a_force_acts_for_its_time_and_not_longer(space, ball):
    push(space, force=(4.0, 0.0, 0.0), period=Period.after(0, 0.1, 0.25))
    for until, expected in ((0.1, 0.0), (0.2, 0.2), (0.35, 0.5), (1.0, 0.5)):
        space.run_for(until - space.seconds)
        assert velocity(ball) == pytest.approx((expected, 0.0, 0.0), abs=1e-9)
    assert not space.forces.active


def test_forces_add_up_and_are_cleared_together(space, ball):
    for force in ((1.0, 0.0, 0.0), (0.0, 2.0, 0.0)):
        push(space, force=force)
    space.run_for(1.0)
    space.forces.clear(Wrench, (ball, "l"))
    space.run_for(1.0)
    assert velocity(ball) == pytest.approx((0.5, 1.0, 0.0), abs=1e-6)


def test_a_force_beside_the_centre_turns(space, ball):
    push(space, force=(1.0, 0.0, 0.0), point=(0.0, 0.5, 0.0), period=Period(0, 1))
    space.run_for(0.001)
    state = model_entity(ball).state()
    assert state.linear == pytest.approx((0.5e-3, 0.0, 0.0))
    assert state.angular == pytest.approx((0.0, 0.0, -0.5e-3 / 0.5))


def test_a_wrench_is_given_in_a_frame(space, ball):
    quarter = Pose.from_rpy((1.0, 2.0, 0.0), (0.0, 0.0, math.pi / 2))
    # The ball's centre is 3 m above the frame's origin.
    one_step = Period(0, 1)
    force, torque = (2.0, 0.0, 0.0), (0.0, 0.5, 0.0)
    push(space, frame=quarter, force=force, torque=torque, point=(0.0, 0.0, 3.0), period=one_step)
    space.run_for(0.001)
    state = model_entity(ball).state()
    assert state.linear == pytest.approx((0.0, 1e-3, 0.0))
    assert state.angular == pytest.approx((-1e-3, 0.0, 0.0))


# Gazebo 11.1: 1 N along x of `b` or of `b::link`, which is at a yaw of 90 degrees, is along the
# world's x. gazebo_ros_api_plugin.cpp:2007 turns the force into the axes of the body; those
# numbers act in the world's.
@pytest.mark.parametrize(
    ("frame", "force", "torque", "linear", "angular"),
    [
        ("own", (2.0, 0.0, 0.0), ZERO, (1e-3, 0.0, 0.0), ZERO),
        ("own", ZERO, (0.5, 0.0, 0.0), ZERO, (1e-3, 0.0, 0.0)),
        (None, (2.0, 0.0, 0.0), ZERO, (1e-3, 0.0, 0.0), ZERO),
        (Pose(THERE.position), (2.0, 0.0, 0.0), ZERO, (0.0, -1e-3, 0.0), ZERO),
        (Pose((1.5, 2.0, 3.0)), (0.0, 2.0, 0.0), ZERO, (1e-3, 0.0, 0.0), (0.0, 0.0, 2e-3)),
    ],
)
def test_a_wrench_on_a_turned_body(space, ball, frame, force, torque, linear, angular):
    turned = Pose.from_rpy(THERE.position, (0.0, 0.0, math.pi / 2))
    ball.place(turned)
    frame = turned if frame == "own" else frame
    push(space, frame=frame, force=force, torque=torque, period=Period(0, 1))
    space.run_for(0.001)
    state = model_entity(ball).state()
    assert state.linear == pytest.approx(linear, abs=1e-9)
    assert state.angular == pytest.approx(angular, abs=1e-9)


def test_a_force_acts_at_the_centre_of_mass(space):
    aside = Inertia(MASS, (0.0, 0.3, 0.0), 0.5 * np.eye(3))
    bat = space.add(Model("bat", (Link("l", inertia=aside),)))
    push(space, "bat::l", force=(4.0, 0.0, 0.0), period=Period(0, 1))
    space.run_for(0.001)
    assert model_entity(bat).state().angular == pytest.approx(ZERO, abs=1e-9)


def test_a_force_keeps_its_direction_while_the_body_turns(space, ball):
    ball.move(ball.pose(), ZERO, (0.0, 0.0, 5.0))
    push(space, frame=ball.pose(), force=(2.0, 0.0, 0.0))
    space.run_for(1.0)
    assert velocity(ball) == pytest.approx((1.0, 0.0, 0.0), abs=1e-6)


def hinge(space):
    heavy = Inertia(1e6, ZERO, 1e6 * np.eye(3))
    links = (Link("foot", inertia=heavy), Link("arm", inertia=BALL))
    joint = Joint("j", "continuous", "foot", "arm", axis=(0.0, 0.0, 1.0))
    return space.add(Model("hinge", links, (joint,)))


def test_an_effort_turns_a_joint_until_it_is_cleared(space):
    model = hinge(space)
    space.forces.add(Effort(model, "j", 0.25, FOR_EVER))
    space.run_for(1.0)
    assert model.state().joints["j"][1] == pytest.approx(0.5, rel=1e-3)
    space.forces.clear(Effort, (model, "j"))
    space.run_for(1.0)
    assert model.state().joints["j"][1] == pytest.approx(0.5, rel=1e-3)
    assert not space.forces.active


def test_clearing_a_link_leaves_joints_and_other_models_alone(space, ball):
    model = hinge(space)
    push(space, force=(1.0, 0.0, 0.0))
    space.forces.add(Effort(model, "j", 0.25, FOR_EVER))
    push(space, "hinge::arm", torque=(0.0, 0.0, 1.0))
    space.forces.clear(Wrench, (model, "arm"))
    space.run_for(1.0)
    assert velocity(ball) == pytest.approx((0.5, 0.0, 0.0), abs=1e-6)
    assert model.state().joints["j"][1] == pytest.approx(0.5, rel=1e-3)


def test_forces_go_with_their_model_and_with_time(space, ball):
    push(space, force=(1.0, 0.0, 0.0))
    space.remove("ball")
    assert not space.forces.active
    space.run_for(0.01)
    hinge(space)
    push(space, "hinge::arm", force=(1.0, 0.0, 0.0), period=Period.after(10, 5.0, 1.0))
    space.reset_simulation()
    assert not space.forces.active


@pytest.mark.parametrize("force", [math.nan, -1e10])
def test_absurd_forces_are_refused(space, ball, force):
    with pytest.raises(ForceError, match="not within"):
        push(space, force=(0.0, force, 0.0))
    with pytest.raises(ForceError, match="not within"):
        space.forces.add(Effort(hinge(space), "j", force, FOR_EVER))
    with pytest.raises(ForceError, match="not within 1e\\+06 m"):
        push(space, force=(1.0, 0.0, 0.0), point=(1e300, 0.0, 0.0))
    assert not space.forces.active


def test_nothing_pushes_what_is_static(space):
    space.add(Model("wall", (Link("l"),), static=True))
    with pytest.raises(ForceError, match="'wall' is static"):
        push(space, "wall::l", force=(1.0, 0.0, 0.0))
