"""Models and links by their names, and states relative to them."""

import math
from functools import partial

import numpy as np
import pytest
from alike import assert_alike
from shared import BLOCK_ROBOT

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.models import (
    EntityError,
    bounds,
    find_joint,
    find_link,
    frame_state,
    in_world,
    model_entity,
    move_link,
    relative_to,
)
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import SimulationError
from bullet_lab.simulation.world.description import (
    Box,
    Collision,
    FrameState,
    Inertia,
    Joint,
    Link,
    Model,
    Visual,
)
from bullet_lab.simulation.world.tree import lump_fixed_joints

INERTIA = Inertia(2.0, (0.1, -0.2, 0.3), np.diag([0.1, 0.15, 0.2]))
alike = partial(assert_alike, within=1e-9)
TILTED = Pose.from_rpy((1.0, 2.0, 3.0), (0.3, -0.4, 1.9))


def arm():
    """A base, an upper link on a hinge about y, and a tool fixed to that."""
    links = (
        Link("base", Pose((0.0, 0.0, 0.1)), INERTIA, (), (Collision(Box((0.2, 0.2, 0.2))),)),
        Link("upper", Pose((0.0, 0.0, 1.1)), INERTIA),
        Link("tool", Pose((0.5, 0.0, 1.1)), INERTIA),
    )
    joints = (
        Joint("elbow", "revolute", "base", "upper", Pose((0.0, 0.0, 1.0)), (0.0, 1.0, 0.0)),
        Joint("grip", "fixed", "upper", "tool", Pose((0.5, 0.0, 0.0))),
    )
    return lump_fixed_joints(Model("arm", links, joints))


@pytest.fixture
def robot(space):
    return space.add(arm(), "left", TILTED)


@pytest.fixture
def robot_on_floor(world):
    return world.spawn(BLOCK_ROBOT)


def test_models_links_and_merged_links_are_found(space, robot):
    robot.configure({"elbow": math.pi / 2})
    upper = Pose.from_rpy((0.0, 0.0, 1.1), (0.0, math.pi / 2, 0.0))
    base = Pose((0.0, 0.0, 0.1))
    expected = {
        "left": Pose(),
        "left::base": base,
        "base": base,
        "left::upper": upper,
        "left::tool": upper * Pose((0.5, 0.0, 0.0)),
    }
    for name, place in expected.items():
        alike(frame_state(space.models, name).pose, TILTED * place)
    assert find_link(space.models, "left::tool").frame.link == "upper"


def test_a_name_that_several_models_have_must_be_scoped(space, robot):
    space.add(arm(), "right", Pose((9.0, 0.0, 0.0)))
    with pytest.raises(EntityError, match="ambiguous: left, right have it; use model::link"):
        find_link(space.models, "upper")
    assert find_link(space.models, "right::upper").instance.name == "right"


@pytest.mark.parametrize("name", ["left::nix", "nix::base", "left::"])
def test_what_is_not_there_is_said_to_be_missing(space, robot, name):
    with pytest.raises(EntityError, match="not found"):
        frame_state(space.models, name)
    with pytest.raises(EntityError, match=r"\[" + name):
        find_link(space.models, name)


@pytest.mark.parametrize("name", ["", "world", "/map"])
def test_names_of_the_world(space, name):
    assert frame_state(space.models, name) == FrameState(Pose())


def test_joints_are_found_with_and_without_the_model(space, robot):
    space.add(arm(), "right", Pose((9.0, 0.0, 0.0)))
    assert [find_joint(space.models, n)[0].name for n in ("elbow", "right::elbow")] == [
        "left",
        "right",
    ]
    with pytest.raises(EntityError, match=r"joint \[grip\] not found"):
        find_joint(space.models, "grip")


def test_a_relative_velocity_is_the_difference_in_the_frames_axes():
    quarter = Pose.from_rpy((1.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2))
    frame = FrameState(quarter, (1.0, 0.0, 0.0), (0.0, 0.0, 2.0))
    state = FrameState(Pose((1.0, 3.0, 0.0)), (1.0, 4.0, 0.0), (0.1, 0.0, 0.0))
    seen = relative_to(frame, state)
    assert seen.pose.position == pytest.approx((3.0, 0.0, 0.0))
    assert seen.linear == pytest.approx((4.0, 0.0, 0.0))
    assert seen.angular == pytest.approx((0.0, -0.1, -2.0))
    still = FrameState(quarter)
    alike(in_world(still, relative_to(still, state)), state)


