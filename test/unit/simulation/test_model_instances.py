"""Models and links by their names, states relative to them, and changes of links and joints."""

import math
from functools import partial

import numpy as np
import pytest
from alike import assert_alike
from sensor_worlds import thing
from shared import BLOCK_ROBOT

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.simulation.models import (
    EntityError,
    bounds,
    change_joint,
    change_link,
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
from bullet_lab.simulation.world.urdf import read_urdf

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


# A flywheel about the vertical on a heavy foot.
FLYWHEEL = """<robot name="flywheel">
  <link name="foot"><inertial><mass value="500"/>
    <inertia ixx="99" iyy="99" izz="99"/></inertial></link>
  <link name="wheel"><inertial><mass value="1"/>
    <inertia ixx="0.5" iyy="0.5" izz="0.5"/></inertial></link>
  <joint name="axle" type="continuous"><parent link="foot"/><child link="wheel"/>
    <axis xyz="0 0 1"/></joint></robot>"""


@pytest.fixture
def flywheel(space):
    return space.add(read_urdf(FLYWHEEL, "flywheel"))


@pytest.fixture
def wheel(space, flywheel):
    return find_link(space.models, "wheel")


def speed_after(space, flywheel, seconds=0.5):
    """Turn the wheel for a while and return how fast it has become."""
    body = flywheel.body_of_joint("axle")
    for _ in range(round(1000 * seconds)):
        body.exert("axle", 1.0)
        space.run_until(space.step + 1)
    return body.joint_state("axle").velocity


def test_a_heavier_wheel_turns_more_slowly(space, flywheel, wheel):
    assert speed_after(space, flywheel) == pytest.approx(1.0, rel=0.01)
    space.reset_world()
    change_link(wheel, Inertia(4.0, (0.0, 0.0, 0.0), 2.0 * np.eye(3)), True)
    assert speed_after(space, flywheel) == pytest.approx(0.25, rel=0.03)
    assert flywheel.model.links_by_name()["wheel"].inertia.mass == 4.0


def test_stops_and_damping(space, flywheel):
    change_joint(flywheel, "axle", damping=0.5)
    assert speed_after(space, flywheel, 5.0) == pytest.approx(2.0, rel=0.02)
    space.reset_world()
    change_joint(flywheel, "axle", lower=-0.3, upper=0.2)
    speed_after(space, flywheel, 2.0)
    position = flywheel.body_of_joint("axle").joint_state("axle").position
    assert position == pytest.approx(0.2, abs=0.02)
    (joint,) = flywheel.model.joints
    assert (joint.kind, joint.damping) == ("revolute", 0.5)
    assert dict(joint.limits) == {"lower": -0.3, "upper": 0.2}


@pytest.mark.parametrize(
    ("inertia", "said"),
    [
        (Inertia(0.0, (0.0, 0.0, 0.0), np.eye(3)), "must be positive"),
        (Inertia(1.0, (0.1, 0.0, 0.0), np.eye(3)), "its centre of mass and its principal axes"),
        (Inertia(1e13, (0.0, 0.0, 0.0), np.eye(3)), "1e\\+13 is not within ±1e\\+12"),
    ],
)
def test_what_a_link_cannot_become(flywheel, wheel, inertia, said):
    with pytest.raises(LabError, match=said):
        change_link(wheel, inertia, True)
    assert flywheel.model.links_by_name()["wheel"].inertia.mass == 1.0


def test_what_never_moves_is_not_changed(space):
    space.add(thing("<sphere><radius>1</radius></sphere>", "9 9 9 0 0 0"))
    with pytest.raises(LabError, match="never moves"):
        change_link(find_link(space.models, "l"), INERTIA, True)
