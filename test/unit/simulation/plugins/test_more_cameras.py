"""Stereo pairs, cameras with triggers, wide angles and formats, beside closed forms."""

import math

import cv2
import numpy as np
import pytest
from picture_worlds import simulation_of, thing
from sensor_worlds import carrier, record, saved_again, sensor, steps
from shared import cases, complains

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.samples import Trigger
from bullet_lab.simulation.world.description import Box, Sphere

RED = (1.0, 0.0, 0.0, 1.0)
IMAGE = "<image><width>{}</width><height>{}</height><format>{}</format></image>"
FOV = 1.2
SIDES = ("left", "right")
FOCAL = 160 / math.tan(0.5 * FOV)
BASELINE = 0.12
NAME = "<cameraName>eyes</cameraName><frameName>lens</frameName>"
LIBRARY = "libgazebo_ros_{}.so"


def camera(name="", pose="", width=320, height=240, format="R8G8B8", fov=FOV, more=""):
    image = IMAGE.format(width, height, format)
    place = f"<pose>{pose}</pose>" if pose else ""
    return (
        f'<camera name="{name}">{place}<horizontal_fov>{fov}</horizontal_fov>{image}'
        f"<clip><near>0.05</near><far>50</far></clip>{more}</camera>"
    )


def pair(kind="multicamera", tags=""):
    heads = camera("left", "0 0.06 0 0 0 0") + camera("my_right", "0 -0.06 0 0 0 0")
    rate = "<update_rate>20</update_rate><pose>0.1 0 0 0 0 0</pose>"
    tags = f"{NAME}<hackBaseline>{BASELINE}</hackBaseline>{tags}"
    return carrier(sensor("multicamera", rate + heads, LIBRARY.format(kind), tags))


def single(kind="camera", sensor_kind="camera", tags=NAME, **settings):
    inner = f"<update_rate>20</update_rate>{camera(**settings)}"
    return carrier(sensor(sensor_kind, inner, LIBRARY.format(kind), tags))


def blobs(pixels):
    """The centroids (column, row) of the red patches of a picture."""
    red = (pixels[..., 0].astype(int) - pixels[..., 2] > 60).astype(np.uint8)
    count, _, _, centres = cv2.connectedComponentsWithStats(red)
    return centres[1:count]


def floating(*things):
    return simulation_of(*things, gravity=(0.0, 0.0, 0.0))


def sent(model, *topics, things=(), seconds=0.05):
    """What a robot among things sends on some of its cameras' topics, a list for each."""
    with floating(*things) as simulation:
        robot = simulation.add(model)
        samples = [record(robot, f"eyes/{topic}") for topic in topics]
        simulation.run_for(seconds)
    return samples


TARGET = thing("target", Box((0.002, 0.2, 0.2)), Pose((2.1, 0.1, 0.05)), RED)


def test_a_pair_sees_the_disparity_of_its_baseline():
    topics = [f"{side}/{name}" for name in ("image_raw", "camera_info") for side in SIDES]
    found = sent(pair(), *topics, things=[TARGET], seconds=0.1)
    for samples in found:
        assert [(sample.step, sample.frame) for sample in samples] == [(50, "lens"), (100, "lens")]
    ((left, row),), ((right, other),) = (blobs(samples[0].pixels) for samples in found[:2])
    # The front of the target is 1.999 m ahead of the cameras, which are 0.1 m ahead of the link.
    assert left - right == pytest.approx(FOCAL * BASELINE / 1.999, abs=0.5)
    assert (row, other) == pytest.approx((119.5 - FOCAL * 0.05 / 1.999,) * 2, abs=0.5)
    assert left == pytest.approx(159.5 - FOCAL * 0.04 / 1.999, abs=0.5)
    assert [samples[0].baseline for samples in found[2:]] == [0.0, BASELINE]


def test_each_head_has_noise_of_its_own():
    noise = "<noise><type>gaussian</type><stddev>0.1</stddev></noise>"
    heads = camera("left", more=noise) + camera("right", more=noise)
    robot = carrier(sensor("multicamera", heads, LIBRARY.format("multicamera"), NAME))
    (left,), (right,) = sent(robot, *(f"{side}/image_raw" for side in SIDES), seconds=0.04)
    assert (left.pixels != right.pixels).mean() > 0.5


def test_a_saved_pair_is_a_pair_again(tmp_path):
    def topics(robot):
        return [output.topic for plugin in robot.plugins for output in plugin.outputs]

    with floating() as simulation:
        expected = topics(simulation.add(pair()))
        with saved_again(simulation, tmp_path) as again:
            assert topics(again.models["carrier"]) == expected
    assert len(expected) == 4


def test_a_camera_of_another_name_is_left_out():
    robot = carrier(sensor("multicamera", camera("top"), LIBRARY.format("multicamera"), NAME))
    with floating() as simulation, complains("camera 'top' is left out"):
        assert simulation.add(robot).plugins == ()


