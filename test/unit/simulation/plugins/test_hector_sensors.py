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
from shared import cases

from bullet_lab.core.pose import Pose

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


def test_the_old_tag_gaussian_noise_counts_for_both():
    sample = told("imu", "imu", 0.01, gaussianNoise=0.1)[0]
    assert sample.specific_force_variance == pytest.approx((0.01,) * 3)
    assert sample.angular_velocity_variance == pytest.approx((0.01,) * 3)


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


def test_the_velocity_is_along_north_west_and_up():
    with empty() as simulation:
        added = simulation.add(robot("gps", "<referenceHeading>90</referenceHeading>"))
        samples = record(added, "fix_velocity")
        for body in added.bodies.values():
            body.set_velocity((1.0, 2.0, 3.0), (0.0, 0.0, 0.0))
        simulation.run_for(0.25)
    assert samples[0].vector == pytest.approx((2.0, -1.0, 3.0), rel=0.02)


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


@cases("""
tags, wall, reading:
  - [{}, 1.0, 1.0]
  - [{offset: 0.2, scaleError: 1.5}, 1.0, 1.7]
  - [{offset: 9}, 1.0, 4.0]
  - [{offset: -9}, 1.0, 0.1]
  # Without a hit there is no error.
  - [{offset: -0.5}, 5.0, 4.0]
  - [{}, 0.05, 0.1]
""")
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
