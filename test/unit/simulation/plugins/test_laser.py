import math

import numpy as np
import pytest
from noise_checks import check_normal
from scipy import stats
from sensor_worlds import box, carrier, empty, readings, record, sensor, table, thing

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.physics.rays import RAYS_AT_A_TIME

PLUGIN = "libgazebo_ros_laser.so"
TAGS = "<topicName>scan</topicName><frameName>laser_link</frameName>"
CAN = "<collision><geometry><cylinder radius='0.05' length='0.1'/></geometry></collision>"


def ray(samples=360, angles=(-math.pi, math.pi), limits=(0.1, 10.0), more="", resolution="1"):
    return (
        f"<ray><scan><horizontal><samples>{samples}</samples><resolution>{resolution}</resolution>"
        f"<min_angle>{angles[0]}</min_angle><max_angle>{angles[1]}</max_angle></horizontal></scan>"
        f"<range><min>{limits[0]}</min><max>{limits[1]}</max></range>{more}</ray>"
    )


def laser(inner="", **robot):
    inner = f"<update_rate>10</update_rate>{inner or ray()}"
    return carrier(sensor("ray", inner, PLUGIN, TAGS), **robot)


def noise(deviation, mean=0.0):
    return f"<noise><type>gaussian</type><mean>{mean}</mean><stddev>{deviation}</stddev></noise>"


def one_scan(simulation, model):
    scans = record(simulation.add(model), "scan")
    simulation.run_for(0.1)
    return scans[-1]


@pytest.fixture
def world():
    with empty() as simulation:
        yield simulation


def test_four_walls_to_the_micrometre(world):
    for name, pose, size in (
        ("ahead", "2.5 0 0 0 0 0", "1 9 1"),
        ("left", "0 2 0 0 0 0", "9 1 1"),
        ("behind", "-4.5 0 0 0 0 0", "1 9 1"),
        ("right", "0 -3.5 0 0 0 0", "9 1 1"),
    ):
        world.add(box(size, pose, name))
    scan = one_scan(world, laser(ray(361)))
    angles = scan.angle_min + scan.angle_increment * np.arange(361)
    with np.errstate(divide="ignore"):
        x = np.where(np.cos(angles) > 0, 2.0, -4.0) / np.cos(angles)
        y = np.where(np.sin(angles) >= 0, 1.5, -3.0) / np.sin(angles)
    assert scan.ranges == pytest.approx(np.minimum(x, y), abs=1e-6)


def test_too_near_reads_minus_infinity_and_too_far_infinity(world):
    world.add(box("0.01 1 1", "0.15 0 0 0 0 0", "near"))
    world.add(box("1 9 1", "2.5 0 0 0 0 0", "far"))
    world.add(box("1 9 1", "-5.6 0 0 0 0 0", "too far"))
    scan = one_scan(world, laser(ray(2, (0.0, math.pi), (0.2, 5.0))))
    assert np.isneginf(scan.ranges[0])
    assert np.isposinf(scan.ranges[1])


def test_the_robots_own_parts_are_seen_beyond_the_least_range_only(world):
    mast = (
        "<collision><origin xyz='0.3 0 0'/><geometry><box size='0.1 0.1 1'/></geometry></collision>"
    )
    world.add(box("1 9 1", "2.5 0 0 0 0 0"))
    # Within the can that it is in, a ray begins.
    seen = one_scan(world, laser(ray(2, (0.0, math.pi), (0.01, 5.0)), collision=CAN + mast))
    assert seen.ranges[0] == pytest.approx(0.25, abs=1e-6)
    world.remove("carrier")
    unseen = one_scan(world, laser(ray(2, (0.0, math.pi), (0.36, 5.0)), collision=CAN + mast))
    assert unseen.ranges[0] == pytest.approx(2.0, abs=1e-6)


def test_the_sensors_pose_its_merged_link_and_the_robots_pose_count(world):
    links = (
        '<link name="mount"/><joint name="j" type="fixed"><parent link="base"/>'
        '<child link="mount"/><origin xyz="0.5 0 0" rpy="0 0 1.5707963267948966"/></joint>'
    )
    inner = "<pose>0.25 0 0 0 0 0</pose>" + ray(1)
    model = carrier(sensor("ray", inner, PLUGIN, TAGS, link="mount"), links=links)
    world.add(box("1 1 1", "1 5 0 0 0 0"))
    scans = record(world.add(model, pose=Pose((1.01, 1.0, 0.0))), "scan")
    world.run_until(1)
    # At (1.5, 1.25), looking along y: past the box, which ends at x = 1.5, but not from x = 1.1.
    assert np.isposinf(scans[-1].ranges[0])
    world.models["carrier"].place(Pose((0.6, 1.0, 0.0)))
    world.run_until(2)
    assert scans[-1].ranges[0] == pytest.approx(4.5 - 1.25, abs=1e-6)


