import math

import numpy as np
import pytest
from sensor_worlds import record, steps

from bullet_lab.simulation.world.urdf import read_urdf

ARM, MOMENT, G = 0.5, 0.001, 9.8


def pendulum(tags=""):
    """A heavy foot with an arm that starts level and swings about a hinge 1 m above it."""
    return read_urdf(
        '<robot name="pendulum"><link name="foot"><inertial><mass value="1000"/>'
        '<inertia ixx="1000" iyy="1000" izz="1000"/></inertial>'
        '<collision><origin xyz="0 0 0.1"/><geometry><box size="4 4 0.2"/></geometry>'
        "</collision></link>"
        f'<link name="arm"><inertial><origin xyz="{ARM} 0 0"/><mass value="1"/>'
        f'<inertia ixx="{MOMENT}" iyy="{MOMENT}" izz="{MOMENT}"/></inertial></link>'
        '<joint name="hinge" type="continuous"><origin xyz="0 0 1"/><parent link="foot"/>'
        f'<child link="arm"/><axis xyz="0 1 0"/></joint>'
        '<gazebo><plugin name="states" filename="libgazebo_ros_joint_state_publisher.so">'
        f"{tags}</plugin></gazebo></robot>",
        "pendulum",
    )


def swing(seconds):
    """Angle and angular velocity of an ideal pendulum that starts level, at each ms."""
    angle, speed, path = 0.0, 0.0, []
    for _ in range(round(seconds * 10_000)):
        speed += 1e-4 * G * ARM / (ARM * ARM + MOMENT) * math.cos(angle)
        angle += 1e-4 * speed
        path.append((angle, speed))
    return np.array(path[9::10])


def test_a_hinge_swings_under_gravity(world):
    robot = world.add(pendulum("<updateRate>50</updateRate>"))
    samples = record(robot, "joint_states")
    world.run_for(0.8)
    assert steps(samples) == list(range(20, 801, 20))
    assert {sample.names for sample in samples} == {("hinge",)}
    expected = swing(0.8)[19::20]
    positions = [sample.positions[0] for sample in samples]
    velocities = [sample.velocities[0] for sample in samples]
    assert positions == pytest.approx(expected[:, 0], abs=0.03)
    assert velocities == pytest.approx(expected[:, 1], abs=0.1)
    assert {sample.efforts for sample in samples} == {()}
