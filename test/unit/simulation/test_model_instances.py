"""Models and links by their names, states relative to them, and changes of links and joints."""

import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from alike import assert_alike, assert_as_before, lines_of
from sensor_worlds import thing
from shared import BLOCK_ROBOT

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.simulation.models import (
    bounds,
    change_joint,
    change_link,
    find_joint,
    find_link,
    frame_state,
    in_world,
    move_link,
    relative_to,
)
from bullet_lab.simulation.plugins.samples import PlanarCommand
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

HERE = Path(__file__).parent
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


def test_frames_are_found_and_moved_as_before(space, robot):
    """Gravity is off: what moves keeps on moving."""
    told = []

    def tell(what, names="left left::base left::upper left::tool"):
        for name in names.split():
            told.extend(lines_of(frame_state(space.models, name), f"{what}: {name}"))

    tell("nothing is", "world /map")
    robot.configure({"elbow": math.pi / 2})
    tell("bent by 90 degrees", "left left::base base left::upper left::tool")
    robot.configure({"elbow": 0.7})
    there = Pose.from_rpy((-3.0, 1.0, 8.0), (1.0, 0.2, -2.0))
    robot.move(there, (1.0, -2.0, 0.5), (0.0, 0.0, 0.0))
    tell("bent by 0.7 rad and moved")
    space.run_for(0.5)
    tell("half a second later")
    # The velocity is that of the frame and not of the centre of mass; a point off the axis moves.
    robot.move(TILTED, (0.0, 0.0, 0.0), (0.0, 0.0, 2.0))
    tell("turning about its frame")
    robot.configure({"elbow": -0.4})
    place = Pose.from_rpy((7.0, 7.0, 7.0), (0.0, 0.0, 0.5))
    move_link(find_link(space.models, "left::tool"), FrameState(place, (1, 0, 0), (0, 0, 3)))
    tell("its tool moved, and all with it")
    assert frame_state(space.models, "") == FrameState(Pose())
    assert_as_before(told, HERE / "frames.txt")


def test_what_cannot_be_is_said_as_before_and_changes_nothing(space, robot, flywheel, wheel):
    space.add(arm(), "right", Pose((9.0, 0.0, 0.0)))
    space.add(thing("<sphere><radius>1</radius></sphere>", "9 9 9 0 0 0"))
    found = [
        find_link(space.models, "right::upper").instance,
        *(find_joint(space.models, name)[0] for name in ("elbow", "right::elbow")),
    ]
    assert [instance.name for instance in found] == ["right", "left", "right"]
    missing = "left::nix", "nix::base", "left::"
    nowhere, still = (0.0, 0.0, 0.0), (robot.state(), flywheel.state(), flywheel.model)
    told = []
    for attempt, *given in (
        (find_link, space.models, "upper"),
        *((find_link, space.models, name) for name in missing),
        *((frame_state, space.models, name) for name in missing),
        (find_joint, space.models, "grip"),
        (robot.move, Pose(), (0.0, 1e12, 0.0), nowhere),
        (robot.configure, {"elbow": 1.0, "grip": 1.0}),
        (robot.configure, {"elbow": math.nan}),
        (space.set_gravity, (0.0, math.nan, 0.0)),
        (change_link, wheel, Inertia(0.0, nowhere, np.eye(3)), True),
        (change_link, wheel, Inertia(1.0, (0.1, 0.0, 0.0), np.eye(3)), True),
        (change_link, wheel, Inertia(1e13, nowhere, np.eye(3)), True),
        (change_link, find_link(space.models, "l"), INERTIA, True),
    ):
        with pytest.raises(LabError) as refusal:
            attempt(*given)
        told.append(refusal.value)
    assert (robot.state(), flywheel.state(), flywheel.model) == still
    assert_as_before(told, HERE / "refused.txt")


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


def test_a_restored_state_is_the_state(space, robot):
    space.set_gravity((0.0, 0.0, -9.8))
    assert space.world.gravity == (0.0, 0.0, -9.8)
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
