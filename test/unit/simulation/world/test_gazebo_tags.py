import logging

import pytest
from sensor_worlds import carrier, empty
from shared import complains

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import Collision
from bullet_lab.simulation.world.sdf import read_spawned

FLOOR = "package://bullet_lab/worlds/empty.world"
CUBE = "<geometry><box size='0.2 0.2 0.2'/></geometry>"


def tagged(tags):
    visual = f"<visual>{CUBE}<material name='m'><color rgba='0.1 0.2 0.3 1'/></material></visual>"
    return carrier(
        f"<gazebo reference='base'>{tags}</gazebo>",
        collision=f"{visual}<collision>{CUBE}</collision>",
    )


def warnings_of(caplog, make):
    with caplog.at_level(logging.WARNING):
        make()
    return caplog.messages


# Materials


@pytest.mark.parametrize(
    ("name", "colour"),
    [
        ("Gazebo/Red", (1, 0, 0, 1)),
        ("Gazebo/Orange", (1.0, 0.5088, 0.0468, 1)),
        ("Gazebo/BlueTransparent", (0, 0, 1, 0.5)),
    ],
)
def test_named_materials_paint_the_link(name, colour):
    model = tagged(f"<material>{name}</material>")
    assert model.links[0].visuals[0].colour == colour


def test_an_unknown_material_is_reported_and_the_colour_stays(caplog):
    made = []
    messages = warnings_of(caplog, lambda: made.append(tagged("<material>Gazebo/Plaid</material>")))
    (message,) = messages
    assert "<material> of 'base': material 'Gazebo/Plaid'" in message
    assert made[0].links[0].visuals[0].colour == (0.1, 0.2, 0.3, 1.0)


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


def test_friction_of_several_elements_and_merged_links():
    links = (
        "<link name='nose'><collision><geometry><sphere radius='0.1'/></geometry></collision>"
        "</link><joint name='j' type='fixed'><parent link='base'/><child link='nose'/></joint>"
    )
    model = carrier(
        "<gazebo reference='base'><mu1>0.3</mu1></gazebo>"
        "<gazebo reference='base'><kp>1e5</kp></gazebo>"
        "<gazebo reference='nose'><mu1>0.7</mu1></gazebo>",
        collision=f"<collision>{CUBE}</collision>",
        links=links,
    )
    base, nose = model.links[0].collisions
    assert (base.friction, base.stiffness, nose.friction) == (0.3, 1e5, 0.7)


def test_one_coefficient_only_is_said_once(caplog):
    (message,) = warnings_of(caplog, lambda: tagged("<mu1>1</mu1><mu2>0.5</mu2><mu2>0.5</mu2>"))
    said = "without <fdir1>, friction has one coefficient here, <mu1>: 1"
    assert f"<mu2> of 'base': {said}" in message


def test_a_direction_of_friction(caplog):
    tags = "<mu1>1</mu1><mu2>0.5</mu2><fdir1>0 2 0</fdir1>"
    assert warnings_of(caplog, lambda: tagged(tags)) == []
    shape = tagged(tags).links[0].collisions[0]
    assert (shape.friction, shape.cross_friction) == (1.0, 0.5)
    assert shape.direction == (0.0, 1.0, 0.0)
    assert tagged("<fdir1>0 0 0</fdir1>").links[0].collisions[0].direction is None


# Soft contacts


def depth_on_the_floor(tags, seconds=3.0):
    with Simulation.of(FLOOR) as simulation:
        robot = simulation.add(tagged(tags), pose=Pose((0, 0, 0.1)))
        simulation.run_for(seconds)
        return 0.1 - robot.pose().position[2]


def test_a_soft_body_sinks_in_by_its_weight_and_a_hard_one_does_not():
    depth = depth_on_the_floor("<kp>1e3</kp><kd>50</kd>")
    # Two to four corners carry 9.8 N; Bullet lets anything sink in by 0.01 mm.
    assert 9.8 / 4e3 <= depth <= 9.8 / 2e3 + 2e-5
    assert depth_on_the_floor("<kp>1e12</kp><kd>1</kd>") == pytest.approx(1e-5, abs=1e-5)


