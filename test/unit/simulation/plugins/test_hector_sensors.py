"""Sensors of hector_gazebo_plugins, beside closed forms."""

import math

import numpy as np
import pytest
from noise_checks import check_normal
from sensor_worlds import (
    box,
    carrier,
    check_refusal,
    empty,
    held,
    readings,
    record,
    sensor,
    steps,
    table,
)

from bullet_lab.core.pose import Pose

G = 9.8
# Metres in a degree at 45°: of the meridian and of the parallel, by the series of WGS 84.
NORTH_45 = 111132.954 - 559.822 * math.cos(math.pi / 2) + 1.175 * math.cos(math.pi)
EAST_45 = (
    111412.84 * math.cos(math.pi / 4)
    - 93.5 * math.cos(3 * math.pi / 4)
    + 0.118 * math.cos(5 * math.pi / 4)
)


def robot(kind, tags="", name="carrier"):
    plugin = f'<plugin name="{kind}" filename="libhector_gazebo_ros_{kind}.so">{tags}</plugin>'
    return carrier(f"<gazebo>{plugin}</gazebo>", name=name)


def elements(**texts):
    return "".join(f"<{name}>{text}</{name}>" for name, text in texts.items())


def told(kind, topic, seconds, seed=0, pose=None, **tags):
    model = robot(kind, elements(**tags))
    return readings(model, topic, seconds, world=held, seed=seed, pose=pose)


def test_without_errors_the_imu_reads_the_truth():
    pose = Pose.from_rpy((0, 0, 0), (0.3, 0.2, 0.1))
    samples = told("imu", "imu", 0.5, pose=pose, updateRate=100)
    last = samples[-1]
    assert steps(samples) == list(range(10, 501, 10))
    assert Pose(quaternion=last.orientation).rpy() == pytest.approx((0.3, 0.2, 0.1))
    up = Pose(quaternion=last.orientation).inverse().rotate((0.0, 0.0, G))
    assert last.specific_force == pytest.approx(up)
    assert last.angular_velocity == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert last.frame == "base"


def test_offset_scale_and_noise():
    samples = told(
        "imu",
        "imu",
        2.0,
        updateRate=1000,
        accelOffset="0.1 0.2 0.3",
        accelScaleError=1.5,
        rateOffset=0.5,
        accelGaussianNoise="0.01 0.02 0.03",
        yawGaussianNoise=0.5,
    )
    force = table(samples, "specific_force") - (0.1, 0.2, 1.5 * G + 0.3)
    for axis, deviation in enumerate((0.01, 0.02, 0.03)):
        check_normal(force[:, axis], deviation)
    assert table(samples, "angular_velocity") == pytest.approx(0.5, abs=1e-9)
    last = samples[-1]
    assert last.specific_force_variance == pytest.approx((1e-4, 4e-4, 9e-4))
    tilt = np.array((1e-4, 4e-4)) / G**2
    assert last.orientation_variance == pytest.approx((*tilt, 0.25))


def test_the_old_tag_gaussian_noise_counts_for_both():
    sample = told("imu", "imu", 0.01, gaussianNoise=0.1)[0]
    assert sample.specific_force_variance == pytest.approx((0.01,) * 3)
    assert sample.angular_velocity_variance == pytest.approx((0.01,) * 3)


def test_the_biases_of_accelerometer_and_yaw_turn_the_orientation():
    tags = {"updateRate": 50, "accelOffset": "0.098 0 0", "yawOffset": 0.2}
    samples, biases = (told("imu", topic, 0.1, **tags) for topic in ("imu", "imu/bias"))
    # The tilt at which gravity would explain the bias, in the small-angle form of hector.
    turned = (0.0, -2.0 * math.atan(0.5 * 0.01), 0.2)
    assert Pose(quaternion=samples[-1].orientation).rpy() == pytest.approx(turned)
    assert biases[-1].orientation == pytest.approx(samples[-1].orientation)
    assert biases[-1].specific_force == pytest.approx((0.098, 0.0, 0.0))


