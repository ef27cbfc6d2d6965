import pytest
from message_fields import check, plain
from visualization_msgs.msg import Marker

from bullet_lab.ros.messages.conversions import (
    LARGEST_PLANE,
    Look,
    _marker,
    look_of,
    world_markers,
)
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import Box, Material, Mesh, Plane, Texture, Visual
from bullet_lab.simulation.world.sdf import read_world_file

WORLD = """<sdf version="1.6"><world name="shapes">
  <model name="things"><static>true</static><pose>1 2 0 0 0 1.5707963267948966</pose>
    <link name="l"><pose>0 0 1 0 0 0</pose>
      <visual name="box"><pose>3 0 0 0 0 0</pose>
        <geometry><box><size>1 2 3</size></box></geometry>
        <material><diffuse>0.1 0.2 0.3 0.4</diffuse></material></visual>
      <visual name="can"><geometry>
        <cylinder><radius>0.5</radius><length>2</length></cylinder></geometry></visual>
      <visual name="ball"><geometry><sphere><radius>0.25</radius></sphere></geometry></visual>
      <visual name="floor"><geometry>
        <plane><normal>0 0 1</normal><size>500 4</size></plane></geometry></visual>
      <visual name="beacon"><geometry><mesh>
        <uri>package://bullet_lab/meshes/beacon.dae</uri><scale>1 2 3</scale>
        </mesh></geometry></visual>
      <collision name="unseen"><geometry><box><size>9 9 9</size></box></geometry></collision>
    </link></model>
</world></sdf>"""


@pytest.fixture
def markers(tmp_path):
    path = tmp_path / "shapes.world"
    path.write_text(WORLD)
    with Simulation(read_world_file(path)) as simulation:
        yield world_markers(simulation.models["things"], "map")


def test_each_visible_shape_is_a_marker_of_its_own(markers):
    kinds = [Marker.CUBE, Marker.CYLINDER, Marker.SPHERE, Marker.CUBE, Marker.MESH_RESOURCE]
    assert [marker.type for marker in markers] == kinds
    assert len({marker.id for marker in markers}) == len(markers)
    for marker in markers:
        check(marker, "{ns: things, header.frame_id: map, action: 0}")
    sizes = [plain(marker.scale) for marker in markers]
    floor = sizes.pop(3)
    assert sizes == [[1, 2, 3], [1, 1, 2], [0.5, 0.5, 0.5], [1, 2, 3]]
    assert floor[:2] == [LARGEST_PLANE, 4]
    assert markers[4].mesh_resource == "package://bullet_lab/meshes/beacon.dae"
    # 3 m ahead of a link that is 1 m above a model which looks along y from (1, 2).
    place, turn = [1.0, 5.0, 1.0], [0.0, 0.0, 0.5**0.5, 0.5**0.5]
    assert plain(markers[0].pose) == [pytest.approx(place), pytest.approx(turn)]
    assert plain(markers[0].color) == pytest.approx([0.1, 0.2, 0.3, 0.4])


def test_a_plane_is_drawn_below_its_surface(markers):
    floor = markers[3]
    assert floor.pose.position.z + 0.5 * floor.scale.z < 1.0


def test_meshes_keep_what_they_bring_in_rviz(tmp_path):
    """RViz takes no colour at all for "as the mesh is"."""
    path, green = tmp_path / "m.dae", (0.0, 1.0, 0.0, 1.0)
    path.write_text("<COLLADA><instance_material/></COLLADA>")
    covered = Visual(Mesh(path, ""), colour=green, material=Material(covers=True))
    plain = Visual(Mesh(tmp_path / "m.stl", ""), colour=green)
    found = [_marker(v) for v in (Visual(Mesh(path, "")), covered, plain)]
    assert [m.mesh_use_embedded_materials for m in found] == [True, False, False]
    assert [(m.color.g, m.color.a) for m in found] == [(0, 0), (1, 1), (1, 1)]


def test_what_markers_have_no_field_for_stands_in_their_text(tmp_path):
    texture = Texture(tmp_path / "wood.png", (2.0, 0.5), (0.1, 0.2), 0.3, False, True, True)
    material = Material(emissive=(0.1, 0.0, 0.0, 1.0), texture=texture, lit=False)
    for shape in (Box((1.0, 2.0, 3.0)), Plane(size=(500.0, 4.0))):
        marker = _marker(Visual(shape, material=material))
        assert look_of(marker.text) == Look(material, isinstance(shape, Plane))
    # A picture on it is as large as it was.
    assert plain(marker.scale)[:2] == [500.0, 4.0]
    assert _marker(Visual(Box((1.0, 1.0, 1.0)))).text == ""


NO_LOOKS = """a label
[1]
"x"
{"texture": 3}
{"texture": {}}
{"texture": {"path": "a", "scale": [0, 1]}}
{"texture": {"path": "a", "rotation": "b"}}
{"emissive": [1, 2, NaN, 1]}"""


@pytest.mark.parametrize("text", [*NO_LOOKS.splitlines(), "[" * 100000])
def test_a_text_that_makes_no_sense_is_no_look(text):
    assert look_of(text) == Look()
