import math

import pytest
from noise_checks import check_normal
from sensor_worlds import box, carrier, empty, record, sensor
from shared import complains

FAN = (
    "<update_rate>{rate}</update_rate><ray><scan>"
    "<horizontal><samples>11</samples><min_angle>-0.2</min_angle><max_angle>0.2</max_angle>"
    "</horizontal><vertical><samples>11</samples><min_angle>-0.2</min_angle>"
    "<max_angle>0.2</max_angle></vertical></scan>"
    "<range><min>0.05</min><max>3.0</max></range></ray>"
)
TAGS = "<topicName>sonar</topicName><frameName>sonar_link</frameName>"


def sonar(tags=TAGS, rate=10):
    return carrier(sensor("ray", FAN.format(rate=rate), "libgazebo_ros_range.so", tags))


def readings(model, *things, seconds=0.1, seed=0, topic="sonar"):
    with empty(seed) as simulation:
        for thing in things:
            simulation.add(thing)
        samples = record(simulation.add(model), topic)
        simulation.run_for(seconds)
    return samples


def test_it_reads_the_nearest_of_all_rays():
    # Off the axis: only a ray 0.2 rad up and to the left meets the post.
    post = box("0.01 0.4 0.4", "1.005 0.38 0.38 0 0 0")
    (sample,) = readings(sonar(), box("1 9 9", "2.5 0 0 0 0 0", "wall"), post)
    edge = 1.0 / math.cos(0.2) ** 2
    assert sample.range == pytest.approx(edge, abs=1e-6)
    (clear,) = readings(sonar(), box("1 9 9", "2.5 0 0 0 0 0", "wall"))
    assert clear.range == pytest.approx(2.0, abs=1e-6)


def test_what_a_reading_says():
    (sample,) = readings(sonar(TAGS + "<fov>0.4</fov>"))
    assert (sample.step, sample.frame) == (100, "sonar_link")
    assert (sample.range_min, sample.range_max, sample.field_of_view) == (0.05, 3.0, 0.4)
    assert not sample.infrared
    (other,) = readings(sonar(TAGS + "<radiation>infrared</radiation>"))
    assert other.infrared
    assert other.field_of_view == 0.05


def test_nothing_in_range_reads_the_greatest_one_without_noise():
    samples = readings(sonar(TAGS + "<gaussianNoise>0.5</gaussianNoise>"), seconds=0.4)
    assert [sample.range for sample in samples] == [3.0] * 4


def test_noise_is_gaussian_and_stays_within_the_limits():
    wall = box("1 9 9", "2 0 0 0 0 0")
    noisy = sonar(TAGS + "<gaussianNoise>0.1</gaussianNoise>", rate=1000)
    errors = [sample.range - 1.5 for sample in readings(noisy, wall, seconds=1.0, seed=3)]
    assert len(errors) == 1000
    check_normal(errors, 0.1)
    wild = sonar(TAGS + "<gaussianNoise>9</gaussianNoise>", rate=1000)
    ranges = [sample.range for sample in readings(wild, wall)]
    assert (min(ranges), max(ranges)) == (0.05, 3.0)


@pytest.mark.parametrize(("of_plugin", "of_sensor", "rate"), [(0, 20, 20), (5, 20, 5), (50, 7, 7)])
def test_rates(of_plugin, of_sensor, rate):
    model = sonar(TAGS + f"<updateRate>{of_plugin}</updateRate>", rate=of_sensor)
    assert len(readings(model, seconds=1.0)) == rate


def test_defaults():
    (sample,) = readings(sonar(""), topic="/range")
    assert (sample.frame, sample.field_of_view, sample.infrared) == ("world", 0.05, False)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (lambda: sonar(TAGS + "<gaussianNoise>-1</gaussianNoise>"), "<gaussianNoise>: -1"),
        (
            lambda: carrier(sensor("imu", "", "libgazebo_ros_range.so", TAGS)),
            'needs a <sensor type="ray">, not "imu"',
        ),
    ],
)
def test_refusals(model, message):
    with empty() as simulation, complains(message):
        simulation.add(model())
