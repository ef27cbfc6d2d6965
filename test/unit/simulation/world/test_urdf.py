from shared import cases, complains

from bullet_lab.simulation.world.urdf import read_urdf, read_urdf_file

INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
ARM = f'<link name="a">{INERTIAL}</link><link name="b">{INERTIAL}</link>'


def robot(inside):
    return f'<robot name="r">{inside}</robot>'


def with_shape(shape):
    return robot(f'<link name="a"><collision><geometry>{shape}</geometry></collision></link>')


def test_what_xacro_has_not_expanded_is_named_once(caplog):
    link = f'<link name="a">{INERTIAL}<box_inertia mass="1"/><collision><geometry>'
    shape = '<box size="1 1 1"/></geometry></collision></link>'
    read_urdf(robot(f'<my_body/>{link}{shape}<my_body/><x:a xmlns:x="n"/>'), "text")
    left_out = "text: <{0}> is not known and left out; if it is a macro of xacro, it is called"
    assert caplog.messages == [
        f"{left_out} <xacro:{{0}}>".format(name) for name in ("my_body", "box_inertia")
    ]


@cases("""
text, message:
  - ['', not well-formed XML]
  - [<sdf/>, 'the root element is <sdf>, not <robot>']
  - ['<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot name="&x;"/>', document types and
     entities are refused]
  - [<robot name="r"><link/></robot>, a <link> without a name]
  - [<robot name="r"><link name="a"/><link name="b"/></robot>, 'several root links: a, b']
  - [<robot name="r"><link name="a"><inertial><mass value="1"/></inertial></link></robot>, 'link
     ''a'': no body can have the principal moments 0, 0, 0']
  - - <robot name="r"><link name="a"/><joint name="j" type="fixed"><parent
      link="a"/></joint></robot>
    - 'joint ''j'': no <child link=…>'
""")
def test_bad_urdf_is_one_line_that_names_file_and_place(tmp_path, text, message):
    path = tmp_path / "bad.urdf"
    path.write_text(text)
    with complains(f"^{path}: (.*: )?{message}"):
        read_urdf_file(path)


def test_the_axis_of_a_fixed_joint_may_be_anything(caplog):
    """SolidWorks writes a zero vector."""
    ends = '<parent link="a"/><child link="b"/><axis xyz="0 0 0"/>'
    read_urdf(robot(f'{ARM}<joint name="j" type="fixed">{ends}</joint>'), "r")
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