def test_damping_decides_how_long_it_bounces():
    def speeds(damping):
        with Simulation.of(FLOOR) as simulation:
            tags = f"<kp>1e3</kp><kd>{damping}</kd>"
            robot = simulation.add(tagged(tags), pose=Pose((0, 0, 0.12)))
            simulation.run_for(0.5)
            seen = []
            for _ in range(100):
                simulation.run_for(0.01)
                seen.append(abs(robot.bodies["base"].velocity()[0][2]))
            return max(seen)

    assert speeds(1) > 5 * speeds(100)


def test_the_same_in_sdf():
    ode = "<mu>0.8</mu><mu2>0.2</mu2><fdir1>0 0 3</fdir1>"
    soft = "<contact><ode><kp>5e4</kp><kd>7</kd></ode></contact>"
    surface = f"<surface><friction><ode>{ode}</ode></friction>{soft}</surface>"
    (link,) = sdf(collision=surface, link="<self_collide>true</self_collide>").links
    (shape,) = link.collisions
    assert (shape.friction, shape.cross_friction) == (0.8, 0.2)
    assert shape.direction == (0.0, 0.0, 1.0)
    assert (shape.stiffness, shape.damping) == (5e4, 7.0)
    (plain,) = sdf().links
    assert plain.collisions == (Collision(shape.geometry, name="c"),)
    assert (link.self_collide, plain.self_collide) == (True, False)


def test_self_collide():
    assert tagged("<selfCollide>true</selfCollide>").links[0].self_collide


# What is not known


def test_unknown_tags_are_reported_once_each_by_name(caplog):
    robot = (
        "<gazebo reference='base'><dampingFactor>0.1</dampingFactor></gazebo>"
        "<gazebo reference='base'><laserRetro>1</laserRetro></gazebo>"
        "<gazebo reference='base'><laserRetro>1</laserRetro></gazebo>"
        "<gazebo><static>false</static></gazebo>"
    )
    messages = warnings_of(caplog, lambda: carrier(robot))
    assert messages == [
        "carrier: <gazebo>: <dampingFactor> is not simulated",
        "carrier: <gazebo>: <laserRetro> is not simulated",
    ]


def test_what_is_for_the_eye_alone_is_not_reported(caplog):
    sensor = "<sensor type='ray' name='s'><visualize>true</visualize></sensor>"
    robot = f"<gazebo reference='base'><visualize>1</visualize>{sensor}</gazebo>"
    # And how ODE computes, and what is so anyway.
    robot += "<gazebo reference='base'><minDepth>0.001</minDepth><maxVel>0.1</maxVel></gazebo>"
    robot += "<gazebo><static>false</static></gazebo>"
    assert warnings_of(caplog, lambda: carrier(robot)) == []


def test_a_reference_to_nothing_is_reported(caplog):
    nowhere = "<gazebo reference='bose'><mu1>1</mu1></gazebo>"
    (message,) = warnings_of(caplog, lambda: carrier(nowhere))
    assert "<gazebo reference='bose'>: unknown link or joint" in message


def test_tags_of_a_plugin_that_it_does_not_know_are_reported(caplog):
    plugin = (
        "<gazebo><plugin name='drive' filename='libgazebo_ros_planar_move.so'>"
        "<comandTopic>go</comandTopic><robotNamespace>ns</robotNamespace>"
        "<alwaysOn>true</alwaysOn></plugin></gazebo>"
    )

    def make():
        with empty() as simulation:
            simulation.add(carrier(plugin)).command("/ns/cmd_vel", PlanarCommand())

    (message,) = warnings_of(caplog, make)
    assert message == (
        "model 'carrier': plugin 'drive': <comandTopic> is not known and skipped"
    )


def test_our_own_robots_say_nothing_unknown(caplog, package):
    def make():
        for urdf in sorted((package / "urdf").glob("*.urdf")):
            with Simulation.of(FLOOR) as simulation:
                simulation.spawn(str(urdf))

    assert warnings_of(caplog, make) == []


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
