import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from picture_worlds import checkers, plate, simulation_of, thing, write_plate
from sensor_worlds import record, steps
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.camera import Camera, CameraSettings
from bullet_lab.simulation.rendering import RendererError
from bullet_lab.simulation.world.description import Box
from bullet_lab.simulation.world.urdf import read_urdf

SENSOR = """
  <update_rate>30</update_rate>
  {pose}
  <camera name="eye">
    <horizontal_fov>1.2</horizontal_fov>
    <image><width>160</width><height>120</height><format>{format}</format></image>
    <clip><near>0.05</near><far>50</far></clip>
    {more}
  </camera>
"""
ROBOT = """<robot name="robot">
  <link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>
  </link>
  <link name="mast"/>
  <joint name="up" type="fixed"><parent link="base"/><child link="mast"/>
    <origin xyz="0.1 0 0.5" rpy="0 0 0.3"/></joint>
  <gazebo reference="mast"><sensor type="camera" name="s">{sensor}
    <plugin filename="libgazebo_ros_camera.so" name="c">{tags}</plugin></sensor></gazebo>
</robot>"""
WALL = thing("wall", Box((0.2, 20.0, 20.0)), Pose((3.0, 0, 0)), (0.5, 0.4, 0.3, 1.0))
LEVELS = (128, 102, 76)


def add(simulation, tags="", pose="", format="R8G8B8", more=""):
    """Add the robot; return it and its camera."""
    sensor = SENSOR.format(pose=pose, format=format, more=more)
    robot = simulation.add(read_urdf(ROBOT.format(sensor=sensor, tags=tags), "robot"))
    (camera,) = [device for device in robot.plugins if isinstance(device, Camera)]
    return robot, camera


@pytest.fixture
def wall():
    with simulation_of(WALL, gravity=(0.0, 0.0, 0.0)) as simulation:
        yield simulation


def noise(stddev, mean=0.0):
    inner = f"<type>gaussian</type><mean>{mean}</mean><stddev>{stddev}</stddev>"
    return f"<noise>{inner}</noise>"


def test_it_looks_along_the_x_axis_of_its_sensor(wall):
    tags = "<frameName>anything</frameName>"
    _, camera = add(wall, pose="<pose>0.2 0 -0.1 0 0.1 0.4</pose>", tags=tags)
    mast = Pose.from_rpy((0.1, 0, 0.5), (0, 0, 0.3))
    wanted = mast * Pose.from_rpy((0.2, 0, -0.1), (0, 0.1, 0.4))
    assert camera.pose().position == pytest.approx(wanted.position)
    assert camera.pose().rpy() == pytest.approx(wanted.rpy())


def test_a_spot_is_seen_where_the_geometry_has_it(tmp_path):
    spot = thing("spot", Box((0.04, 0.04, 0.04)), Pose((2.0, 0.9, 0.8)))
    black = {"background": (0.0, 0.0, 0.0, 1.0), "gravity": (0.0, 0.0, 0.0)}
    with simulation_of(spot, **black) as simulation:
        robot, camera = add(simulation, more="<distortion><k1>-0.2</k1><k2>0.05</k2></distortion>")
        assert camera.camera.distortion == (-0.2, 0.05, 0, 0, 0)
        for yaw in (0.2, -0.1):
            robot.place(Pose.from_rpy((0.0, 0.1, 0.1), (0.0, 0.0, yaw)))
            moments = cv2.moments(cv2.cvtColor(camera.take(0), cv2.COLOR_RGB2GRAY))
            seen = moments["m10"] / moments["m00"], moments["m01"] / moments["m00"]
            x, y, z = (camera.pose().inverse() * Pose((2.0, 0.9, 0.8))).position
            assert seen == pytest.approx(camera.camera.project([[-y, -z, x]])[0], abs=0.6)


def test_another_rate_from_now_on(wall):
    robot, camera = add(wall)
    infos = record(robot, "camera_info")
    camera.set_rate(5.0, wall.step)
    wall.run_for(0.4)
    assert steps(infos) == [200, 400]


