"""Actors, and models with our plugin of a path."""

import math

import pytest
from sensor_worlds import record, saved_again
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.sdf import read_world_file
from bullet_lab.simulation.world.urdf import read_urdf

ACROSS = ((0, "0 0 1 0 0 0"), (2, "2 0 1 0 0 0"), (3, "2 0 1 0 0 3.1"), (5, "0 0 1 0 0 3.1"))
LINK = (
    '<link name="box"><collision name="c"><geometry><box><size>1 1 1</size></box></geometry>'
    "</collision></link>"
)


def script(waypoints, **tags):
    points = "".join(
        f"<waypoint><time>{time}</time><pose>{pose}</pose></waypoint>" for time, pose in waypoints
    )
    others = "".join(f"<{tag}>{text}</{tag}>" for tag, text in tags.items())
    return f'{others}<trajectory id="0"><tension>1</tension>{points}</trajectory>'


def actor(inner, links=""):
    skin = "<skin><filename>walk.dae</filename></skin>"
    parts = f"<pose>5 5 1 0 0 0</pose>{skin}{links}<script>{inner}</script>"
    return f'<actor name="walker">{parts}</actor>'


@pytest.fixture
def world_of(tmp_path):
    """Run a world with an actor."""

    def made(text):
        path = tmp_path / "w.world"
        path.write_text(f'<sdf version="1.6"><world name="w">{text}</world></sdf>')
        return Simulation(read_world_file(path))

    return made


def where(simulation, seconds):
    simulation.run_until(round(1000 * seconds))
    pose = simulation.models["walker"].pose()
    return (*pose.position, pose.yaw)


@cases("""
tags, places:
  # Straight with the tension 1: it speeds up and slows down.
  - [{}, {1: [1, 0, 0, 0], 2.5: [2, 0, 0, 1.55], 4: [1, 0, 0, 3.1], 6: [1, 0, 0, 0]}]
  - [{delay_start: 1}, {0.9: [5, 5, 0, 0], 2: [1, 0, 0, 0], 3.5: [2, 0, 0, 1.55]}]
""")
def test_a_figure_walks_on_the_floor(world_of, tags, places):
    with world_of(actor(script(ACROSS, **tags))) as simulation:
        for seconds, place in places.items():
            assert where(simulation, seconds) == pytest.approx(place, abs=5e-3), seconds


def test_links_of_an_actor_have_full_poses(world_of):
    lifted = ((0, "0 0 1 0 0 0"), (2, "0 0 3 0.4 0 0"))
    with world_of(actor(script(lifted, loop="false"), LINK)) as simulation:
        assert where(simulation, 1.0)[:3] == pytest.approx((0, 0, 2), abs=5e-3)
        pose = simulation.models["walker"].pose()
        assert pose.rotate((0, 0, 1))[1] == pytest.approx(-math.sin(0.2), abs=5e-3)


def test_it_pushes_a_robot_and_lasers_see_it(world_of):
    laser = """<robot name="eye"><link name="base"/><gazebo reference="base"><sensor type="ray"
      name="s"><pose>0 0 1 0 0 0</pose><ray><scan><horizontal><samples>1</samples></horizontal>
      </scan><range><min>0.1</min><max>9</max></range></ray><plugin name="p"
      filename="libgazebo_ros_laser.so"><topicName>scan</topicName></plugin></sensor></gazebo>
      <gazebo><static>true</static></gazebo></robot>"""
    floor = "<include><uri>model://ground_plane</uri></include>"
    with world_of(floor + actor(script(ACROSS, loop="false"))) as simulation:
        eye = simulation.add(read_urdf(laser, "eye"), pose=Pose((-3.0, 0.0, 0.0)))
        scans = record(eye, "scan")
        bot = simulation.spawn("package://bullet_lab/urdf/block_robot.urdf", "", Pose((1.0, 0, 0)))
        assert where(simulation, 2.0)[0] == pytest.approx(2.0, abs=5e-3)
        assert scans[-1].ranges[0] == pytest.approx(5.0 - 0.2, abs=0.01)
        assert bot.pose().position[0] > 2.2


def test_a_model_with_the_plugin_and_a_saved_world(world_of, tmp_path):
    plugin = f'<plugin name="p" filename="libbullet_lab_path.so">{script(ACROSS)}</plugin>'
    with world_of(f'<model name="walker">{LINK}{plugin}</model>') as simulation:
        assert where(simulation, 1.0) == pytest.approx((1, 0, 1, 0), abs=5e-3)
        with saved_again(simulation, tmp_path) as again:
            assert where(again, 2.5) == pytest.approx((2, 0, 1, 1.55), abs=5e-3)


def test_an_actor_without_a_path_stands(world_of, caplog):
    with world_of(actor(script(()))) as simulation:
        assert simulation.models["walker"].model.static
        assert where(simulation, 1.0) == pytest.approx((5, 5, 0, 0), abs=1e-6)
    assert not caplog.messages