@pytest.mark.parametrize(
    ("robot", "trigger", "image"),
    [
        (single("triggered_camera"), "eyes/image_trigger", "eyes/image_raw"),
        (
            pair("triggered_multicamera", "<triggerTopicName>now</triggerTopicName>"),
            "eyes/right/now",
            "eyes/right/image_raw",
        ),
    ],
)
def test_a_picture_for_each_trigger(robot, trigger, image):
    with floating(TARGET) as simulation:
        robot = simulation.add(robot)
        pictures = record(robot, image)
        infos = record(robot, image.replace("image_raw", "camera_info"))
        simulation.run_for(0.5)
        assert pictures == []
        robot.command(trigger, Trigger())
        simulation.run_for(0.1)
        robot.command(trigger, Trigger())
        robot.command(trigger, Trigger())
        simulation.run_for(0.1)
        assert steps(pictures) == [501, 601, 602]
        assert steps(infos) == [501, 601, 602]
        assert 1.0 / robot.plugins[0].schedule.period == 0.0
        robot.plugins[0].set_rate(30.0, simulation.step)
        simulation.run_for(0.1)
        assert len(pictures) == 3
        robot.command(trigger, Trigger())
        simulation.reset_simulation()
        simulation.run_for(0.1)
    assert len(pictures) == 3
    assert len(blobs(pictures[0].pixels)) == 1


def radius(kind, angle, fov, c2=1.0, c3=0.0):
    """The distance from the middle in half widths, by the formulas of the lenses."""

    def raw(a):
        return {
            "gnomonical": math.tan(a) if a < 1.57 else math.inf,
            "stereographic": 2.0 * math.tan(0.5 * a),
            "equidistant": a,
            "equisolid_angle": 2.0 * math.sin(0.5 * a),
            "orthographic": math.sin(a),
            "custom": math.tan(a / c2 + c3),
        }[kind]

    return raw(angle) / raw(0.5 * fov)


WIDTH = 401


@cases("""
kind, fov, angles, cutoff, more:
  - [gnomonical, 2.4, [0.1, 0.7, 1.0], 1.57, '']
  - [stereographic, 3.141592653589793, [0.1, 0.7, 0.9, 1.4], 1.57, '']
  - [equidistant, 3.141592653589793, [0.1, 0.75, 0.9, 1.4], 1.57, '']
  - [equisolid_angle, 4.0, [0.2, 0.9, 1.8], 2.0, '']
  - [orthographic, 2.8, [0.1, 0.7, 1.2], 1.57, '']
  - [custom, 6.283185307179586, [0.2, 0.9, 1.6, 2.3, 2.6], 3.1415,
     <custom_function><c1>1.05</c1><c2>4</c2><f>1</f><fun>tan</fun></custom_function>]
""")
def test_a_point_is_where_the_lens_function_maps_it(kind, fov, angles, cutoff, more):
    lens = f"<lens><type>{kind}</type>{more}<cutoff_angle>{cutoff}</cutoff_angle></lens>"
    robot = single("camera", "wideanglecamera", width=WIDTH, height=WIDTH, fov=fov, more=lens)
    middle, balls, expected = 0.5 * (WIDTH - 1), [], []
    for number, angle in enumerate(angles):
        for turn in np.array((0.3, 2.1, 4.0)) + 0.4 * number:
            around = np.array((math.cos(turn), math.sin(turn)))
            place = (4.0 * math.cos(angle), *(-4.0 * math.sin(angle) * around).tolist())
            balls.append(thing(f"ball{len(balls)}", Sphere(0.1), Pose(place), RED))
            expected.append(middle + 0.5 * WIDTH * radius(kind, angle, fov, 4.0) * around)
    ((picture,),) = sent(robot, "image_raw", things=balls)
    found = blobs(picture.pixels)
    assert len(found) == len(expected)
    for point in expected:
        assert np.linalg.norm(found - point, axis=1).min() < 0.5
    corner = radius(kind, cutoff, fov, 4.0) * (middle + 0.5)
    if corner < middle * math.sqrt(2.0):
        assert (picture.pixels[0, 0] == 0).all()


def picture_in(format):
    back = thing("back", Box((0.1, 9.0, 9.0)), Pose((4.0, 0.0, 0.0)), (0.2, 0.5, 0.8, 1.0))
    return sent(single(format=format), "image_raw", things=[TARGET, back])[0][0]


@cases("pattern: [RGGB, BGGR, GBRG, GRBG]")
def test_bayer_has_one_colour_in_a_pixel(pattern):
    colours, mosaic = picture_in("R8G8B8").pixels, picture_in(f"BAYER_{pattern}8")
    assert mosaic.encoding == f"bayer_{pattern.lower()}8"
    for place, letter in enumerate(pattern):
        row, column = divmod(place, 2)
        seen = colours[row::2, column::2, "RGB".index(letter)]
        assert (mosaic.pixels[row::2, column::2] == seen).all()
    assert len(np.unique(mosaic.pixels)) > 2


@cases("""
format, encoding, plain, factor:
  - [L16, mono16, L8, 257]
  - [R16G16B16, rgb16, R8G8B8, 257]
  - [RGB_INT8, rgb8, R8G8B8, 1]
  - [L_INT8, mono8, L8, 1]
""")
def test_other_formats(format, encoding, plain, factor):
    found, eight = picture_in(format), picture_in(plain)
    assert found.encoding == encoding
    assert found.pixels.dtype == (np.uint16 if factor > 1 else np.uint8)
    assert (found.pixels == factor * eight.pixels.astype(int)).all()
