import functools
import math

import numpy as np
import pytest
from noise_checks import check_normal
from sensor_worlds import carrier, empty, held, readings, record, sensor, table

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.world.urdf import read_urdf

G = 9.8
FRAME = "<frameName>imu_link</frameName>"
SENSOR_TAGS = f"<topicName>imu</topicName>{FRAME}<updateRateHZ>100</updateRateHZ>"


BLOCK_SHAPE = (
    '<inertial><origin xyz="0 0 0.025"/><mass value="4.5"/>'
    '<inertia ixx="4.6875e-3" iyy="4.6875e-3" izz="7.5e-3"/></inertial>'
    '<collision><origin xyz="0 0 0.025"/><geometry><box size="0.1 0.1 0.05"/></geometry>'
    "</collision>"
)


def imu(tags="<updateRate>100</updateRate>", body="base", **robot):
    return carrier(
        '<gazebo><plugin name="imu" filename="libgazebo_ros_imu.so">'
        f"<bodyName>{body}</bodyName><topicName>imu</topicName>{tags}</plugin></gazebo>",
        **robot,
    )


def imu_sensor(tags=SENSOR_TAGS, inner=""):
    return carrier(sensor("imu", inner, "libgazebo_ros_imu_sensor.so", tags))


FALLING = functools.partial(empty, gravity=(0.0, 0.0, -G))


def block(rate, at="0 0 0.05"):
    """The report's block with an inertial unit."""
    return read_urdf(
        f'<robot name="block"><link name="base">{BLOCK_SHAPE}</link><link name="imu_link"/>'
        '<joint name="j" type="fixed"><parent link="base"/><child link="imu_link"/>'
        f'<origin xyz="{at}"/></joint><gazebo>'
        '<plugin name="move" filename="libgazebo_ros_planar_move.so"/>'
        '<plugin name="imu" filename="libgazebo_ros_imu.so"><bodyName>imu_link</bodyName>'
        f"<topicName>imu</topicName><updateRate>{rate}</updateRate></plugin></gazebo></robot>",
        "block",
    )


# That of the model feels no gravity, as in Gazebo.
@pytest.mark.parametrize(("make", "rest"), [(imu, 0.0), (imu_sensor, G)])
@pytest.mark.parametrize(("world", "fall", "within"), [(held, 0.0, 1e-9), (FALLING, G, 1e-6)])
def test_at_rest_gravity_is_read_upwards_and_in_free_fall_nothing(make, rest, world, fall, within):
    samples = readings(make(), "imu", world=world)
    assert len(samples) == 10
    for sample in samples:
        assert sample.specific_force == pytest.approx((0, 0, rest - fall), abs=within)
        assert sample.angular_velocity == pytest.approx((0, 0, 0), abs=1e-9)
        assert sample.orientation == (0.0, 0.0, 0.0, 1.0)


def test_a_turn_at_speed_reads_the_centripetal_acceleration(world):
    speed, turn = 0.3, 0.5
    robot = world.add(block(1000, at="0.02 0 0.05"))
    robot.command("cmd_vel", PlanarCommand(vx=speed, wz=turn))
    world.run_for(0.5)
    samples = record(robot, "imu")
    world.run_for(1.0)
    forces = table(samples, "specific_force")
    rates = table(samples, "angular_velocity")
    # What floor friction leaves of the command.
    real_speed, real_turn = speed - 9.8e-3, rates[:, 2].mean()
    assert real_turn == pytest.approx(turn, abs=3e-3)
    assert forces.mean(axis=0) == pytest.approx(
        (-0.02 * real_turn**2, real_speed * real_turn, 0.0), abs=0.02
    )
    # Bullet's contacts rattle; as differences over single steps, z would spread by 6 m/s².
    assert (forces.std(axis=0) < (0.3, 0.3, 1.0)).all()


def test_readings_add_up_to_the_change_of_velocity(world):
    rate = 40
    robot = world.add(block(rate))
    world.run_for(0.5)
    samples = record(robot, "imu")
    robot.command("cmd_vel", PlanarCommand(vx=0.4))
    world.run_for(0.5)
    gained = sum(sample.specific_force[0] for sample in samples) / rate
    # The velocity before friction acts, as Gazebo's plugin reads it.
    assert gained == pytest.approx(0.4, abs=2e-3)
    assert samples[0].specific_force[0] == pytest.approx(0.4 * rate, rel=0.02)


def test_a_spinning_sensor_off_the_centre_feels_its_own_turning():
    model = imu("<updateRate>100</updateRate><xyzOffset>0.5 0 0</xyzOffset>")
    with empty() as simulation:
        robot = simulation.add(model)
        robot.bodies["base"].set_velocity((0, 0, 0), (0, 0, 2.0))
        robot.plugins[0].placed()
        samples = record(robot, "imu")
        simulation.run_for(0.3)
    assert samples[-1].angular_velocity == pytest.approx((0, 0, 2.0), abs=1e-6)
    # The mean over 10 ms lags by 5 ms: 0.01 rad of the direction.
    assert samples[-1].specific_force == pytest.approx((-2.0, 0.02, 0.0), abs=2e-3)


def test_no_spike_when_it_is_put_elsewhere(world):
    robot = world.add(block(100))
    samples = record(robot, "imu")
    robot.command("cmd_vel", PlanarCommand(vx=0.5))
    world.run_for(0.305)
    samples.clear()
    robot.command("cmd_vel", PlanarCommand())
    robot.place(Pose((3, 0, 0)))
    world.run_for(0.3)
    after = table(samples, "specific_force")
    assert len(after) >= 29
    # It sinks in where it is put.
    assert np.abs(after).max() < 0.4


# Noise


def test_noise_of_the_sensor_element():
    noise = "<noise><mean>{}</mean><stddev>{}</stddev><bias_mean>{}</bias_mean></noise>"
    inner = (
        f"<imu><angular_velocity><x>{noise.format(0, 0.02, 0)}</x></angular_velocity>"
        f"<linear_acceleration><z>{noise.format(0, 0.3, 2.0)}</z></linear_acceleration></imu>"
    )
    model = imu_sensor(inner=inner)
    samples = readings(model, "imu", 10.0, seed=1)
    rates = table(samples, "angular_velocity")
    forces = table(samples, "specific_force")
    check_normal(rates[:, 0], 0.02)
    assert not rates[:, 1:].any()
    bias = round(forces[:, 2].mean())
    assert abs(bias) == 2
    check_normal(forces[:, 2] - bias, 0.3)
    first = samples[0]
    variances = (first.angular_velocity_variance, first.specific_force_variance)
    assert (*variances, first.orientation_variance) == pytest.approx((4e-4, 0.09, 0.0))
    signs = {
        round(readings(model, "imu", 0.01, seed=seed)[0].specific_force[2] / 2.0)
        for seed in range(20)
    }
    assert signs == {-1, 1}


# Rates, frames, defaults, refusals


def test_gravity_in_any_direction_is_felt_in_the_sensors_axes():
    turned = Pose.from_rpy((0, 0, 1), (0.2, math.radians(30), 1.0))
    with held() as simulation:
        samples = record(simulation.add(imu_sensor(), pose=turned), "imu")
        for gravity in ((2.0, -3.0, -9.6), (0.0, 0.0, 5.0)):
            simulation.set_gravity(gravity)
            simulation._physics.set_gravity((0.0, 0.0, 0.0))
            simulation.run_for(0.05)
            opposite = turned.inverse().rotate(tuple(-part for part in gravity))
            assert samples[-1].specific_force == pytest.approx(opposite, abs=1e-9)
    assert samples[-1].orientation == pytest.approx(turned.quaternion)
