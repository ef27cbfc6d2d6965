"""What the drives have in common, and the friction of planar_move."""

import pytest
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.mobile_base import SupportPatch
from bullet_lab.simulation.world.sdf import read_spawned

DT, G = 1e-3, 9.8
BLOCK = SupportPatch(friction=1.0, radius=0.0102, mass=4.51, inertia=7.5125e-3)
LOAD = BLOCK.mass * G
WHEEL = """<link name="{0}"><pose>{1} {2} 0.1 0 0 0</pose>
  <inertial><mass>1</mass><inertia><ixx>0.01</ixx><iyy>0.01</iyy><izz>0.01</izz></inertia></inertial>
  </link><joint name="{0}_joint" type="revolute"><parent>deck</parent><child>{0}</child>
  <axis><xyz>0 1 0</xyz></axis></joint>"""
ROBOT = """<sdf version="1.6"><model name="robot"><link name="deck"><pose>0.3 0.2 0.5 0 0 1</pose>
  <inertial><mass>5</mass><inertia><ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz></inertia></inertial>
  </link>{}<plugin name="drive" filename="libgazebo_ros_{}.so"/></model></sdf>"""
DIFF = [("left", 0, 0.2), ("right", 0, -0.2)]
SKID = [(f"{side}_{end}", x, y) for side, y in (("left", 0.2), ("right", -0.2))
        for end, x in (("front", 0.2), ("rear", -0.2))]  # fmt: skip


@pytest.mark.parametrize(
    ("plugin", "wheels"), [("planar_move", []), ("diff_drive", DIFF), ("skid_steer_drive", SKID)]
)
def test_odometry_is_of_the_model_and_not_of_its_first_link(world, plugin, wheels):
    text = ROBOT.format("".join(WHEEL.format(*wheel) for wheel in wheels), plugin)
    robot = world.add(read_spawned(text, "robot"), "", Pose((1.0, 2.0, 0.0)))
    told = []
    robot.listen("odom", told.append)
    world.run_for(0.06)
    assert told[-1].pose.position[:2] == pytest.approx((1.0, 2.0), abs=1e-6)
    assert told[-1].pose.yaw == pytest.approx(0.0, abs=1e-6)
    # The bridge asks for it.
    assert robot.plugins[0].frames[0] == told[-1].frame


@cases("""
slow:
  - [0.001, 0, 0]
  - [0, -0.001, 0]
  - [0, 0, 0.01]
  - [0.001, 0.001, -0.01]
""")
def test_friction_stops_and_never_reverses(slow):
    assert BLOCK.slow_down(*slow, 100 * LOAD, DT) == (0, 0, 0)


def test_no_friction_without_load_slip_or_radius():
    assert BLOCK.slow_down(1.0, 2.0, 3.0, 0.0, DT) == (1, 2, 3)
    assert BLOCK.slow_down(0.0, 0.0, 0.0, LOAD, DT) == (0, 0, 0)
    point = SupportPatch(1.0, 0.0, 4.51, 7.5125e-3)
    assert point.slow_down(0.0, 0.0, 3.0, LOAD, DT) == (0, 0, 3)
