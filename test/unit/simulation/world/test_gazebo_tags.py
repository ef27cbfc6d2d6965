import pytest
from sensor_worlds import carrier, empty
from shared import EMPTY_WORLD, complains

from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.sdf import read_spawned

CUBE = "<geometry><box size='0.2 0.2 0.2'/></geometry>"


def tagged(tags):
    visual = f"<visual>{CUBE}<material name='m'><color rgba='0.1 0.2 0.3 1'/></material></visual>"
    return carrier(
        f"<gazebo reference='base'>{tags}</gazebo>",
        collision=f"{visual}<collision>{CUBE}</collision>",
    )


# Materials


def test_an_unknown_material_is_reported_and_the_colour_stays(caplog):
    made = tagged("<material>Gazebo/Plaid</material>")
    (message,) = caplog.messages
    assert "<material> of 'base': material 'Gazebo/Plaid'" in message
    assert made.links[0].visuals[0].colour == (0.1, 0.2, 0.3, 1.0)


def sdf(collision="", link=""):
    return read_spawned(
        f"<sdf><model name='m'><link name='l'>{link}<collision name='c'><geometry><box>"
        f"<size>1 1 1</size></box></geometry>{collision}</collision></link></model></sdf>",
        "m",
    )


# Friction


@pytest.mark.parametrize(
    ("tags", "mu"),
    [
        ("<mu1>0.3</mu1><mu2>0.3</mu2>", 0.3),
        ("<mu1 value='0.4'/>", 0.4),
        ("<mu2>0.5</mu2>", 0.5),
        ("<kp>1e6</kp>", 1.0),
        # Without limit.
        ("<mu1>-1</mu1>", 1e6),
        ("<mu1>1e100</mu1>", 1e6),
    ],
)
def test_friction(tags, mu):
    assert tagged(tags).links[0].collisions[0].friction == mu


def test_a_direction_of_friction(caplog):
    (shape,) = tagged("<mu1>1</mu1><mu2>0.5</mu2><fdir1>0 2 0</fdir1>").links[0].collisions
    assert (shape.friction, shape.cross_friction) == (1.0, 0.5)
    assert shape.direction == (0.0, 1.0, 0.0)
    assert tagged("<fdir1>0 0 0</fdir1>").links[0].collisions[0].direction is None
    assert caplog.messages == []


# What is not known


def test_unknown_tags_are_reported_once_each_by_name(caplog):
    carrier(
        "<gazebo reference='base'><dampingFactor>0.1</dampingFactor></gazebo>"
        "<gazebo reference='base'><laserRetro>1</laserRetro></gazebo>"
        "<gazebo reference='base'><laserRetro>1</laserRetro></gazebo>"
        "<gazebo><static>false</static></gazebo>"
    )
    assert caplog.messages == [
        "carrier: <gazebo>: <dampingFactor> is not simulated",
        "carrier: <gazebo>: <laserRetro> is not simulated",
    ]


def test_what_is_for_the_eye_alone_is_not_reported(caplog):
    # And how ODE computes, and what is so anyway.
    carrier(
        "<gazebo reference='base'><visualize>1</visualize>"
        "<sensor type='ray' name='s'><visualize>true</visualize></sensor></gazebo>"
        "<gazebo reference='base'><minDepth>0.001</minDepth><maxVel>0.1</maxVel></gazebo>"
        "<gazebo><static>false</static></gazebo>"
    )
    assert caplog.messages == []


def test_tags_of_a_plugin_that_it_does_not_know_are_reported(caplog):
    plugin = (
        "<gazebo><plugin name='drive' filename='libgazebo_ros_planar_move.so'>"
        "<comandTopic>go</comandTopic><robotNamespace>ns</robotNamespace>"
        "<alwaysOn>true</alwaysOn></plugin></gazebo>"
    )
    with empty() as simulation:
        simulation.add(carrier(plugin)).command("/ns/cmd_vel", PlanarCommand())
    said = "model 'carrier': plugin 'drive': <comandTopic> is not known and skipped"
    assert caplog.messages == [said]


def test_our_own_robots_say_nothing_unknown(caplog, package):
    for urdf in sorted((package / "urdf").glob("*.urdf")):
        with Simulation.of(EMPTY_WORLD) as simulation:
            simulation.spawn(str(urdf))
    assert caplog.messages == []


@pytest.mark.parametrize(
    ("tags", "message"),
    [
        ("<mu2>slippery</mu2>", "<mu2> of 'base': 'slippery' is not a finite number"),
        ("<kp>-1</kp>", "<kp> of 'base': -1 is negative"),
        ("<selfCollide>perhaps</selfCollide>", "<selfCollide> of 'base': 'perhaps' is not true"),
        ("<mu1/>", "<mu1> of 'base'"),
    ],
)
def test_nonsense_is_named_and_the_default_counts(tags, message):
    with complains(message):
        tagged(tags)
