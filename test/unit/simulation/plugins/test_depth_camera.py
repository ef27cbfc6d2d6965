"""The depth camera against closed-form geometry."""

import math

import numpy as np
import pytest
from picture_worlds import simulation_of, thing
from sensor_worlds import record, steps
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.camera import DepthCamera
from bullet_lab.simulation.world.description import Box
from bullet_lab.simulation.world.urdf import read_urdf

ROBOT = """<robot name="robot">
  <link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>
  <link name="mast"/>
  <joint name="up" type="fixed"><parent link="base"/><child link="mast"/>
    <origin xyz="0.1 0 0.5" rpy="0 0.2 0.3"/></joint>
  <gazebo reference="{link}"><sensor type="depth" name="s"><update_rate>20</update_rate>
    <camera name="eye"><horizontal_fov>1.2</horizontal_fov>
      <image><width>160</width><height>120</height><format>{format}</format></image>
      <clip><near>0.05</near><far>8</far></clip></camera>
    <plugin filename="libgazebo_ros_{plugin}.so" name="c">{tags}</plugin></sensor></gazebo>
</robot>"""
FOCAL = 80 / math.tan(0.6)


def add(simulation, link="base", format="R8G8B8", plugin="openni_kinect", tags=""):
    text = ROBOT.format(link=link, format=format, plugin=plugin, tags=tags)
    robot = simulation.add(read_urdf(text, "robot"))
    (camera,) = (device for device in robot.plugins if isinstance(device, DepthCamera))
    return robot, camera


def measured(*models, **changes):
    with world(*models) as simulation:
        return add(simulation, **changes)[1].measure()


def rays():
    """Slopes x/z and y/z of the pixels, each (120, 160)."""
    v, u = np.mgrid[0:120, 0:160]
    return (u - 79.5) / FOCAL, (v - 59.5) / FOCAL


def wall(distance, yaw, colour=(1.0, 1.0, 1.0, 1.0)):
    """A wall through a point ahead, turned about z, and its normal."""
    normal = np.array([math.cos(yaw), math.sin(yaw), 0.0])
    middle = np.array([distance, 0.0, 0.0]) + 0.1 * normal
    pose = Pose.from_rpy(tuple(middle), (0.0, 0.0, yaw))
    return thing("wall", Box((0.2, 60.0, 60.0)), pose, colour), normal


def world(*models):
    return simulation_of(*models, gravity=(0.0, 0.0, 0.0))


# The closed form


@cases("yaw, distance, error: [[0.7, 0.5, 0.0001], [0.0, 2.0, 0.0003], [-0.4, 4.5, 0.0006]]")
def test_depth_of_an_oblique_wall(yaw, distance, error):
    model, normal = wall(distance, yaw)
    x, _ = rays()
    exact = distance * normal[0] / (normal[0] - normal[1] * x)
    depths = measured(model)
    assert depths.dtype == np.float32
    inside = (exact > 0.4 + error) & (exact < 5.0 - error)
    assert inside.any()
    assert np.abs(depths - exact)[inside].max() < error
    assert np.isnan(depths[(exact < 0.4 - error) | (exact > 5.0 + error)]).all()


def test_points_lie_where_the_wall_is():
    model, normal = wall(2.0, 0.5)
    with world(model) as simulation:
        _, camera = add(simulation, link="mast")
        points = camera.points_at(camera.measure())
        pose = camera.pose()
    # From the optical frame to the link's, whose x axis is the optical z axis.
    ahead = np.dstack((points[..., 2], -points[..., 0], -points[..., 1]))
    there = ahead @ pose.rotation_matrix().T + pose.position
    assert np.isfinite(points).mean() > 0.9
    assert np.nanmax(np.abs(there @ normal - 2.0 * normal[0])) < 5e-4
    # A point is seen at its own pixel.
    np.testing.assert_allclose(points[..., :2] / points[..., 2:], np.dstack(rays()), atol=1e-6)


def test_what_is_too_near_hides_what_is_behind_it():
    plate = thing("plate", Box((0.02, 0.1, 0.1)), Pose((0.3, 0.0, 0.0)))
    depths = measured(wall(2.0, 0.0)[0], plate)
    assert np.isnan(depths[50:70, 65:95]).all()
    assert depths[60, 5] == pytest.approx(2.0, abs=1e-3)