def test_resolution_multiplies_the_rays(world):
    scan = one_scan(world, laser(ray(50, (-1.0, 1.0), resolution="2")))
    assert len(scan.ranges) == 100
    assert scan.angle_increment == pytest.approx(2.0 / 99)


def test_a_scan_may_go_clockwise(world):
    world.add(box("1 9 1", "2.5 -1 0 0 0 0", "ahead"))
    ends = (-0.6, 0.4)
    there, back = (
        one_scan(world, laser(ray(5, angles), name=name))
        for name, angles in (("one", ends), ("other", ends[::-1]))
    )
    assert back.ranges == pytest.approx(there.ranges[::-1])
    assert (back.angle_min, back.angle_max, back.angle_increment) == (0.4, -0.6, -0.25)


def test_more_rays_than_one_call_takes(world):
    world.add(thing("<sphere><radius>1</radius></sphere>", "3 0 0 0 0 0"))
    number = 2 * RAYS_AT_A_TIME + 1
    scan = one_scan(world, laser(ray(number, (-0.2, 0.2))))
    angles = np.linspace(-0.2, 0.2, number)
    exact = 3 * np.cos(angles) - np.sqrt(9 * np.cos(angles) ** 2 - 8)
    # How well Bullet knows a ball.
    assert scan.ranges == pytest.approx(exact, abs=2e-3)


def test_no_ray_is_cast_while_nobody_listens(world):
    robot = world.add(laser())
    (device,) = robot.plugins
    cast = []
    device._scanner.measure = lambda random: cast.append(1) or np.ones(360)
    world.run_for(0.2)
    record(robot, "scan")
    world.run_for(0.2)
    assert len(cast) == 2


# Noise


def noisy_scans(deviation, mean=0.0, seed=1, rays=1000, scans=20):
    model = laser(ray(rays, (0.0, 0.0), more=noise(deviation, mean)))
    wall = box("1 1 1", "2.5 0 0 0 0 0")
    samples = readings(model, "scan", 0.1 * scans, [wall], seed=seed)
    return table(samples, "ranges")


def test_noise_is_gaussian_with_the_given_moments():
    errors = (noisy_scans(0.03, mean=0.01) - 2.0).ravel()
    check_normal(errors, 0.03, mean=0.01)
    assert stats.kstest(errors, stats.norm(0.01, 0.03).cdf).pvalue > 1e-3


def test_noise_of_rays_and_scans_is_independent():
    errors = noisy_scans(0.03) - 2.0
    scale = 0.03**2 * math.sqrt(errors[:, 1:].size)
    for lagged in (errors[:, 1:] * errors[:, :-1], errors[1:] * errors[:-1]):
        assert abs(lagged.sum() / scale) < stats.norm.ppf(0.9995)


def noisy_robots(simulation, *places):
    """Robots with noisy lasers before a wall, side by side."""
    simulation.add(box("1 9 1", "2 0 0 0 0 0"))
    model = laser(ray(1, more=noise(0.1)))
    return [simulation.add(model, f"robot{y}", Pose((0, y, 0))) for y in places]


def test_the_noise_depends_on_seed_time_and_robot_and_not_on_who_listened_when():
    with empty(3) as simulation:
        scans = record(*noisy_robots(simulation, 1), "scan")
        simulation.run_for(0.4)
        simulation.reset_simulation()
        simulation.run_for(0.4)
    ranges = [scan.ranges[0] for scan in scans]
    assert ranges[:4] == ranges[4:]
    assert len(set(ranges)) == 4
    with empty(3) as simulation:
        robots = noisy_robots(simulation, 1, -1)
        simulation.run_for(0.2)
        late, other = (record(robot, "scan") for robot in robots)
        simulation.run_for(0.2)
    assert [scan.ranges[0] for scan in late] == ranges[2:4]
    # By more than the rounding of the rays.
    assert abs(late[0].ranges[0] - other[0].ranges[0]) > 1e-3
    with empty(4) as simulation:
        scans = record(*noisy_robots(simulation, 1), "scan")
        simulation.run_for(0.1)
    assert abs(scans[0].ranges[0] - ranges[0]) > 1e-3


def test_noise_stays_within_the_limits_and_off_what_is_out_of_range(world):
    limits = noisy_scans(5.0, scans=1)
    assert (limits.min(), limits.max()) == (0.1, 10.0)
    assert np.isposinf(one_scan(world, laser(ray(9, more=noise(1.0)))).ranges).all()


def test_a_resolution_does_not_round_the_readings(world):
    inner = ray(1).replace("</max></range>", "</max><resolution>0.05</resolution></range>")
    world.add(box("1 1 1", "2.513 0 0 0 0 0"))
    assert one_scan(world, laser(inner)).ranges[0] == pytest.approx(2.013, abs=1e-6)
