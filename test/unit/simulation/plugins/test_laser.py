import logging
import math
import re

import numpy as np
import pytest
from conftest import complains
from scipy import stats
from sensor_worlds import box, carrier, empty, record, sensor, thing

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.physics.attached_frame import RAYS_AT_A_TIME, AttachedFrame
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation

PLUGIN = "libgazebo_ros_laser.so"
TAGS = "<topicName>scan</topicName><frameName>laser_link</frameName>"
CAN = "<collision><geometry><cylinder radius='0.05' length='0.1'/></geometry></collision>"


def ray(samples=360, angles=(-math.pi, math.pi), limits=(0.1, 10.0), more="", resolution="1"):
    return (
        f"<ray><scan><horizontal><samples>{samples}</samples><resolution>{resolution}</resolution>"
        f"<min_angle>{angles[0]}</min_angle><max_angle>{angles[1]}</max_angle></horizontal></scan>"
        f"<range><min>{limits[0]}</min><max>{limits[1]}</max></range>{more}</ray>"
    )


def laser(inner=None, rate=10, tags=TAGS, plugin=PLUGIN, kind="ray", **robot):
    inner = ray() if inner is None else inner
    return carrier(
        sensor(kind, f"<update_rate>{rate}</update_rate>{inner}", plugin, tags), **robot
    )


def noise(deviation, mean=0.0):
    return (
        f"<noise><type>gaussian</type><mean>{mean}</mean><stddev>{deviation}</stddev></noise>"
    )


def one_scan(simulation, model, topic="scan", **where):
    scans = record(simulation.add(model, **where), topic)
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
    assert scan.ranges[180] == pytest.approx(2.0, abs=1e-6)
    assert scan.ranges[270] == pytest.approx(1.5, abs=1e-6)


def test_what_a_scan_says(world):
    inner = "<pose>0 0 0.3 0 0 0</pose>" + ray(181, (-1.5, 1.5), (0.2, 7.0))
    scan = one_scan(world, laser(inner, rate=20))
    assert (scan.step, scan.frame) == (100, "laser_link")
    assert (scan.angle_min, scan.angle_max) == (-1.5, 1.5)
    assert scan.angle_increment == pytest.approx(3.0 / 180)
    assert (scan.range_min, scan.range_max) == (0.2, 7.0)
    assert len(scan.ranges) == len(scan.intensities) == 181
    assert not scan.intensities.any()


def test_nothing_within_range_reads_infinity(world):
    world.add(box("1 1 1", "3 0 0 0 0 0"))
    scan = one_scan(world, laser(ray(4, (0.0, 3 * math.pi / 2), (0.1, 2.4))))
    assert np.isposinf(scan.ranges).all()


def test_too_near_reads_minus_infinity_and_not_what_lies_behind(world):
    world.add(box("0.01 1 1", "0.15 0 0 0 0 0", "near"))
    world.add(box("1 9 1", "2.5 0 0 0 0 0", "far"))
    scan = one_scan(world, laser(ray(2, (0.0, math.pi), (0.2, 5.0))))
    assert np.isneginf(scan.ranges[0])
    assert np.isposinf(scan.ranges[1])


def test_the_can_that_the_laser_is_in_is_not_seen(world):
    world.add(box("1 9 1", "2.5 0 0 0 0 0"))
    for limits in ((0.01, 5.0), (0.06, 5.0)):
        scan = one_scan(world, laser(ray(2, (0.0, 0.1), limits), collision=CAN))
        assert scan.ranges[0] == pytest.approx(2.0, abs=1e-6)
        world.remove("carrier")


