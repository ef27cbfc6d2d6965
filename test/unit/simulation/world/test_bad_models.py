"""What no model can be is refused with a line that says what and where; the world goes on."""

import math

import pytest
from conftest import complains

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
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

# What is replaced by what, and what the message says of it.
BROKEN = [
    (SDF, "</model>", "", "not well-formed XML"),
    (SDF, "<mass>1<", "<mass>nan<", "link 'a'.*<mass>: 'nan' is not a finite number"),
    (SDF, "0.2 0.3 0.4", "0.2 0.3 1e30", "<size>: 1e\\+30 is not within ±1e\\+18"),
    (SDF, "0.2 0.3 0.4", "0.2 0.3 1e9", "size of a shape: 1e\\+09 is not within ±1e\\+06"),
    (SDF, "0 0 1 0 0 0", "0 0 1e12 0 0 0", "link 'b': pose: 1e\\+12 is not within ±1e\\+06"),
    (URDF, 'value="1"', 'value="0"', "link 'a' moves and has no mass"),
    (URDF, '<link name="a">', '<link name="">', "without a name"),
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
