import math

import pytest
from noise_checks import check_normal
from sensor_worlds import box, carrier, readings, sensor

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


WALL = box("1 9 9", "2.5 0 0 0 0 0", "wall")


def test_it_reads_the_nearest_of_all_rays():
    # Off the axis: only a ray 0.2 rad up and to the left meets the post.
    post = box("0.01 0.4 0.4", "1.005 0.38 0.38 0 0 0")
    for things, nearest in (((WALL, post), 1.0 / math.cos(0.2) ** 2), ((WALL,), 2.0)):
        (sample,) = readings(sonar(), "sonar", things=things)
        assert sample.range == pytest.approx(nearest, abs=1e-6)


def test_nothing_in_range_reads_the_greatest_one_without_noise():
    samples = readings(sonar(TAGS + "<gaussianNoise>0.5</gaussianNoise>"), "sonar", 0.4)
    assert [sample.range for sample in samples] == [3.0] * 4


def test_noise_is_gaussian_and_stays_within_the_limits():
    def ranges(deviation, seconds):
        noisy = sonar(f"{TAGS}<gaussianNoise>{deviation}</gaussianNoise>", rate=1000)
        samples = readings(noisy, "sonar", seconds, [WALL], seed=3)
        return [sample.range for sample in samples]

    errors = ranges(0.1, 1.0)
    assert len(errors) == 1000
    check_normal(errors, 0.1, mean=2.0)
    wild = ranges(9, 0.1)
    assert (min(wild), max(wild)) == (0.05, 3.0)