def test_the_robots_own_parts_are_seen_beyond_the_least_range_only(world):
    mast = (
        "<collision><origin xyz='0.3 0 0'/><geometry><box size='0.1 0.1 1'/></geometry>"
        "</collision>"
    )
    world.add(box("1 9 1", "2.5 0 0 0 0 0"))
    seen = one_scan(world, laser(ray(2, (0.0, math.pi), (0.1, 5.0)), collision=CAN + mast))
    assert seen.ranges[0] == pytest.approx(0.25, abs=1e-6)
    world.remove("carrier")
    unseen = one_scan(world, laser(ray(2, (0.0, math.pi), (0.36, 5.0)), collision=CAN + mast))
    assert unseen.ranges[0] == pytest.approx(2.0, abs=1e-6)


@pytest.mark.parametrize(
    ("geometry", "distance"),
    [
        ("<sphere><radius>0.5</radius></sphere>", 1.5),
        ("<cylinder><radius>0.5</radius><length>1</length></cylinder>", 1.5),
        ("<box><size>1 1 1</size></box>", 1.5),
    ],
)
def test_shapes(world, geometry, distance):
    world.add(thing(geometry, "2 0 0 0 0 0"))
    scan = one_scan(world, laser(ray(1)))
    assert scan.ranges[0] == pytest.approx(distance, abs=1e-6)


def test_the_floor_is_seen_by_a_laser_that_looks_down(world):
    world.add(thing("<plane><normal>0 0 1</normal></plane>", "0 0 -1 0 0 0"))
    scan = one_scan(world, laser(f"<pose>0 0 0 0 {math.pi / 6} 0</pose>" + ray(1)))
    assert scan.ranges[0] == pytest.approx(2.0, abs=1e-6)


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


def test_on_a_link_that_moves(world):
    links = (
        '<link name="arm"><inertial><origin xyz="0.2 0.1 0"/><mass value="1"/>'
        '<inertia ixx="1" iyy="1.5" izz="1" ixz="0.2"/></inertial></link>'
        '<joint name="j" type="continuous"><parent link="base"/><child link="arm"/>'
        '<origin xyz="0 0 0.5"/><axis xyz="0 0 1"/></joint>'
    )
    world.add(box("9 1 9", "0 3 0 0 0 0"))
    model = carrier(sensor("ray", ray(1), PLUGIN, TAGS, link="arm"), links=links)
    robot = world.add(model)
    scans = record(robot, "scan")
    robot.bodies["base"].set_joint("j", 0.5 * math.pi)
    world.run_until(1)
    assert scans[-1].ranges[0] == pytest.approx(2.5, abs=1e-4)


def test_a_single_ray_looks_ahead(world):
    world.add(box("1 1 1", "2 0 0 0 0 0"))
    scan = one_scan(world, laser(ray(1, (-1.0, 1.0))))
    assert scan.ranges.tolist() == pytest.approx([1.5], abs=1e-6)
    assert scan.angle_increment == 0.0


@pytest.mark.parametrize(("samples", "resolution", "rays"), [(100, "0.5", 50), (50, "2", 100)])
def test_resolution_multiplies_the_rays(world, samples, resolution, rays):
    scan = one_scan(world, laser(ray(samples, (-1.0, 1.0), resolution=resolution)))
    assert len(scan.ranges) == rays
    assert scan.angle_increment == pytest.approx(2.0 / (rays - 1))


def test_rows_come_one_after_the_other_from_below(world):
    rows = ray(3, (-0.1, 0.1)).replace(
        "</scan>",
        "<vertical><samples>2</samples><min_angle>-0.5</min_angle><max_angle>0.5</max_angle>"
        "</vertical></scan>",
    )
    world.add(box("0.1 9 5", "1.05 0 2.4 0 0 0"))
    scan = one_scan(world, laser(rows))
    assert len(scan.ranges) == 6
    assert scan.ranges[1] == pytest.approx(np.inf)
    assert scan.ranges[4] == pytest.approx(1.0 / math.cos(0.5), abs=1e-6)


