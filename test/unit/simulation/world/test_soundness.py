"""Odd links: what is corrected, what is left out, and that the rest of the robot acts."""

import math

import numpy as np
import pytest
from shared import cases, complains

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.simulation.world.sdf import read_spawned

ROBOT = """<robot name="r"><link name="base"><inertial><mass value="2"/>
  <inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><box size="0.2 0.2 0.1"/></geometry></collision></link>
  <link name="wheel">{}<collision><origin rpy="1.5708 0 0"/>
  <geometry><cylinder radius="0.1" length="0.04"/></geometry></collision></link>
  <joint name="j" type="continuous"><parent link="base"/><child link="wheel"/>
  <origin xyz="0 0.15 0"/><axis xyz="0 1 0"/></joint></robot>"""


def robot(moments="0.001 0.001 0.001", mass="0.3"):
    said = " ".join(f'{key}="{m}"' for key, m in zip(("ixx", "iyy", "izz"), moments.split()))
    inertia = f'<inertia {said} ixy="0" ixz="0" iyz="0"/>'
    inertial = f'<inertial><mass value="{mass}"/>{inertia}</inertial>'
    return read_spawned(ROBOT.format(inertial), "robot")


def test_off_diagonal_elements_that_no_body_has():
    text = ROBOT.format("").replace('ixy="0"', 'ixy="0.05"')
    with complains("link 'base': no body can have the principal moments -0.03, 0.02, 0.07"):
        model = read_spawned(text, "robot")
    assert np.linalg.eigvalsh(model.links[0].inertia.matrix).min() > 0.0


@cases("moments: [0 0 0, 1e-9 1e-9 1]")
def test_a_robot_with_odd_moments_stands_and_turns_its_wheel(world, moments):
    instance = world.add(robot(moments), pose=Pose((0.0, 0.0, 0.1)))
    instance.body_of_joint("j").drive_joint("j", 3.0, 1.0)
    world.run_for(1.0)
    x, y, z = instance.pose().position
    assert math.hypot(x, y) < 1.0
    assert z == pytest.approx(0.05, abs=0.06)
    assert np.isfinite(instance.pose().quaternion).all()


@cases("""
mass:
  - "0"
  - heavy
""")
def test_a_link_without_mass_is_left_out_and_the_rest_stands(world, mass):
    with complains("model 'r': link 'wheel' moves and has no mass; it is left out$"):
        instance = world.add(robot(mass=mass), pose=Pose((0.0, 0.0, 0.06)))
    world.run_for(0.5)
    assert [link.name for link in instance.model.links] == ["base"]
    assert instance.pose().position[2] == pytest.approx(0.05, abs=2e-3)


def test_a_static_robot_needs_no_mass(world):
    text = ROBOT.format("")
    text = text.replace("</robot>", "<gazebo><static>true</static></gazebo></robot>")
    instance = world.add(read_spawned(text, "robot"), pose=Pose((0.0, 0.0, 1.0)))
    world.run_for(0.1)
    assert instance.model.static
    assert instance.frame("wheel").pose().position == pytest.approx((0, 0.15, 1))


@cases("name: [world, base]")
def test_a_robot_of_one_link_without_mass_is_refused(world, name):
    with pytest.raises(LabError, match=f"link '{name}' moves and has no mass"):
        world.add(read_spawned(f'<robot name="r"><link name="{name}"/></robot>', "robot"))


# What no model can be

SDF = """<sdf version="1.6"><model name="m">
  <link name="a"><inertial><mass>1</mass>
    <inertia><ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz></inertia></inertial>
    <collision name="c"><geometry><box><size>0.2 0.3 0.4</size></box></geometry></collision></link>
  <link name="b"><pose>0 0 1 0 0 0</pose><inertial><mass>1</mass></inertial></link>
  <joint name="j" type="revolute"><parent>a</parent><child>b</child>
    <axis><xyz>0 0 1</xyz></axis></joint>
</model></sdf>"""


@cases(r"""
old, new, said:
  - [0.2 0.3 0.4, 0.2 0.3 1e30, '<size>: 1e\+30 is not within ±1e\+18']
  - [0.2 0.3 0.4, 0.2 0.3 1e9, 'size of a shape: 1e\+09 is not within ±1e\+06']
  - [0 0 1 0 0 0, 0 0 1e12 0 0 0, 'link ''b'': pose: 1e\+12 is not within ±1e\+06']
""")
def test_what_exceeds_all_bounds_is_named_and_the_world_goes_on(world, old, new, said):
    with complains(said):
        world.add(read_spawned(SDF.replace(old, new), "model_xml of 'm'"))
    world.run_for(0.01)


@cases(r"""
name, said:
  - [ground_plane, "'ground_plane' exists already"]
  - ["new\nline", 'name ''new\\nline'': has characters that cannot be printed']
""")
def test_names_that_cannot_be(world, name, said):
    with pytest.raises(LabError, match=said):
        world.add(read_spawned(SDF, "text"), name)
    assert list(world.models) == ["ground_plane"]
