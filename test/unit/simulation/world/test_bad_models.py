"""What no model can be is refused with a line that says what and where; the world goes on."""

import math
import random
import re

import pytest
from conftest import BLOCK_ROBOT, complains

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.world.sdf import read_spawned

SDF = """<sdf version="1.6"><model name="m">
  <link name="a"><inertial><mass>1</mass>
    <inertia><ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz></inertia></inertial>
    <collision name="c"><geometry><box><size>0.2 0.3 0.4</size></box></geometry></collision></link>
  <link name="b"><pose>0 0 1 0 0 0</pose><inertial><mass>1</mass></inertial></link>
  <joint name="j" type="revolute"><parent>a</parent><child>b</child>
    <axis><xyz>0 0 1</xyz></axis></joint>
</model></sdf>"""

URDF = """<robot name="r"><link name="a"><inertial><mass value="1"/>
  <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link></robot>"""

LOOP = """<joint name="k" type="revolute"><parent>b</parent><child>a</child></joint></model>"""
MESH = "<mesh><uri>{}</uri></mesh>"

# What is replaced by what, and what the message says of it.
BROKEN = [
    (SDF, "</model>", "", "not well-formed XML"),
    (SDF, "<sdf", "<!DOCTYPE sdf [<!ENTITY e 'x'>]><sdf", "document types and entities"),
    (SDF, "sdf", "html", "neither <sdf> nor <robot>"),
    (SDF, "model", "world", "there is no model"),
    (SDF, "<mass>1<", "<mass>-1<", "link 'a'.*<mass>: -1 is not positive"),
    (SDF, "<mass>1<", "<mass>nan<", "link 'a'.*<mass>: 'nan' is not a finite number"),
    (SDF, "<ixx>0.1", "<ixx>5", "link 'a'.*no body can have the principal moments"),
    (SDF, "0.2 0.3 0.4", "0.2 0.3", "<size>: '0.2 0.3' is not 3 finite numbers"),
    (SDF, "0.2 0.3 0.4", "0.2 0.3 -1", "<size>: -1 is not positive"),
    (SDF, "0.2 0.3 0.4", "0.2 0.3 1e30", "<size>: 1e\\+30 is not within ±1e\\+18"),
    (SDF, "0.2 0.3 0.4", "0.2 0.3 1e9", "size of a shape: 1e\\+09 is not within ±1e\\+06"),
    (SDF, "0 0 1 0 0 0", "0 0 nan 0 0 0", "link 'b'.*<pose>.*not 6 finite numbers"),
    (SDF, "0 0 1 0 0 0", "0 0 1e12 0 0 0", "link 'b': pose: 1e\\+12 is not within ±1e\\+06"),
    (SDF, "</model>", '<link name="a"/></model>', "link 'a' appears twice"),
    (SDF, "<child>b", "<child>c", "joint 'j'.*unknown link 'c'"),
    (SDF, "</model>", LOOP, "joint 'k' closes a loop"),
    (SDF, "revolute", "screw", "joint 'j'.*type 'screw'"),
    (SDF, "<box><size>0.2 0.3 0.4</size></box>", MESH.format("model://nix/a.dae"), "model://nix"),
    (SDF, "<box><size>0.2 0.3 0.4</size></box>", MESH.format("http://x/a.dae"), "http://x/a.dae"),
    (
        SDF,
        "<box><size>0.2 0.3 0.4</size></box>",
        MESH.format("package://bullet_lab/../../etc/passwd"),
        "leaves its folder",
    ),
    (
        SDF,
        "<box><size>0.2 0.3 0.4</size></box>",
        MESH.format("model://beacon/../../../x.dae"),
        "model://beacon",
    ),
    (
        SDF,
        "<box><size>0.2 0.3 0.4</size></box>",
        MESH.format("package://bullet_lab/package.xml"),
        "unknown kind of mesh",
    ),
    (SDF, SDF, "<sdf><include><uri>model://nix</uri></include></sdf>", "model://nix"),
    (URDF, 'value="1"', 'value="-3"', "link 'a'.*mass value: -3 is negative"),
    (URDF, 'value="1"', 'value="0"', "link 'a' moves and has no mass"),
    (URDF, 'ixx="0.1"', 'ixx="-0.1"', "link 'a'.*no body can have the principal moments"),
    (URDF, "0.1 0.1 0.1", "0.1 inf 0.1", "box size.*not 3 finite numbers"),
    (URDF, "</robot>", '<link name="b"/></robot>', "several root links"),
    (URDF, '<link name="a">', '<link name="">', "without a name"),
    (URDF, "box", "banana", "unknown geometry <banana>"),
]