def test_more_rays_than_one_call_takes(world):
    world.add(thing("<sphere><radius>1</radius></sphere>", "3 0 0 0 0 0"))
    number = 2 * RAYS_AT_A_TIME + 1
    scan = one_scan(world, laser(ray(number, (-0.2, 0.2))))
    angles = np.linspace(-0.2, 0.2, number)
    exact = 3 * np.cos(angles) - np.sqrt(9 * np.cos(angles) ** 2 - 8)
    # How well Bullet knows a ball.
    assert scan.ranges == pytest.approx(exact, abs=2e-3)


@pytest.mark.parametrize("rate", [10, 7, 40])
def test_the_mean_rate_is_exact(world, rate):
    scans = record(world.add(laser(ray(1), rate=rate)), "scan")
    world.run_for(20.0)
    assert len(scans) == 20 * rate
    assert scans[-1].step == 20_000


def test_no_update_rate_means_every_step(world):
    scans = record(world.add(laser(ray(1), rate=0)), "scan")
    world.run_for(0.05)
    assert [scan.step for scan in scans] == list(range(1, 51))


def test_no_ray_is_cast_while_nobody_listens(world):
    robot = world.add(laser())
    (device,) = robot.plugins
    cast = []
    device._scanner.measure = lambda random: cast.append(1) or np.ones(360)
    world.run_for(0.2)
    assert not cast
    record(robot, "scan")
    world.run_for(0.2)
    assert len(cast) == 2


def test_rays_may_be_cast_between_other_limits_and_some_of_them_alone(world):
    world.add(box("1 1 1", "2 0 0 0 0 0"))
    body = world.add(carrier()).bodies["base"]
    rays = AttachedFrame(body, "base").rays(np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]))
    assert rays.cast(0.0, 5.0)[0] == pytest.approx([5.0, 1.5])
    assert rays.cast(0.0, 1.0)[0] == pytest.approx([1.0, 1.0])
    assert rays.cast(0.5, 3.0)[0] == pytest.approx([3.0, 1.5])
    some = rays.select(np.array([False, True]))
    assert len(some) == 1
    distances, bodies = some.cast(0.5, 3.0)
    assert distances == pytest.approx([1.5])
    assert bodies.tolist() == [world.models["thing"].bodies["l"].unique_id]


# Noise


def noisy_scans(deviation, mean=0.0, seed=1, rays=1000, scans=20, more="", distance=2.0):
    with empty(seed) as simulation:
        simulation.add(thing(f"<sphere><radius>{5 - distance}</radius></sphere>", "5 0 0 0 0 0"))
        inner = ray(rays, (0.0, 0.0), (0.1, 10.0), noise(deviation, mean) + more)
        samples = record(simulation.add(laser(inner)), "scan")
        simulation.run_for(0.1 * scans)
        return np.array([scan.ranges for scan in samples])


def test_noise_is_gaussian_with_the_given_moments():
    errors = (noisy_scans(0.03, mean=0.01) - 2.0).ravel()
    number = len(errors)
    # Mean and variance against their own distributions, to 99.9 %.
    z = (errors.mean() - 0.01) / (0.03 / math.sqrt(number))
    assert abs(z) < stats.norm.ppf(0.9995)
    chi = number * np.mean((errors - 0.01) ** 2) / 0.03**2
    assert stats.chi2.ppf(0.0005, number) < chi < stats.chi2.ppf(0.9995, number)
    assert stats.kstest(errors, stats.norm(0.01, 0.03).cdf).pvalue > 1e-3


def test_noise_of_rays_and_scans_is_independent():
    errors = noisy_scans(0.03) - 2.0
    scale = 0.03**2 * math.sqrt(errors[:, 1:].size)
    for lagged in (errors[:, 1:] * errors[:, :-1], errors[1:] * errors[:-1]):
        assert abs(lagged.sum() / scale) < stats.norm.ppf(0.9995)


def test_the_seed_decides_the_noise():
    assert (noisy_scans(0.03, seed=4) == noisy_scans(0.03, seed=4)).all()
    assert not (noisy_scans(0.03, seed=4) == noisy_scans(0.03, seed=5)).any()


