import numpy as np
import pytest
from shared import complains

from bullet_lab.simulation.world.description import Box, Cylinder
from bullet_lab.simulation.world.urdf import read_urdf, read_urdf_file

INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
ARM = f'<link name="a">{INERTIAL}</link><link name="b">{INERTIAL}</link>'
JOINT = '<joint name="j" type="{}"><parent link="a"/><child link="b"/>{}</joint>'


def robot(inside):
    return f'<robot name="r">{inside}</robot>'


def with_shape(shape):
    return robot(f'<link name="a"><collision><geometry>{shape}</geometry></collision></link>')


def with_inertia(mass="1", **moments):
    entries = {"ixx": "1", "iyy": "1", "izz": "1", **moments}
    tensor = " ".join(f'{key}="{value}"' for key, value in entries.items())
    return robot(
        f'<link name="a"><inertial><mass value="{mass}"/><inertia {tensor}/></inertial></link>'
    )


def test_the_beacon_is_a_solid_cylinder(package):
    """Of 0.25 m, 2 m and 100 kg/m³: π r² h ρ, m (3 r² + h²) / 12 and m r² / 2."""
    (link,) = read_urdf_file(package / "urdf" / "beacon.urdf").links
    assert link.inertia.mass == pytest.approx(39.2699, rel=1e-4)
    assert link.inertia.centre == (0.0, 0.0, 1.0)
    wanted = np.diag((13.7036, 13.7036, 1.22718))
    assert link.inertia.matrix == pytest.approx(wanted, rel=1e-4)
    for shape in (link.visuals[0], link.collisions[0]):
        assert shape.geometry.path == package / "meshes" / "beacon.dae"


def test_the_block_robot(block_model):
    assert block_model.name == "block_robot"
    (link,) = block_model.links
    block, can = link.collisions
    assert block.geometry == Box((0.1, 0.1, 0.05))
    assert block.pose.position == (0, 0, 0.025)
    assert can.geometry == Cylinder(0.05, 0.05)
    assert can.pose.position == pytest.approx((0, 0, 0.075))
    assert link.visuals[0].colour == (0.0, 1.0, 0.0, 1.0)
    _, move, states = block_model.plugins
    assert (move.name, move.filename) == ("planar_move", "libgazebo_ros_planar_move.so")
    assert states.tags == {"updateRate": "20.0"}


def test_names_of_shapes_are_gazebos(package):
    camera_robot = read_urdf_file(package / "urdf" / "camera_robot.urdf")
    lump = "_fixed_joint_lump__"
    assert [shape.name for link in camera_robot.links[:2] for shape in link.collisions] == [
        f"base_footprint{lump}base_link_collision",
        f"base_footprint{lump}can_link_collision_1",
        f"base_footprint{lump}caster_link_collision_2",
        f"left_wheel{lump}tread_collision",
        f"left_wheel{lump}rim_collision_1",
    ]
    beacon = read_urdf_file(package / "urdf" / "beacon.urdf")
    assert [shape.name for shape in beacon.links[0].collisions] == ["base_link_collision"]


