"""Links that gravity does not pull."""

import pytest
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.models import change_link, find_link
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.world.sdf import read_spawned
from bullet_lab.simulation.world.urdf import read_urdf

G = 9.8
SECONDS = 0.5
# In the first step nothing has fallen yet: v = g t, and so t (t + h) / 2.
FALL = 0.5 * G * SECONDS * (SECONDS + 0.001)
INERTIA = "<inertial><pose>0.1 0 0 0 0 0</pose><mass>{}</mass></inertial>"


def dumbbell(first, second, joint="fixed"):
    """Two links of 1 and 3 kg, 1 m apart, with what is in them."""
    links = "".join(
        f"<link name='{name}'><pose>{x} 0 0 0 0 0</pose>{INERTIA.format(mass)}{inner}</link>"
        for name, x, mass, inner in (("one", 0, 1, first), ("other", 1, 3, second))
    )
    axis = "<axis><xyz>0 0 1</xyz></axis>"
    return read_spawned(
        f"<sdf version='1.6'><model name='m'>{links}<joint name='j' type='{joint}'>"
        f"<parent>one</parent><child>other</child>{axis}</joint></model></sdf>",
        "m",
    )


OFF = "<gravity>0</gravity>"


@cases("joint: [fixed, prismatic]")
def test_what_floats_stays_where_it_is(falling, joint):
    robot = falling.add(dumbbell(OFF, "<gravity>false</gravity>", joint), pose=Pose((0, 0, 5)))
    falling.run_for(SECONDS)
    falling.set_gravity((1.0, -2.0, 3.0))
    falling.run_for(SECONDS)
    assert robot.pose().position == pytest.approx((0.0, 0.0, 5.0), abs=1e-9)


def test_one_of_two_that_are_fixed_to_each_other_has_no_weight(falling):
    # 1 of 4 kg is pulled, at 0.75 m from where they have their mass together.
    robot = falling.add(dumbbell("<gravity>1</gravity>", OFF))
    assert {link.name for link in robot.model.links} == {"one", "other"}
    falling.run_for(0.02)
    speeds = [find_link(falling.models, name).frame.velocity()[0][2] for name in ("one", "other")]
    # g / 4 for both together, and a turn on top.
    assert speeds[0] < -0.25 * G * 0.02 < speeds[1]


def test_gravity_is_turned_off_and_on_while_it_runs(falling):
    robot = falling.add(dumbbell("", ""))
    link = find_link(falling.models, "m::one")
    inertia = robot.model.links[0].inertia
    change_link(link, inertia, gravity=False)
    falling.run_for(SECONDS)
    assert robot.pose().position[2] == pytest.approx(0.0, abs=1e-9)
    change_link(link, inertia, gravity=True)
    falling.run_for(SECONDS)
    assert robot.pose().position[2] == pytest.approx(-FALL, rel=1e-6)


HOVERING = """<robot name="blimp"><link name="base"><inertial><mass value="1"/>
  <inertia ixx="1" iyy="1" izz="0.01"/></inertial></link>
  <gazebo reference="base"><turnGravityOff>true</turnGravityOff></gazebo>
  <gazebo><plugin name="move" filename="libgazebo_ros_planar_move.so"/></gazebo></robot>"""


def test_what_hovers_moves_without_friction(falling):
    robot = falling.add(read_urdf(HOVERING, "blimp"), pose=Pose((0.0, 0.0, 1.0)))
    robot.command("cmd_vel", PlanarCommand(vx=1.0))
    falling.run_for(1.0)
    assert robot.pose().position == pytest.approx((1.0, 0.0, 1.0), abs=1e-6)
