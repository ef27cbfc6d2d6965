import logging

import pytest
from conftest import complains
from sensor_worlds import INERTIAL, carrier, empty

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.materials import GAZEBO_MATERIALS
from bullet_lab.simulation.world.sdf import read_spawned
from bullet_lab.simulation.world.urdf import read_urdf

FLOOR = "package://bullet_lab/worlds/empty.world"
CUBE = "<geometry><box size='0.2 0.2 0.2'/></geometry>"


def tagged(tags, reference="base", links=""):
    visual = f"<visual>{CUBE}<material name='m'><color rgba='0.1 0.2 0.3 1'/></material></visual>"
    return carrier(
        f"<gazebo reference='{reference}'>{tags}</gazebo>",
        collision=f"{visual}<collision>{CUBE}</collision>",
        links=links,
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
        ("Gazebo/DarkGrey", (0.175, 0.175, 0.175, 1)),
        ("Gazebo/YellowGlow", (1, 1, 0, 1)),
        ("Gazebo/BlueTransparent", (0, 0, 1, 0.5)),
    ],
)
def test_named_materials_paint_the_link(name, colour):
    model = tagged(f"<material>{name}</material>")
    assert model.links[0].visuals[0].colour == colour


def test_without_a_material_the_urdfs_colour_stays():
    assert tagged("<mu1>1</mu1>").links[0].visuals[0].colour == (0.1, 0.2, 0.3, 1.0)


def test_the_table_of_colours():
    assert len(GAZEBO_MATERIALS) >= 60
    for colour, look, _, plain in GAZEBO_MATERIALS.values():
        colours = (colour, look.ambient or colour, plain)
        assert all(0.0 <= part <= 1.0 for one in colours for part in one)
    assert "Red" not in GAZEBO_MATERIALS
    assert "Gazebo/Plaid" not in GAZEBO_MATERIALS


def test_an_unknown_material_is_reported_and_the_colour_stays(caplog):
    made = []
    messages = warnings_of(caplog, lambda: made.append(tagged("<material>Gazebo/Plaid</material>")))
    (message,) = messages
    assert "<material> of 'base': material 'Gazebo/Plaid'" in message
    assert made[0].links[0].visuals[0].colour == (0.1, 0.2, 0.3, 1.0)


def sdf(visual="", collision="", link="", name="m"):
    return read_spawned(
        f"<sdf><model name='{name}'><link name='l'>{link}<visual name='v'><geometry><box>"
        f"<size>1 1 1</size></box></geometry>{visual}</visual><collision name='c'><geometry>"
        f"<box><size>1 1 1</size></box></geometry>{collision}</collision></link></model></sdf>",
        name,
    )


def test_named_materials_in_sdf():
    script = "<material><script><name>Gazebo/Red</name></script>{}</material>"
    assert sdf(script.format("")).links[0].visuals[0].colour == (1, 0, 0, 1)
    own = script.format("<diffuse>0 0 1 1</diffuse>")
    assert sdf(own).links[0].visuals[0].colour == (0, 0, 1, 1)


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


def test_a_direction_of_friction_in_sdf():
    ode = "<mu>0.8</mu><mu2>0.2</mu2><fdir1>0 0 3</fdir1>"
    surface = f"<surface><friction><ode>{ode}</ode></friction></surface>"
    shape = sdf(collision=surface).links[0].collisions[0]
    assert (shape.friction, shape.cross_friction) == (0.8, 0.2)
    assert shape.direction == (0.0, 0.0, 1.0)
    plain = sdf().links[0].collisions[0]
    assert (plain.friction, plain.cross_friction, plain.direction) == (1.0, None, None)


# Soft contacts


def depth_on_the_floor(tags, seconds=3.0):
    with Simulation.of(FLOOR) as simulation:
        robot = simulation.add(tagged(tags), pose=Pose((0, 0, 0.1)))
        simulation.run_for(seconds)
        return 0.1 - robot.pose().position[2]


@pytest.mark.parametrize("stiffness", [1e3, 1e4])
def test_a_soft_body_sinks_in_by_its_weight(stiffness):
    depth = depth_on_the_floor(f"<kp>{stiffness}</kp><kd>50</kd>")
    # Two to four corners carry 9.8 N; Bullet lets anything sink in by 0.01 mm.
    assert 9.8 / (4 * stiffness) <= depth <= 9.8 / (2 * stiffness) + 2e-5