def test_the_axes_of_an_inertial_are_kept(package):
    # As Gazebo's get_link_properties tells them of the camera robot's wheel, in kg m².
    wheel = read_urdf_file(package / "urdf" / "camera_robot.urdf")
    inertia = wheel.links_by_name()["left_wheel"].inertia
    own = inertia.elements(inertia.axes)
    found = [own[key] for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")]
    assert found == pytest.approx([0.002467, 0.002467, 0.0049, 0, 0, 0], abs=1e-6)


def test_what_xacro_has_not_expanded_is_named_once(caplog):
    link = f'<link name="a">{INERTIAL}<box_inertia mass="1"/><collision><geometry>'
    shape = '<box size="1 1 1"/></geometry></collision></link>'
    read_urdf(robot(f'<my_body/>{link}{shape}<my_body/><x:a xmlns:x="n"/>'), "text")
    left_out = "text: <{0}> is not known and left out; if it is a macro of xacro, it is called"
    assert caplog.messages == [
        f"{left_out} <xacro:{{0}}>".format(name) for name in ("my_body", "box_inertia")
    ]


BAD = [
    ("", "not well-formed XML"),
    ("<sdf/>", "the root element is <sdf>, not <robot>"),
    (
        '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot name="&x;"/>',
        "document types and entities are refused",
    ),
    (robot("<link/>"), "a <link> without a name"),
    (robot('<link name="a"/><link name="b"/>'), "several root links: a, b"),
    (with_shape('<box size="1 1 x"/>'), "link 'a': box size: '1 1 x' is not 3 finite numbers"),
    (with_shape('<sphere radius="nan"/>'), "link 'a': sphere radius: 'nan' is not"),
    (with_shape('<box size="1 0 1"/>'), "link 'a': box size: 0 is not positive"),
    (with_shape('<cylinder length="2"/>'), "link 'a': cylinder radius: ''"),
    (with_shape(""), "link 'a': <collision> without a geometry"),
    (with_shape("<mesh/>"), "link 'a': mesh filename: no file is named"),
    (
        with_shape('<mesh filename="http://127.0.0.1:1/m.dae"/>'),
        "link 'a': mesh filename: 'http://127.0.0.1:1/m.dae': only package://",
    ),
    (
        with_shape('<mesh filename="package://bullet_lab/meshes/beacon.dae" scale="1 1 0"/>'),
        "link 'a': mesh scale: a scale of 0 leaves nothing",
    ),
    (with_inertia("-1"), "link 'a': mass value: -1 is negative"),
    (with_inertia(ixy="x"), "link 'a': inertia ixy: 'x' is not a finite number"),
    (with_inertia(izz="3"), "link 'a': no body can have .* moments 1, 1, 3"),
    (
        robot('<link name="a"><inertial><mass value="1"/></inertial></link>'),
        "link 'a': no body can have the principal moments 0, 0, 0",
    ),
    (
        robot('<link name="a"><visual><origin xyz="0 0"/><geometry><sphere radius="1"/>'
              "</geometry></visual></link>"),
        "link 'a': origin xyz: '0 0' is not 3 finite numbers",
    ),
    (
        robot('<material name="m"><color rgba="1 1 1"/></material><link name="a"/>'),
        "color rgba: '1 1 1' is not 4 finite numbers",
    ),
    (
        robot(ARM + JOINT.format("", "")),
        "joint 'j': type '' is not simulated; its links are fixed to each other",
    ),
    (
        robot(ARM + JOINT.format("revolute", '<axis xyz="0 0 0"/>')),
        "joint 'j': axis xyz: a zero vector has no direction",
    ),
    (
        robot(ARM + JOINT.format("revolute", '<limit lower="low"/>')),
        "joint 'j': limit lower: 'low' is not a finite number",
    ),
    (
        robot(ARM + JOINT.format("revolute", '<dynamics damping=""/>')),
        "joint 'j': dynamics damping: '' is not a finite number",
    ),
    (
        robot(ARM + '<joint name="j" type="fixed"><parent link="a"/></joint>'),
        "joint 'j': no <child link=…>",
    ),
    (
        robot(ARM + '<joint name="j" type="fixed"><parent link="a"/><child link="x"/></joint>'),
        "joint 'j' has an unknown link 'x'",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("text", "message"), BAD)
def test_bad_urdf_is_one_line_that_names_file_and_place(tmp_path, text, message):
    path = tmp_path / "bad.urdf"
    path.write_text(text)
    with complains(f"^{path}: (.*: )?{message}"):
        read_urdf_file(path)


def test_the_axis_of_a_fixed_joint_may_be_anything(caplog):
    """SolidWorks writes a zero vector."""
    read_urdf(robot(ARM + JOINT.format("fixed", '<axis xyz="0 0 0"/>')), "r")
    assert not caplog.messages


def test_meshes_beside_the_file_are_found_and_those_out_of_its_folder_are_not(tmp_path):
    """What else is outside: see test_resources."""
    path = tmp_path / "robot" / "r.urdf"
    path.parent.mkdir()
    (tmp_path / "secret.stl").touch()
    (path.parent / "mesh.stl").touch()
    path.write_text(with_shape('<mesh filename="mesh.stl"/>'))
    geometry = read_urdf_file(path).links[0].collisions[0].geometry
    assert geometry.path == path.parent / "mesh.stl"
    path.write_text(with_shape('<mesh filename="../secret.stl"/>'))
    with complains("leaves its folder"):
        read_urdf_file(path)
    # The folder is then that of the package.
    (tmp_path / "package.xml").write_text("<package/>")
    assert read_urdf_file(path).links[0].collisions[0].geometry.path.samefile(
        tmp_path / "secret.stl"
    )