def test_nothing_is_drawn_for_nobody(wall, monkeypatch):
    robot, camera = add(wall)
    drawn = []
    monkeypatch.setattr(camera, "take", drawn.append)
    wall.run_for(0.2)
    infos = record(robot, "camera_info")
    wall.run_for(0.2)
    assert infos
    assert not drawn
    wants = [False]
    camera.image.connect(lambda sample: None, lambda: wants[0])
    wall.run_for(0.1)
    assert not drawn
    wants[0] = True
    wall.run_for(0.1)
    assert len(drawn) == 3


@cases("""
name, encoding, levels:
  - [B8G8R8, bgr8, [76, 102, 128]]
  - [L8, mono8, 106.81]
""")
def test_formats(wall, name, encoding, levels):
    robot, _ = add(wall, format=name)
    images = record(robot, "image_raw")
    wall.run_for(0.05)
    assert images[0].encoding == encoding
    assert images[0].pixels.shape[:2] == (120, 160)
    assert images[0].pixels[60, 80] == pytest.approx(levels, abs=1)


def test_noise_has_the_deviation_and_mean_that_are_asked_for(wall):
    _, camera = add(wall, more=noise(0.04, 0.02))
    pictures = np.array([camera.take(step) for step in range(5)], dtype=float)
    off = pictures - np.array(LEVELS)
    assert off.mean() == pytest.approx(255 * 0.02, abs=0.6)
    assert off.std() == pytest.approx(255 * 0.04, rel=0.01)
    # Normal: so much lies within one, two and three deviations.
    flat = (off - off.mean()) / off.std()
    within = [(np.abs(flat) < k).mean() for k in (1, 2, 3)]
    assert within == pytest.approx([0.683, 0.954, 0.997], abs=0.03)
    # Independent between neighbours, channels and pictures.
    pairs = [(flat[:, :, 1:], flat[:, :, :-1]), (flat[..., 0], flat[..., 1]), (flat[1:], flat[:-1])]
    for one, other in pairs:
        assert np.mean(one * other) == pytest.approx(0.0, abs=0.015)


def test_noise_stops_at_black_and_white(wall):
    _, camera = add(wall, more=noise(0.0, 0.9))
    assert camera.take(0).min() == 255
    camera.settings = replace(camera.settings, noise_mean=-0.9)
    assert camera.take(0).max() == 0


def picture(seed, step, listened=()):
    with simulation_of(WALL) as simulation:
        simulation.seed = seed
        _, camera = add(simulation, more=noise(0.02))
        for early in listened:
            camera.take(early)
        return camera.take(step).tobytes()


def test_noise_follows_from_seed_and_time_only():
    assert picture(1, 33) == picture(1, 33, listened=(5, 66))
    assert picture(1, 33) != picture(2, 33)
    assert picture(1, 33) != picture(1, 34)


def pictures_of_checkers(folder, blurred, **changed):
    """Two pictures of a checkerboard, one with a blur and one after a change of the settings."""
    board = plate(write_plate(folder, "board", checkers(8, 8), 2.0, 2.0), Pose((1.5, 0.4, 0.6)))
    with simulation_of(board, gravity=(0.0, 0.0, 0.0)) as simulation:
        _, camera = add(simulation, tags=f"<blur>{blurred}</blur><exposure>0.5</exposure>")
        first = camera.take(0).astype(int)
        camera.settings = replace(camera.settings, **changed)
        return first, camera.take(0).astype(int)


def test_blur_and_exposure_at_any_time(tmp_path):
    sharp, soft = pictures_of_checkers(tmp_path, 0.0, blur=2.0)
    assert sharp[60, 40:120].max() == pytest.approx(118, abs=2)
    steepest = [np.abs(np.diff(p[60, 40:120, 0])).max() for p in (sharp, soft)]
    # Of an edge with a normal blur: height / (sigma sqrt(2 pi)).
    assert steepest[0] > 60
    assert steepest[1] == pytest.approx(107 / (2.0 * math.sqrt(2 * math.pi)), rel=0.15)


def test_a_lens_blurs_before_white_is_cut_off(tmp_path):
    dark, bright = pictures_of_checkers(tmp_path, 1.5, exposure=2.0)
    assert (bright == 255).mean() > 0.2
    # Levels were rounded before they were multiplied.
    assert np.abs(bright - np.minimum(4 * dark, 255)).max() <= 5


def test_a_setting_that_is_not_finite_is_refused():
    with pytest.raises(RendererError, match="not finite"):
        CameraSettings(exposure=math.nan)