def test_a_distorted_pixel_has_the_depth_of_what_it_shows():
    model, normal = wall(2.0, 0.6)
    tags = "<distortionK1>-0.2</distortionK1><distortionK2>0.03</distortionK2>"
    with world(model) as simulation:
        _, camera = add(simulation, tags=tags)
        points = camera.points_at(camera.measure()).reshape(-1, 3)
    v, u = np.mgrid[0:120, 0:160]
    seen = camera.camera.project(points)
    np.testing.assert_allclose(seen, np.column_stack((u.ravel(), v.ravel())), atol=0.02)
    # The depth is that of the nearest ideal pixel: half a pixel off at most.
    off = points @ np.array([-normal[1], 0.0, normal[0]]) - 2.0 * normal[0]
    assert np.abs(off).max() < 2.0 * 0.75 / FOCAL


# Names and tags


@cases("plugin, seen: [[openni_kinect, false], [depth_camera, true]]")
def test_how_far_each_plugin_sees_by_default(plugin, seen):
    assert np.isfinite(measured(wall(6.0, 0.0)[0], plugin=plugin)).all() == seen


def test_each_output_is_worked_out_only_while_it_is_wanted(monkeypatch):
    with world(wall(2.0, 0.0)[0]) as simulation:
        _, camera = add(simulation)
        calls = []
        for name in ("take", "measure"):
            method = getattr(camera, name)
            monkeypatch.setattr(
                camera, name, lambda *args, n=name, m=method: calls.append(n) or m(*args)
            )
        wanted = set()
        for output in camera.outputs:
            output.connect(lambda _: None, lambda topic=output.topic: topic in wanted)

        def calls_for(*topics):
            wanted.clear()
            wanted.update(topics)
            calls.clear()
            simulation.run_for(0.05)
            return calls[:]

        assert calls_for("ir/camera_info", "depth/camera_info") == []
        assert calls_for("ir/image_raw") == ["take"]
        assert calls_for("depth/image_raw") == ["measure"]
        assert calls_for("points") == ["take", "measure"]
        assert calls_for("points", "ir/image_raw", "depth/image_raw") == ["take", "measure"]


@pytest.mark.parametrize(("format", "wanted"), [("B8G8R8", (255, 128, 64)), ("L8", (159,) * 3)])
def test_all_is_of_one_moment_and_points_have_the_colours_of_the_picture(format, wanted):
    with world(wall(2.0, 0.0, (1.0, 0.5, 0.25, 1.0))[0]) as simulation:
        robot, camera = add(simulation, format=format)
        found = {output.topic: record(robot, output.topic) for output in camera.outputs}
        simulation.run_for(0.1)
    for samples in found.values():
        assert steps(samples) == [50, 100]
    cloud, depth = found["points"][0], found["depth/image_raw"][0]
    assert depth.encoding == "32FC1"
    np.testing.assert_array_equal(cloud.points[..., 2], depth.pixels)
    assert cloud.colours[60, 80] == pytest.approx(wanted, abs=1.5)
    for name in ("ir/camera_info", "depth/camera_info"):
        assert found[name][0].camera == camera.camera


def test_depth_camera_sends_a_row_of_points_and_no_geometry():
    with world(wall(2.0, 0.0)[0]) as simulation:
        robot, _ = add(simulation, plugin="depth_camera", format="L8")
        names = ("points", "depth/image_raw", "ir/camera_info", "depth/camera_info")
        found = {name: record(robot, name) for name in names}
        simulation.run_for(0.05)
    (cloud,), (depth,) = found["points"], found["depth/image_raw"]
    assert (cloud.points.shape, cloud.colours.shape) == ((1, 19200, 3), (1, 19200, 3))
    np.testing.assert_array_equal(cloud.points[0, :, 2], depth.pixels.ravel())
    assert [found[name] for name in names[2:]] == [[], []]


def test_millimetres_where_they_are_asked_for():
    with world(wall(2.0, 0.9)[0]) as simulation:
        robot, _ = add(simulation, tags="<useDepth16UC1Format>true</useDepth16UC1Format>")
        images = record(robot, "depth/image_raw")
        simulation.run_for(0.05)
    (image,) = images
    assert (image.encoding, image.pixels.dtype) == ("16UC1", np.uint16)
    assert image.pixels[60, 79:81].mean() == pytest.approx(2000.0, abs=1.0)
    # The far end of the wall is out of range.
    assert (image.pixels == 0).any()
