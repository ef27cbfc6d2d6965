"""Joints and links that are changed while they are there."""

import numpy as np
import pytest
from sensor_worlds import thing

from bullet_lab.errors import LabError
from bullet_lab.simulation.models import change_joint, change_link, find_link
from bullet_lab.simulation.world.description import Inertia
from bullet_lab.simulation.world.urdf import read_urdf

# A flywheel about the vertical on a heavy foot.
FLYWHEEL = """<robot name="flywheel">
  <link name="foot"><inertial><mass value="500"/>
    <inertia ixx="99" iyy="99" izz="99"/></inertial></link>
  <link name="wheel"><inertial><mass value="1"/>
    <inertia ixx="0.5" iyy="0.5" izz="0.5"/></inertial></link>
  <joint name="axle" type="continuous"><parent link="foot"/><child link="wheel"/>
    <axis xyz="0 0 1"/></joint></robot>"""


@pytest.fixture
def world(space):
    space.add(read_urdf(FLYWHEEL, "flywheel"))
    return space


def speed_after(world, effort, seconds=0.5):
    """Turn the wheel for a while and return how fast it has become."""
    robot = world.models["flywheel"]
    body = robot.body_of_joint("axle")
    for _ in range(round(1000 * seconds)):
        body.exert("axle", effort)
        world.run_until(world.step + 1)
    return body.joint_state("axle").velocity


def test_a_heavier_wheel_turns_more_slowly(world):
    assert speed_after(world, 1.0) == pytest.approx(1.0, rel=0.01)
    world.reset_world()
    robot = world.models["flywheel"]
    wheel = find_link(world.models, "flywheel::wheel")
    change_link(wheel, Inertia(4.0, (0.0, 0.0, 0.0), 2.0 * np.eye(3)), True)
    assert speed_after(world, 1.0) == pytest.approx(0.25, rel=0.03)
    assert robot.model.links_by_name()["wheel"].inertia.mass == 4.0


def test_stops_and_damping(world):
    robot = world.models["flywheel"]
    change_joint(robot, "axle", damping=0.5)
    assert speed_after(world, 1.0, 5.0) == pytest.approx(2.0, rel=0.02)
    world.reset_world()
    change_joint(robot, "axle", lower=-0.3, upper=0.2)
    speed_after(world, 1.0, 2.0)
    body = robot.body_of_joint("axle")
    assert body.joint_state("axle").position == pytest.approx(0.2, abs=0.02)
    (joint,) = robot.model.joints
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
def test_refusals(world, inertia, said):
    with pytest.raises(LabError, match=said):
        change_link(find_link(world.models, "wheel"), inertia, True)
    assert world.models["flywheel"].model.links_by_name()["wheel"].inertia.mass == 1.0


def test_what_never_moves_is_refused(world):
    world.add(thing("<sphere><radius>1</radius></sphere>", "9 9 9 0 0 0"))
    with pytest.raises(LabError, match="never moves"):
        change_link(find_link(world.models, "l"), Inertia(1.0, (0.0, 0.0, 0.0), np.eye(3)), True)
