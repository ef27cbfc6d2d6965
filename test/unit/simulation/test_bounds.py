"""The boxes around models."""

import pytest

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.models import bounds
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.urdf import read_urdf

ROBOT = """<robot name="r">
  <link name="base">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><origin xyz="0 0 0.5"/><geometry><box size="0.2 0.4 1"/></geometry></visual>
  </link>
</robot>"""


@pytest.fixture
def robot():
    with Simulation() as simulation:
        pose = Pose.from_rpy((2.0, 0.0, 0.0), (0.0, 0.0, 0.5 * 3.141592653589793))
        yield simulation.add(read_urdf(ROBOT, "r"), pose=pose)


def test_bounds_are_in_the_world(robot):
    least, greatest = bounds(robot)
    assert least == pytest.approx((1.8, -0.1, 0.0))
    assert greatest == pytest.approx((2.2, 0.1, 1.0))


def test_a_plane_has_no_corners():
    with Simulation.of("package://bullet_lab/worlds/empty.world") as simulation:
        floor = next(iter(simulation.models.values()))
        least, greatest = bounds(floor)
    assert max(map(abs, (*least, *greatest))) < 1e3