def test_the_noise_depends_on_the_time_and_not_on_who_listened_when():
    with empty(3) as simulation:
        simulation.add(box("1 1 1", "2 0 0 0 0 0"))
        robot = simulation.add(laser(ray(1, more=noise(0.1))))
        first = record(robot, "scan")
        simulation.run_for(0.4)
        simulation.reset_simulation()
        again = record(robot, "scan")
        simulation.run_for(0.4)
        assert [s.ranges[0] for s in again] == [s.ranges[0] for s in first[:4]]
        assert len({s.ranges[0] for s in again}) == 4
    with empty(3) as simulation:
        simulation.add(box("1 1 1", "2 0 0 0 0 0"))
        robot = simulation.add(laser(ray(1, more=noise(0.1))))
        simulation.add(laser(ray(1, more=noise(0.1))), "another", Pose((0, 3, 0)))
        simulation.run_for(0.2)
        late = record(robot, "scan")
        simulation.run_for(0.2)
        assert [s.ranges[0] for s in late] == [s.ranges[0] for s in first[2:4]]


def test_two_robots_have_noise_of_their_own():
    with empty(3) as simulation:
        simulation.add(box("1 9 1", "2 0 0 0 0 0"))
        scans = [
            record(simulation.add(laser(ray(1, more=noise(0.1))), name, Pose((0, y, 0))), "scan")
            for name, y in (("one", -1), ("two", 1))
        ]
        simulation.run_for(0.1)
    assert scans[0][0].step == scans[1][0].step
    # By more than the rounding of the rays.
    assert abs(scans[0][0].ranges[0] - scans[1][0].ranges[0]) > 1e-3


def test_noise_stays_within_the_limits_and_off_what_is_out_of_range():
    limits = noisy_scans(5.0)
    assert limits.min() == 0.1
    assert limits.max() == 10.0
    with empty() as simulation:
        scan = one_scan(simulation, laser(ray(9, more=noise(1.0))))
        assert np.isposinf(scan.ranges).all()


def test_readings_are_multiples_of_the_resolution():
    inner = ray(1).replace("</max></range>", "</max><resolution>0.05</resolution></range>")
    with empty() as simulation:
        simulation.add(box("1 1 1", "2.513 0 0 0 0 0"))
        assert one_scan(simulation, laser(inner)).ranges[0] == pytest.approx(2.0, abs=1e-12)


# Names, refusals


@pytest.mark.parametrize(
    ("plugin", "kind"),
    [
        ("libgazebo_ros_laser", "ray"),
        ("libgazebo_ros_gpu_laser.so", "gpu_ray"),
        ("libgazebo_ros_gpu_laser", "ray"),
    ],
)
def test_names_of_the_plugin(world, plugin, kind):
    one_scan(world, laser(plugin=plugin, kind=kind))


def test_defaults_of_topic_and_frame(world):
    scan = one_scan(world, laser(tags=""), "/world")
    assert scan.frame == "world"


def test_namespace_and_prefix(world):
    robot = world.add(laser(), "one", namespace="one", tf_prefix="one_tf")
    scans = record(robot, "/one/scan")
    world.run_for(0.1)
    assert scans[0].frame == "one_tf/laser_link"


def test_an_absolute_frame_keeps_its_name(world):
    tags = "<topicName>/scan</topicName><frameName>/laser_link</frameName>"
    robot = world.add(laser(tags=tags), "one", namespace="one", tf_prefix="one_tf")
    scans = record(robot, "/scan")
    world.run_for(0.1)
    assert scans[0].frame == "laser_link"


def in_range(tag, value):
    return ray().replace(f"<{tag}>", f"<{tag}>{value}<!--").replace(f"</{tag}>", f"--></{tag}>")