def test_a_moved_model_keeps_its_joints_and_flies_on(space, robot):
    robot.configure({"elbow": 0.7})
    there = Pose.from_rpy((-3.0, 1.0, 8.0), (1.0, 0.2, -2.0))
    robot.move(there, (1.0, -2.0, 0.5), (0.0, 0.0, 0.0))
    wanted = FrameState(there, (1.0, -2.0, 0.5), (0.0, 0.0, 0.0))
    alike(model_entity(robot).state(), wanted)
    assert robot.body_of_joint("elbow").joint_state("elbow").position == pytest.approx(0.7)
    space.run_for(0.5)
    assert robot.pose().position == pytest.approx((-2.5, 0.0, 8.25), abs=1e-6)


def test_the_velocity_is_that_of_the_frame_and_not_of_the_centre_of_mass(space, robot):
    robot.move(TILTED, (0.0, 0.0, 0.0), (0.0, 0.0, 2.0))
    state = model_entity(robot).state()
    assert state.linear == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert state.angular == pytest.approx((0.0, 0.0, 2.0), abs=1e-9)
    # A point off the axis moves.
    upper = find_link(space.models, "left::upper").state()
    lever = np.subtract(upper.pose.position, TILTED.position)
    assert upper.linear == pytest.approx(np.cross((0.0, 0.0, 2.0), lever))


def test_a_moved_link_takes_the_model_with_it(space, robot):
    robot.configure({"elbow": -0.4})
    tool = find_link(space.models, "left::tool")
    before = tool.state().pose.inverse() * robot.pose()
    place = Pose.from_rpy((7.0, 7.0, 7.0), (0.0, 0.0, 0.5))
    wanted = FrameState(place, (1.0, 0.0, 0.0), (0.0, 0.0, 3.0))
    move_link(tool, wanted)
    alike(tool.state(), wanted)
    alike(robot.pose(), place * before)


def test_an_absurd_velocity_is_refused_and_changes_nothing(space, robot):
    before = robot.state()
    with pytest.raises(SimulationError, match="model 'left'"):
        robot.move(Pose(), (0.0, 1e12, 0.0), (0.0, 0.0, 0.0))
    assert robot.state() == before


def test_a_joint_that_is_not_there_leaves_the_others_alone(space, robot):
    with pytest.raises(SimulationError, match="no movable joint 'grip'"):
        robot.configure({"elbow": 1.0, "grip": 1.0})
    with pytest.raises(SimulationError, match="joint 'elbow': position nan is not finite"):
        robot.configure({"elbow": math.nan})
    assert robot.state().joints["elbow"] == (0.0, 0.0)


def test_a_restored_state_is_the_state(space, robot):
    space.set_gravity((0.0, 0.0, -9.8))
    robot.move(TILTED, (1.0, 0.0, 2.0), (0.3, 0.2, 0.1))
    space.run_for(0.2)
    state = robot.state()
    assert abs(state.joints["elbow"][1]) > 1e-3
    space.run_for(0.2)
    robot.restore(state)
    alike(state, robot.state())


def test_a_robot_that_is_pushed_about_rubs_as_gravity_has_it(world, robot_on_floor):
    world.set_gravity((0.0, 0.0, -1.6))
    robot_on_floor.command("cmd_vel", PlanarCommand(vx=0.2))
    world.run_for(1.0)
    # Friction takes g·dt of the velocity at each step.
    assert robot_on_floor.pose().position[0] == pytest.approx(0.2 - 0.0016, abs=2e-4)


def test_gravity_is_the_worlds_and_finite(space):
    space.set_gravity((0.0, 0.0, -1.6))
    assert space.world.gravity == (0.0, 0.0, -1.6)
    with pytest.raises(SimulationError, match="not finite"):
        space.set_gravity((0.0, math.nan, 0.0))


def test_bounds_are_in_the_world_and_a_plane_has_none(world):
    shape = Visual(Box((0.2, 0.4, 1.0)), Pose((0.0, 0.0, 0.5)))
    turned = Pose.from_rpy((2.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2))
    post = world.add(Model("post", (Link("l", visuals=(shape,)),), static=True), pose=turned)
    assert np.array(bounds(post)) == pytest.approx(np.array([(1.8, -0.1, 0), (2.2, 0.1, 1)]))
    assert np.abs(bounds(world.models["ground_plane"])).max() < 1e3