def test_drift_is_a_gauss_markov_process():
    # 200 correlation times: 3 axes x 4,000 readings.
    tags = {"updateRate": 100, "rateDrift": 0.3, "rateDriftFrequency": 5}
    drift = table(told("imu", "imu", 40.0, **tags), "angular_velocity")
    # The variance of a mean square of n independent pairs is 2/n; a time constant has one.
    assert np.mean(drift**2) == pytest.approx(0.09, rel=4.0 * math.sqrt(2.0 / 600.0))
    for later in (10, 20):
        found = np.mean(drift[:-later] * drift[later:]) / np.mean(drift**2)
        assert found == pytest.approx(math.exp(-0.05 * later), abs=0.15)
    # From one reading to the next: a * drift + sqrt(1 - a^2) * 0.3 * normal.
    kept = math.exp(-0.05)
    steps = (drift[1:] - kept * drift[:-1]) / (0.3 * math.sqrt(1.0 - kept * kept))
    check_normal(steps, 1.0)
    assert np.abs(drift[0]).max() > 0.01


def test_drift_depends_on_seed_and_names_not_on_listeners():
    tags = {"updateRate": 100, "rateDrift": 0.3, "rateDriftFrequency": 1}
    first, other = (
        table(told("imu", "imu", 1.0, seed, **tags), "angular_velocity") for seed in (1, 2)
    )
    assert (first != other).all()
    with held(1) as simulation:
        added = simulation.add(robot("imu", elements(**tags)))
        simulation.run_for(0.5)
        late = record(added, "imu")
        simulation.run_for(0.5)
        assert (table(late, "angular_velocity") == first[50:]).all()
        simulation.reset_simulation()
        late.clear()
        simulation.run_for(1.0)
    assert (table(late, "angular_velocity") == first).all()


def test_a_fix_is_metres_in_degrees_about_the_reference():
    tags = {"referenceLatitude": 45, "referenceLongitude": 9, "referenceAltitude": 100}
    at = Pose((NORTH_45, -EAST_45, 7.0))
    fix = told("gps", "fix", 1.0, pose=at, status=2, service=3, **tags)
    assert steps(fix) == [250, 500, 750, 1000]
    last = fix[-1]
    assert (last.latitude, last.longitude) == pytest.approx((46.0, 10.0), abs=2e-6)
    assert (last.altitude, last.status, last.service) == (107.0, 2, 3)
    assert last.frame == "/world"
    # The x axis points east at a heading of 90°, and then y points north.
    at = Pose((EAST_45, NORTH_45, 0.0))
    last = told("gps", "fix", 0.3, pose=at, referenceHeading=90, **tags)[-1]
    assert (last.latitude, last.longitude) == pytest.approx((46.0, 10.0), abs=2e-6)


def test_errors_of_a_fix_and_velocity():
    tags = {
        "updateRate": 100,
        "referenceLatitude": 45,
        "offset": "1 2 3",
        "gaussianNoise": 0.5,
        "drift": "0 0 4",
        "velocityOffset": "0.1 0 0",
    }
    fix = told("gps", "fix", 20.0, **tags)
    assert fix[0].variances == pytest.approx((0.25, 0.25, 16.25))
    north = (table(fix, "latitude") - 45.0) * NORTH_45
    check_normal(north, 0.5, 1.0)
    west = -(table(fix, "longitude") - 8.9) * EAST_45
    check_normal(west, 0.5, 2.0)
    velocity = told("gps", "fix_velocity", 0.1, **tags)
    assert velocity[-1].vector == pytest.approx((0.1, 0.0, 0.0))


def test_the_velocity_is_along_north_west_and_up():
    with empty() as simulation:
        added = simulation.add(robot("gps", "<referenceHeading>90</referenceHeading>"))
        samples = record(added, "fix_velocity")
        for body in added.bodies.values():
            body.set_velocity((1.0, 2.0, 3.0), (0.0, 0.0, 0.0))
        simulation.run_for(0.25)
    assert samples[0].vector == pytest.approx((2.0, -1.0, 3.0), rel=0.02)