@pytest.mark.parametrize(
    ("inner", "message"),
    [
        (in_range("samples", "0"), "<samples>: 0 is not a whole number in 1"),
        (in_range("samples", "2.5"), "<samples>: 2.5 is not a whole number"),
        (in_range("samples", "many"), "<samples>: 'many' is not a finite number"),
        (in_range("samples", "1000000000"), "<samples>"),
        (in_range("resolution", "1e9"), "<resolution>"),
        (in_range("resolution", "-1"), "<resolution>"),
        (in_range("max", "0.05"), "<max>: 0.05 is not beyond <min>"),
        (in_range("max", "nan"), "<max>: 'nan' is not a finite number"),
        (in_range("max", "inf"), "<max>: 'inf' is not a finite number"),
        (in_range("min", "-1"), "<min>: -1 is negative"),
        (in_range("max_angle", "-4"), "<max_angle>: -4 is less than <min_angle>"),
        (ray(more=noise(-1)), "<stddev>: -1 is negative"),
        ("<ray/>", "<max>: 0 is not beyond <min>"),
        ("<pose>0 0 0</pose>" + ray(), "<pose>: '0 0 0' is not 6 finite numbers"),
    ],
)
def test_refusals(world, inner, message):
    with complains(f"model 'carrier': plugin 'the_sensor_plugin'.*{re.escape(message)}"):
        world.add(laser(inner))


def test_a_rate_that_cannot_be_kept_is_refused(world):
    with complains("<update_rate>: a rate of 2000 Hz"):
        world.add(laser(rate=2000))


@pytest.mark.parametrize("kind", ["camera", ""])
def test_a_plugin_outside_a_ray_sensor_is_refused(world, kind):
    with complains('needs a <sensor type="ray">'):
        world.add(laser(kind=kind))
    world.remove("carrier")
    alone = f'<gazebo><plugin name="p" filename="{PLUGIN}"/></gazebo>'
    with complains('needs a <sensor type="ray">'):
        world.add(carrier(alone))


def test_noise_of_another_kind_is_reported(world, caplog):
    odd = "<noise><type>pink</type></noise>"
    with caplog.at_level(logging.WARNING):
        world.add(laser(ray(more=odd)))
    (warning,) = caplog.messages
    assert "'pink' is not simulated" in warning


# The block robot


def test_the_block_robot_sees_the_beacons():
    with Simulation.of("package://bullet_lab/worlds/beacons.world") as simulation:
        robot = simulation.spawn("package://bullet_lab/urdf/block_robot.urdf")
        scans = record(robot, "scan")
        simulation.run_for(1.0)
        assert [scan.step for scan in scans] == list(range(100, 1001, 100))
        scan = scans[-1]
        assert (len(scan.ranges), scan.frame) == (360, "laser_link")
        assert scan.angle_increment == pytest.approx(math.radians(1.0), abs=1e-12)
        seen = np.flatnonzero(np.isfinite(scan.ranges))
        bearings = scan.angle_min + scan.angle_increment * seen
        points = scan.ranges[seen, None] * np.stack((np.cos(bearings), np.sin(bearings)), axis=1)
        beacons = [m.pose().position[:2] for n, m in simulation.models.items() if "beacon" in n]
        gaps = np.linalg.norm(points[:, None] - np.array(beacons)[None], axis=2)
        assert len(beacons) == 3
        assert (gaps.min(axis=0) < 0.3).all()
        assert (gaps.min(axis=1) < 0.3).all()


def test_the_laser_of_the_block_robot_changes_nothing_of_its_drive():
    def end(listening):
        with Simulation.of("package://bullet_lab/worlds/empty.world") as simulation:
            robot = simulation.spawn("package://bullet_lab/urdf/block_robot.urdf")
            if listening:
                record(robot, "scan")
            robot.command("cmd_vel", PlanarCommand(vx=0.2, wz=0.3))
            simulation.run_for(3.0)
            return robot.pose()

    assert end(True) == end(False)
