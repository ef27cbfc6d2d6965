"""Lasers with rows of rays in a room of boxes, beside closed forms."""

import math

import numpy as np
import pytest
from noise_checks import check_normal
from sensor_worlds import box, carrier, readings, sensor
from shared import cases

ROWS, COLUMNS = 5, 24
UP = np.radians(15.0)
# The room: walls at x = ±4, y = ±3, z = ±2 m, and the carrier in its middle.
WALLS = np.array((4.0, 3.0, 2.0))
KINDS = {"block": "libgazebo_ros_block_laser.so", "velodyne": "libgazebo_ros_velodyne_laser.so"}
PLAIN = "<topicName>points</topicName><frameName>base</frameName>"


def fan(noise=0.0, farthest=20.0):
    level = f"{COLUMNS}</samples><min_angle>{-math.pi}</min_angle><max_angle>{math.pi - 0.1}"
    slopes = f"{ROWS}</samples><min_angle>{-UP}</min_angle><max_angle>{UP}"
    return (
        f"<update_rate>10</update_rate><ray><scan><horizontal><samples>{level}</max_angle>"
        f"</horizontal><vertical><samples>{slopes}</max_angle></vertical></scan>"
        f"<range><min>0.3</min><max>{farthest}</max></range>"
        f"<noise><type>gaussian</type><stddev>{noise}</stddev></noise></ray>"
    )


ROOM = [
    box(size, f"{place} 0 0 0", place)
    for size, place in (
        ("0.2 10 10", "4.1 0 0"),
        ("0.2 10 10", "-4.1 0 0"),
        ("10 0.2 10", "0 3.1 0"),
        ("10 0.2 10", "0 -3.1 0"),
        ("10 10 0.2", "0 0 2.1"),
        ("10 10 0.2", "0 0 -2.1"),
    )
]


def scans(kind, tags=PLAIN, room=ROOM, ray=None, seconds=0.1):
    model = carrier(sensor("ray", ray or fan(), KINDS[kind], tags))
    return readings(model, "points", seconds, room)


def directions():
    """The unit vectors of the rays, row by row."""
    yaw = np.linspace(-math.pi, math.pi - 0.1, COLUMNS)
    pitch = np.linspace(-UP, UP, ROWS)[:, None]
    level = np.cos(pitch)
    flat = level * np.cos(yaw), level * np.sin(yaw), np.sin(pitch) * np.ones(COLUMNS)
    return np.stack(flat, axis=-1)


def in_the_room():
    """Where the rays meet the walls, row by row."""
    rays = directions()
    return rays * (WALLS / np.maximum(np.abs(rays), 1e-12)).min(axis=-1)[..., None]


def points_of(records):
    return np.stack([records[name] for name in "xyz"], axis=-1)


def test_a_block_has_a_point_for_each_ray():
    (sample,) = scans("block")
    assert (sample.step, sample.frame) == (100, "base")
    assert sample.points == pytest.approx(in_the_room().reshape(-1, 3), abs=2e-5)
    assert (sample.intensities == 0.0).all()


def test_a_ray_without_a_hit_is_at_the_greatest_range_without_noise():
    tags = f"{PLAIN}<gaussianNoise>0.1</gaussianNoise>"
    (sample,) = scans("block", tags, ())
    assert sample.points == pytest.approx(20.0 * directions().reshape(-1, 3), abs=1e-4)
    check_normal(sample.intensities, 0.1)


def test_velodyne_reports_points_ring_by_ring():
    (sample,) = scans("velodyne")
    assert (sample.step, sample.frame) == (100, "base")
    records = sample.records
    assert records.dtype.itemsize == 22
    assert [records.dtype.fields[name][1] for name in ("intensity", "ring", "time")] == [12, 16, 18]
    expected = in_the_room().transpose(1, 0, 2).reshape(1, -1, 3)
    assert points_of(records) == pytest.approx(expected, abs=2e-5)
    assert (records["ring"] == np.tile(np.arange(ROWS), COLUMNS)).all()
    assert (records["intensity"] == 0.0).all()
    assert (records["time"] == 0.0).all()


@pytest.mark.parametrize(
    ("limits", "seen"),
    [
        ("<max_range>3.5</max_range>", lambda far: far < 3.5),
        ("<min_range>3.5</min_range>", lambda far: far > 3.5),
        ("<min_intensity>1</min_intensity>", lambda far: far < 0.0),
    ],
)
def test_points_out_of_range_are_left_out_or_nan(limits, seen):
    far = np.linalg.norm(in_the_room(), axis=-1)
    kept = seen(far)
    (sample,) = scans("velodyne", PLAIN + limits)
    assert sample.records.shape == (1, kept.sum())
    (sample,) = scans("velodyne", f"{PLAIN}{limits}<organize_cloud>true</organize_cloud>")
    assert sample.records.shape == (COLUMNS, ROWS)
    assert (np.isfinite(sample.records["x"]) == kept.T).all()
    assert (np.isfinite(sample.records["intensity"]) == kept.T).all()
    assert (sample.records["ring"] == np.arange(ROWS)).all()


def test_a_near_hit_is_at_the_least_range_in_a_block_and_no_point_of_velodyne():
    near = fan(farthest=20.0).replace("<min>0.3<", "<min>3.5<")
    far = np.linalg.norm(in_the_room(), axis=-1)
    (sample,) = scans("block", ray=near)
    assert np.linalg.norm(sample.points, axis=-1) == pytest.approx(
        np.maximum(far, 3.5).ravel(), abs=2e-5
    )
    (sample,) = scans("velodyne", ray=near)
    assert sample.records.shape == (1, (far > 3.5).sum())


@cases("""
kind, names, topic, frame:
  - [velodyne, {tf_prefix: p, namespace: ''}, points, p/base]
  - [velodyne, {tf_prefix: p, namespace: /r}, /r/points, r/base]
  - [block, {tf_prefix: p, namespace: /r}, /r/points, p/base]
""")
def test_names(kind, names, topic, frame):
    bare = {"block": "/world", "velodyne": "/points"}[kind]
    for tags, expected in ((PLAIN, (topic, frame)), ("", (bare, "world"))):
        model = carrier(sensor("ray", fan(), KINDS[kind], tags))
        (sample,) = readings(model, expected[0], **names)
        assert sample.frame == expected[1]


def test_no_point_of_velodyne_is_out_of_range_after_noise():
    limits = "<min_range>3</min_range><max_range>4</max_range><gaussianNoise>1</gaussianNoise>"
    samples = scans("velodyne", PLAIN + limits, seconds=1.0)
    far = np.concatenate([np.linalg.norm(points_of(s.records), axis=-1).ravel() for s in samples])
    assert len(far) > 100
    assert 3.0 < far.min() < 3.1 < 3.9 < far.max() < 4.0