@pytest.mark.parametrize(
    ("kind", "tags", "complaint"),
    [
        ("imu", "<rateDrift>-1</rateDrift>", "<rateDrift>: -1 is negative"),
        ("imu", "<rateOffset>1 2</rateOffset>", "<rateOffset>: '1 2' is not 3 finite numbers"),
        ("imu", "<bodyName>no</bodyName>", "no link 'no'"),
        ("gps", "<referenceLatitude>90</referenceLatitude>", "90 is not within -89.9 … 89.9"),
        ("gps", "<status>5</status>", "<status>: 5 is not within -1 … 2"),
        ("gps", "<warp>5</warp>", "<warp> is not known"),
    ],
)
def test_wrong_tags(kind, tags, complaint):
    check_refusal(robot(kind, tags), complaint)


def test_names_of_older_versions_are_ignored_quietly(caplog):
    with empty() as simulation:
        simulation.add(robot("imu", "<headingDrift>0.005</headingDrift>"))
    assert not caplog.messages


def test_the_drift_of_the_velocity_carries_the_position_away():
    tags = {"driftFrequency": 0, "velocityDrift": 1, "velocityDriftFrequency": 0}
    tags = {"updateRate": 10, "referenceLatitude": 45, **tags}
    speed = told("gps", "fix_velocity", 0.1, **tags)[0].vector[0]
    fix = told("gps", "fix", 5.0, **tags)
    # The drift at a step is that of the velocities before.
    north = (table(fix, "latitude") - 45.0) * NORTH_45
    assert north == pytest.approx(0.1 * speed * np.arange(50), abs=1e-3)
    assert abs(speed) > 0.01


CONE = (
    "<ray><scan><horizontal><samples>5</samples><min_angle>-0.3</min_angle>"
    "<max_angle>0.3</max_angle></horizontal><vertical><samples>3</samples>"
    "<min_angle>-0.1</min_angle><max_angle>0.1</max_angle></vertical></scan>"
    "<range><min>0.1</min><max>4</max></range></ray>"
)


def sonar(tags, wall=1.0, topic="sonar", seconds=0.4):
    """The readings of a sonar in front of a wall."""
    eye = sensor("ray", CONE, "libhector_gazebo_ros_sonar.so", elements(**tags))
    return readings(carrier(eye), topic, seconds, [box("1 9 9", f"{wall + 0.5} 0 0 0 0 0")])


@pytest.mark.parametrize(
    ("tags", "wall", "reading"),
    [
        ({}, 1.0, 1.0),
        ({"offset": 0.2, "scaleError": 1.5}, 1.0, 1.7),
        ({"offset": 9}, 1.0, 4.0),
        ({"offset": -9}, 1.0, 0.1),
        # Without a hit there is no error.
        ({"offset": -0.5}, 5.0, 4.0),
        ({}, 0.05, 0.1),
    ],
)
def test_a_sonar_reads_the_nearest_hit_within_its_range(tags, wall, reading):
    samples = sonar(tags, wall)
    assert [sample.range for sample in samples] == pytest.approx([reading] * 4)


def test_what_a_sonar_says():
    first, *_ = samples = sonar({})
    assert steps(samples) == [100, 200, 300, 400]
    assert (first.frame, first.infrared) == ("/sonar_link", False)
    # The narrower of the two angles.
    assert first.field_of_view == pytest.approx(0.2)
    assert (first.range_min, first.range_max) == (0.1, 4.0)
    named = {"topicName": "front", "frameId": "eye", "updateRate": 20, "gaussianNoise": 0.05}
    many = sonar(named, topic="front", seconds=20.0)
    assert (len(many), many[0].frame) == (400, "eye")
    check_normal(table(many, "range"), 0.05, mean=1.0)
    eye = sensor("camera", "", "libhector_gazebo_ros_sonar.so")
    check_refusal(carrier(eye), 'needs a <sensor type="ray">')