@pytest.mark.parametrize(("text", "old", "new", "said"), BROKEN)
def test_what_is_broken_is_named_with_what_and_where(world, text, old, new, said):
    assert old in text
    with complains(said):
        world.add(read_spawned(text.replace(old, new), "model_xml of 'm'"))
    world.run_for(0.01)


@pytest.mark.parametrize(
    ("name", "pose", "said"),
    [
        ("ground_plane", Pose(), "'ground_plane' exists already"),
        ("new\nline", Pose(), "name 'new\\\\nline': has characters that cannot be printed"),
        ("m", Pose((0.0, math.nan, 0.0)), "'m': its pose is not finite"),
        ("m", Pose((0.0, -1e7, 0.0)), "'m': its position exceeds 1e\\+06 m"),
        ("m", Pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 2.0)), "quaternion of length 2"),
    ],
)
def test_names_and_poses_that_cannot_be(world, name, pose, said):
    with pytest.raises(LabError, match=said):
        world.add(read_spawned(SDF, "text"), name, pose)
    assert list(world.models) == ["ground_plane"]


NUMBER = re.compile(r"(?<![\w#.])-?\d+\.?\d*(?![\w.])")
ODD = ("0", "-1", "nan", "inf", "1e308", "-1e308", "1e-308", "1e15", "1e-15", "1e6", "", "x", "1 2")
PIECES = ("<", ">", "&x;", "<a/>", "\x00", '"', "</link>", "é", "<!--")


def spoilt(text, random_):
    """A description with a number, a line or a piece of it replaced."""
    kind = random_.randrange(6)
    if kind <= 2:
        found = random_.choice(list(NUMBER.finditer(text)))
        return text[: found.start()] + random_.choice(ODD) + text[found.end() :]
    if kind == 3:
        start = random_.randrange(len(text))
        return text[:start] + text[start + random_.randrange(1, 200) :]
    if kind == 4:
        start = random_.randrange(len(text))
        return text[:start] + random_.choice(PIECES) + text[start:]
    lines = text.split("\n")
    lines.insert(random_.randrange(len(lines)), random_.choice(lines))
    return "\n".join(lines)


def test_whatever_is_spawned_a_robot_drives_on(world, package):
    """Spoilt descriptions are refused, or make models that disturb nobody far away."""
    random_ = random.Random(5)
    files = ("models/beacon/model.sdf", "urdf/block_robot.urdf", "urdf/camera_robot.urdf")
    texts = [SDF, *((package / file).read_text() for file in files)]
    robot = world.spawn(BLOCK_ROBOT, "robot")
    accepted = refused = 0
    for _ in range(150):
        text = spoilt(random_.choice(texts), random_)
        try:
            model = read_spawned(text, "text")
            world.add(model, "odd", Pose((3.0, 3.0, 0.5)) * model.pose)
            accepted += 1
        except LabError as error:
            assert "\n" not in str(error)
            refused += 1
            continue
        robot.place(Pose())
        robot.command("cmd_vel", PlanarCommand(vx=0.3))
        world.run_for(0.02)
        assert robot.pose().position == pytest.approx((0.0058, 0.0, 0.0), abs=1e-3), text
        world.remove("odd")
    assert list(world.models) == ["ground_plane", "robot"]
    assert accepted > 30
    assert refused > 50
