"""Nested models, frames and joints to the world: where things are, and how they move."""

import math

import pytest
from alike import assert_alike
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.sdf import read_spawned, read_world_file
from bullet_lab.simulation.world.sdf_writer import world_text

BOX = "<geometry><box><size>0.2 0.2 0.2</size></box></geometry>"
BODY = (
    "<inertial><mass>1</mass><inertia><ixx>0.01</ixx><iyy>0.01</iyy><izz>0.01</izz></inertia>"
    f'</inertial><collision name="c">{BOX}</collision><visual name="v">{BOX}</visual>'
)


def link(name, pose="", inside=BODY, base=""):
    said = f' relative_to="{base}"' if base else ""
    return f'<link name="{name}"><pose{said}>{pose or "0 0 0 0 0 0"}</pose>{inside}</link>'


def joint(kind, parent, child, inside="", name="j"):
    ends = f"<parent>{parent}</parent><child>{child}</child>"
    return f'<joint name="{name}" type="{kind}">{ends}{inside}</joint>'


def axis(xyz, extra="", said=""):
    return f"<axis><xyz{said}>{xyz}</xyz>{extra}</axis>"


def model(inside, version="1.7", name="m"):
    text = f'<sdf version="{version}"><model name="{name}">{inside}</model></sdf>'
    return read_spawned(text, "s")


def near(pose, *numbers):
    wanted = Pose.from_rpy(numbers[:3], numbers[3:] or (0, 0, 0))
    assert_alike(wanted, pose, within=1e-9)


TURN = math.pi / 2


@cases("""
version, said, extra, expected:
  - ['1.4', '', '', [0, -1, 0]]
  - ['1.5', '', '', [1, 0, 0]]
  - ['1.6', '', '', [1, 0, 0]]
  - ['1.6', '', <use_parent_model_frame>1</use_parent_model_frame>, [0, -1, 0]]
  - ['1.7', ' expressed_in="a"', '', [0, -1, 0]]
  - ['1.7', '', '', [1, 0, 0]]
""")
def test_axes_are_in_the_joint_or_the_model(version, said, extra, expected):
    found = model(
        link("a")
        + f'<link name="b"><pose>0 0 1 0 0 {TURN}</pose>{BODY}</link>'
        + joint("revolute", "a", "b", axis("1 0 0", extra, said)),
        version,
    )
    assert found.joints[0].axis == pytest.approx(expected, abs=1e-12)


def test_what_is_joined_to_the_world_hangs_there(falling):
    door = link("door", "0.6 0 1 0 0 0")
    hinge = joint("revolute", "world", "door", "<pose>-0.5 0 0 0 0 0</pose>" + axis("0 1 0"))
    post = link("post") + joint("fixed", "post", "world", name="k")
    instance = falling.add(model(post + door + hinge), pose=Pose((3.0, 0.0, 0.0)))
    assert [link.name for link in instance.model.links if link.anchored] == ["post", "world"]
    falling.run_for(0.2)
    near(instance.frame("post").pose(), 3, 0, 0)
    fallen = instance.frame("door").pose()
    assert math.dist(fallen.position, (3.1, 0, 1)) == pytest.approx(0.5, abs=1e-3)
    assert fallen.position[2] < 0.95
    instance.place(Pose((1.0, 0.0, 0.0)))
    near(instance.frame("door").pose(), 1.6, 0, 1)


def test_a_model_on_a_joint_to_the_world_is_where_its_link_is(space):
    lift = link("car") + joint("prismatic", "world", "car", axis("0 0 1"))
    instance = space.add(model(lift))
    instance.configure({"j": 2.0})
    near(instance.pose(), 0, 0, 2)
    assert list(instance.state().joints) == ["j"]
    assert instance.model.canonical_link().name == "car"
    assert [link.name for link in instance.model.own_links()] == ["car"]


URDF = """<robot name="r"><link name="world"/><link name="base">{body}</link><link name="arm">{body}
  </link><joint name="hold" type="{kind}"><parent link="world"/><child link="base"/>
  <origin xyz="0 0 1"/><axis xyz="0 0 1"/></joint>
  <joint name="j" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 1"/>
  <axis xyz="1 0 0"/><limit lower="-3" upper="3" effort="9" velocity="9"/></joint></robot>"""
URDF_BODY = (
    '<inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>'
    "</inertial>"
)


@cases("kind, joints: [[fixed, [j]], [continuous, [hold, j]], [floating, [j]]]")
def test_a_urdf_on_the_link_world_stays_unless_it_floats(kind, joints, caplog, falling):
    robot = read_spawned(URDF.format(body=URDF_BODY, kind=kind), "s")
    assert ("type 'floating' is not simulated" in caplog.text) == (kind == "floating")
    instance = falling.add(robot, pose=Pose((2.0, 0.0, 0.0)))
    falling.run_for(0.3)
    base = instance.frame("base").pose()
    if kind == "floating":
        assert base.position[2] < 0.7
    else:
        near(base, 2, 0, 1)
    assert list(instance.state().joints) == joints


PLUGIN = """<plugin name="p" filename="libgazebo_ros_p3d.so"><bodyName>l</bodyName>
  <topicName>truth</topicName></plugin>"""


@pytest.fixture
def chair(save_model):
    inside = f"<pose>9 9 9 0 0 0</pose>{link('l', '0 0 0.5 0 0 0')}{PLUGIN}"
    save_model("chair", f'<sdf version="1.6"><model name="chair">{inside}</model></sdf>')
    return "<include><uri>model://chair</uri>{}</include>"


def test_what_is_nested_and_held_is_saved(read_world, chair, tmp_path):
    hinge = "<pose>-0.5 0 0 0 0 0</pose>" + axis("0 1 0")
    world = read_world(
        f'<model name="room"><pose>0 0 2 0 0 0.3</pose>{link("floor")}'
        + chair.format("<name>two</name><pose>0 2 0 0 0 0</pose>")
        + link("door", "1 0 1 0 0 0")
        + joint("fixed", "world", "floor")
        + joint("revolute", "world", "door", hinge, name="k")
        + joint("revolute", "floor", "two::l", axis("1 0 0"), name="rock")
        + "</model>"
    )
    with Simulation(world) as simulation:
        simulation.run_for(0.3)
        before = simulation.models["room"].state()
        text, _ = world_text(simulation.snapshot(), tmp_path)
    (tmp_path / "b.world").write_text(text)
    with Simulation(read_world_file(tmp_path / "b.world")) as again:
        after = again.models["room"].state()
        assert [p.mount.plugin.scope for p in again.models["room"].plugins] == ["two::"]
        assert_alike(before, after)
        assert abs(before.joints["k"][1]) > 1.0
        frames = again.models["room"].model.frames
        assert set(frames) == set(world.models[0].frames)