def test_a_hard_body_does_not():
    assert depth_on_the_floor("") == pytest.approx(1e-5, abs=1e-5)
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


def test_soft_contacts_in_sdf():
    surface = "<surface><contact><ode><kp>5e4</kp><kd>7</kd></ode></contact></surface>"
    shape = sdf(collision=surface).links[0].collisions[0]
    assert (shape.stiffness, shape.damping) == (5e4, 7.0)
    plain = sdf().links[0].collisions[0]
    assert (plain.stiffness, plain.damping) == (None, None)


# Links of one body that touch each other


def chain(self_colliding=()):
    """Three cubes on a rail; the outer ones overlap those in between when they slide in."""
    parts = []
    for name, mass in (("left", 1), ("base", 10), ("right", 1)):
        parts.append(
            f"<link name='{name}'><inertial><mass value='{mass}'/>"
            "<inertia ixx='1' iyy='1' izz='1'/></inertial>"
            f"<collision>{CUBE}</collision></link>"
        )
    for name, y in (("left", 1.0), ("right", -1.0)):
        parts.append(
            f"<joint name='{name}_rail' type='prismatic'><parent link='base'/>"
            f"<child link='{name}'/><origin xyz='1 {y} 0'/><axis xyz='0 1 0'/>"
            "<limit lower='-5' upper='5' effort='10' velocity='10'/></joint>"
        )
    parts += [
        f"<gazebo reference='{name}'><selfCollide>true</selfCollide></gazebo>"
        for name in self_colliding
    ]
    return read_urdf(f"<robot name='chain'>{''.join(parts)}</robot>", "chain")


def gap_after_pushing(model):
    with empty() as simulation:
        body = simulation.add(model).bodies["base"]
        body.set_joint("left_rail", 0.0, -1.0)
        simulation.run_for(3.0)
        left, right = (body.joint_state(f"{name}_rail").position for name in ("left", "right"))
        return 2.0 + left - right


def test_links_pass_through_each_other_by_default():
    assert gap_after_pushing(chain()) < -0.5


@pytest.mark.parametrize("which", [("left",), ("right",), ("left", "right")])
def test_self_collide_of_one_is_enough(which):
    assert gap_after_pushing(chain(which)) > 0.19


def test_self_collide_of_a_third_link_is_not():
    assert gap_after_pushing(chain(("base",))) < -0.5


def test_neighbours_never_touch():
    # The wheels of a robot are within its body.
    with Simulation.of(FLOOR) as simulation:
        links = (
            f"<link name='arm'>{INERTIAL}<collision>{CUBE}</collision></link>"
            f"<link name='hand'>{INERTIAL}</link>"
            "<joint name='a' type='continuous'><parent link='base'/><child link='arm'/></joint>"
            "<joint name='b' type='continuous'><parent link='arm'/><child link='hand'/></joint>"
        )
        model = tagged("<selfCollide>true</selfCollide>", links=links)
        robot = simulation.add(model, pose=Pose((0, 0, 1)))
        simulation.run_for(0.01)
        assert not robot.bodies["base"].near_points()


def test_self_collide_in_sdf():
    assert sdf(link="<self_collide>true</self_collide>").links[0].self_collide
    assert not sdf().links[0].self_collide


# What is not known


def test_how_ode_computes_is_its_own_business(caplog):
    tags = "<minDepth>0.001</minDepth><maxVel>0.1</maxVel><maxContacts>4</maxContacts>"
    robot = f"<gazebo reference='base'>{tags}</gazebo>"
    assert warnings_of(caplog, lambda: carrier(robot)) == []


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
    # And what is so anyway.
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


def test_a_plugin_that_is_not_known_is_reported(caplog):
    def make():
        with empty() as simulation:
            simulation.add(carrier("<gazebo><plugin name='p' filename='libfly.so'/></gazebo>"))

    (message,) = warnings_of(caplog, make)
    assert "plugin 'p' (libfly.so) is not simulated" in message


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
        ("<kd>nan</kd>", "<kd> of 'base': 'nan' is not a finite number"),
        ("<selfCollide>perhaps</selfCollide>", "<selfCollide> of 'base': 'perhaps' is not true"),
        ("<mu1/>", "<mu1> of 'base'"),
    ],
)
def test_nonsense_is_named_and_the_default_counts(tags, message):
    with complains(message):
        tagged(tags)
