"""Pictures of things with materials: where textures lie on shapes, and what colours do in light."""

from dataclasses import replace

import numpy as np
import pytest
from picture_worlds import COLOURS, around_the_middle, picture_of, quarters, thing
from PIL import Image
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.rendering import drawables
from bullet_lab.simulation.world.description import (
    Box,
    Cylinder,
    Light,
    Link,
    Material,
    Mesh,
    Model,
    Plane,
    Sphere,
    Texture,
    Visual,
)

EYE = Pose((-3.0, 0.0, 0.0))


@pytest.fixture
def four(tmp_path):
    """The file of a picture whose quarters have four colours."""
    path = tmp_path / "quarters.png"
    Image.fromarray(quarters()).save(path)
    return path


def with_visual(visual):
    return Model("m", (Link("l", visuals=(visual,)),), static=True)


def seen(geometry, texture, eye=EYE, **material):
    """The picture of a thing with a texture."""
    visual = Visual(geometry, material=Material(texture=texture, **material))
    return picture_of(with_visual(visual), eye=eye)


def quarters_seen(picture, offset=30):
    """Which of the colours are around the middle, in their order."""
    gaps = np.abs(COLOURS - around_the_middle(picture, offset)[:, None]).sum(axis=2)
    assert gaps.min(axis=1).max() <= 12
    return gaps.argmin(axis=1).tolist()


BOX = Box((1.0, 0.8, 0.6))
SHAPES = {
    "box": BOX,
    "plane": Plane((0, 0, 1), (1.0, 0.8)),
    "wall": Plane((1, 0, 0), (1.0, 0.8)),
    "cylinder": Cylinder(0.5, 1.0),
    "ball": Sphere(0.7),
}


@cases("""
shape, place, turns, offset, wanted:
  # The place of the eye, its roll, pitch and yaw in quarters of a turn, how far from the middle it
  # looks, in pixels, and the colours there, upright or upside down.
  - [box, [-3, 0, 0], [0, 0, 0], 30, &upright [0, 1, 2, 3]]
  - [box, [3, 0, 0], [0, 0, 2], 30, *upright]
  - [box, [0, -3, 0], [0, 0, 1], 30, *upright]
  - [box, [0, 3, 0], [0, 0, -1], 30, *upright]
  # With x upwards, and with -x.
  - [box, [0, 0, 3], [0, 1, 0], 30, *upright]
  - [box, [0, 0, -3], [0, -1, 0], 30, *upright]
  # Seen from above with y upwards, and from ahead with z upwards.
  - [plane, [0, 0, 3], [0, 1, 1], 30, *upright]
  - [wall, [3, 0, 0], [0, 0, 2], 30, *upright]
  # A cylinder's seam is at y: half of the picture is on the other side. The picture's ends
  # meet at the seam, upside down: its right is at the left.
  - [cylinder, [0, -3, 0], [0, 0, 1], 30, [3, 2, 1, 0]]
  - [cylinder, [0, 3, 0], [0, 0, -1], 8, [2, 3, 0, 1]]
  # A ball's poles are on y; from -z, with y upwards.
  - [ball, [0, 0, -3], [-1, -1, 0], 30, *upright]
""")
def test_where_a_picture_lies_on_a_shape(four, shape, place, turns, offset, wanted):
    eye = Pose.from_rpy(place, np.multiply(0.5 * np.pi, turns))
    picture = seen(SHAPES[shape], Texture(four), eye)
    assert quarters_seen(picture, offset) == wanted


@cases("""
scale, scroll, turn, repeats, offset, wanted:
  # Scale, scroll and rotation (rad), whether it repeats, and where which colours are seen.
  # Half as large, about the middle: a whole picture between the quarters of its sides.
  - [[0.5, 0.5], [0, 0], 0, true, 25, [0, 1, 2, 3]]
  - [[0.5, 0.5], [0, 0], 0, true, 75, [3, 2, 1, 0]]
  - [[0.5, 0.5], [0, 0], 0, false, 75, [0, 1, 2, 3]]
  - [[1, 1], [0.5, 0], 0, true, 30, [1, 0, 3, 2]]
  - [[1, 1], [0, 0], 3.14159, true, 30, [3, 2, 1, 0]]
""")
def test_scale_tiles_and_scroll_shifts(four, scale, scroll, turn, repeats, offset, wanted):
    texture = Texture(four, tuple(scale), tuple(scroll), turn, repeats=repeats)
    picture = seen(Box((1.0, 1.0, 1.0)), texture)
    assert quarters_seen(picture, offset) == wanted


def test_sharp_pictures_have_square_pixels(tmp_path):
    Image.fromarray(np.array([[0, 255], [255, 0]], np.uint8)).save(tmp_path / "tiny.png")
    for sharp in (True, False):
        picture = seen(Box((1.0, 1.0, 1.0)), Texture(tmp_path / "tiny.png", sharp=sharp))
        inner = picture[190:230, 270:310]
        assert (np.ptp(inner) == 0) == sharp


def test_a_picture_on_several_things_is_loaded_once(four, monkeypatch):
    loaded, blank = [], np.zeros((4, 4, 4), np.uint8)
    monkeypatch.setattr(drawables, "read_pixels", lambda one: loaded.append(one) or blank)
    thin = Visual(Box((0.1, 0.2, 0.3)), material=Material(texture=Texture(four)))
    picture_of(*(replace(with_visual(thin), name=name) for name in "ab"), eye=EYE)
    other = replace(thin, geometry=Sphere(0.2))
    picture_of(with_visual(thin), replace(with_visual(other), name="other"), eye=EYE)
    assert len(loaded) == 2


DIM = (0.4, 0.4, 0.4, 1.0)
AHEAD = Light("l", "directional", Pose(), (0.5, 0.5, 0.5, 1.0), (1.0, 0.0, 0.0))


def in_light(visual, *behind, light=AHEAD):
    """The colour in the picture of a plate across the view, in dim light and another."""
    model = with_visual(visual)
    return picture_of(model, *behind, eye=EYE, ambient=DIM, lights=(light,))[240, 320] / 255


@cases("shine, specular, red: [[0.1, 0.2, 5], [0.1, 0.0, 0], [0.0, 0.2, 0]]")
def test_wide_highlights_of_a_sun(shine, specular, red):
    # Gazebo 11.1 shows Gazebo/Blue as (4, 4, 255) in the sun; a sun's specular is 0.2 there.
    plate = Visual(BOX, colour=(0.0, 0.0, 1.0, 1.0), material=Material(shine=shine))
    light = replace(AHEAD, specular=3 * (specular,) + (1.0,))
    assert in_light(plate, light=light)[:2].tolist() == [red / 255, red / 255]


@cases("""
ambient, emissive, lit, wanted:
  # Ambient and emissive colour, and whether it is lit; what is seen.
  - [null, [0.0, 0.0, 0.0, 1.0], true, [0.45, 0.0, 0.9]]
  - [[0.0, 1.0, 0.5, 1.0], [0.0, 0.0, 0.0, 1.0], true, [0.25, 0.4, 0.7]]
  - [null, [0.2, 0.1, 0.0, 1.0], true, [0.65, 0.1, 0.9]]
  - [[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0], false, [0.5, 0.0, 1.0]]
""")
def test_ambient_and_emissive_colours(tmp_path, ambient, emissive, lit, wanted):
    material = Material(ambient and tuple(ambient), tuple(emissive), lit=lit)
    visual = Visual(Box((0.1, 1.0, 1.0)), colour=(0.5, 0.0, 1.0, 1.0), material=material)
    assert in_light(visual) == pytest.approx(wanted, abs=0.005)
    # A picture multiplies what is lit and what glows.
    Image.new("RGB", (4, 4), (102, 204, 51)).save(tmp_path / "flat.png")
    textured = replace(material, texture=Texture(tmp_path / "flat.png"))
    seen = in_light(replace(visual, material=textured))
    assert seen == pytest.approx(np.multiply(wanted, (0.4, 0.8, 0.2)), abs=0.006)


@pytest.mark.parametrize(
    ("blends", "wanted"), [(True, (0.2 * 0.9, 0.8 * 0.9, 0.0)), (False, (0.9, 0.0, 0.0))]
)
def test_a_picture_that_blends_shows_what_is_behind_it(tmp_path, blends, wanted):
    Image.new("RGBA", (4, 4), (255, 0, 0, 51)).save(tmp_path / "glass.png")
    wall = thing("wall", Box((0.1, 9.0, 9.0)), Pose((1.0, 0, 0)), (0.0, 1.0, 0.0, 1.0))
    texture = Texture(tmp_path / "glass.png", blends=blends)
    plate = Visual(Box((0.1, 1.0, 1.0)), material=Material(texture=texture))
    assert in_light(plate, wall) == pytest.approx(wanted, abs=0.01)


# Meshes

COLLADA = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="1"/></asset>
<library_images><image id="i"><init_from>{picture}</init_from></image></library_images>
<library_effects>
<effect id="e0"><profile_COMMON>
  <newparam sid="s"><surface type="2D"><init_from>i</init_from></surface></newparam>
  <newparam sid="t"><sampler2D><source>s</source></sampler2D></newparam>
  <technique sid="c"><lambert><ambient><color>1 1 1 1</color></ambient>
  <diffuse><texture texture="t" texcoord="u"/></diffuse></lambert></technique>
</profile_COMMON></effect>
<effect id="e1"><profile_COMMON><technique sid="c"><phong>
  <emission><color>0 0 0.2 1</color></emission><ambient><color>0 0 0 1</color></ambient>
  <diffuse><color>0.8 0.4 0 1</color></diffuse></phong></technique></profile_COMMON></effect>
</library_effects>
<library_materials><material id="m0"><instance_effect url="#e0"/></material>
<material id="m1"><instance_effect url="#e1"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="24">0 1 -.5 0 0 -.5 0 0 .5 0 1 .5
 0 0 -.5 0 -1 -.5 0 -1 .5 0 0 .5</float_array>
 <technique_common><accessor source="#pa" count="8" stride="3"><param name="X" type="float"/>
 <param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<source id="n"><float_array id="na" count="3">-1 0 0</float_array><technique_common>
 <accessor source="#na" count="1" stride="3"><param name="X" type="float"/>
 <param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<source id="u"><float_array id="ua" count="8">0 0 1 0 1 1 0 1</float_array>
 <technique_common><accessor source="#ua" count="4" stride="2"><param name="S" type="float"/>
 <param name="T" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles material="a" count="2"><input semantic="VERTEX" source="#v" offset="0"/>
 <input semantic="NORMAL" source="#n" offset="1"/>
 <input semantic="TEXCOORD" source="#u" offset="2" set="0"/>
 <p>0 0 0 1 0 1 2 0 2 0 0 0 2 0 2 3 0 3</p></triangles>
<polylist material="b" count="1"><input semantic="VERTEX" source="#v" offset="0"/>
 <vcount>4</vcount><p>4 5 6 7</p></polylist>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="w"><node><instance_geometry url="#g"><bind_material>
<technique_common><instance_material symbol="a" target="#m0"/>
<instance_material symbol="b" target="#m1"/></technique_common></bind_material>
</instance_geometry></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#w"/></scene></COLLADA>"""


def collada_seen(
    folder, picture, material=None, colour=(1.0, 1.0, 1.0, 1.0), text=COLLADA, flip=False
):
    """What is seen of the quarters of the picture, and beside it; the sides changed if `flip`."""
    (folder / "model.config").write_text("<model/>")
    path = folder / "meshes" / "two.dae"
    path.parent.mkdir(exist_ok=True)
    path.write_text(text.format(picture=picture))
    visual = Visual(Mesh(path, path.name), colour=colour, material=material or Material())
    picture = picture_of(with_visual(visual), eye=EYE, ambient=DIM, lights=(AHEAD,))
    # A metre is 167 pixels; the left half has the picture.
    columns = (370, 440) if flip else (200, 270)
    spots = [(v, u) for v in (200, 280) for u in columns]
    return np.array([picture[spot] for spot in spots], int), picture[240, 400] / 255


@cases(r"""
named:
  - ../quarters.png
  - quarters.png
  - C:\own\quarters.png
""")
def test_collada_with_a_picture_and_with_a_colour(tmp_path, four, named):
    if named != "../quarters.png":
        # Where Gazebo's models have them.
        textures = tmp_path / "materials" / "textures"
        textures.mkdir(parents=True)
        four.rename(textures / "quarters.png")
    left, right = collada_seen(tmp_path, named)
    assert left == pytest.approx(COLOURS * 0.9, abs=3)
    assert right == pytest.approx((0.8 * 0.5, 0.4 * 0.5, 0.2), abs=0.01)


def test_a_visuals_material_covers_that_of_its_mesh(tmp_path, four):
    green = (0.0, 1.0, 0.0, 1.0)
    left, right = collada_seen(tmp_path, "../quarters.png", colour=green)
    assert right == pytest.approx((0.4, 0.2, 0.2), abs=0.01)
    left, right = collada_seen(tmp_path, "../quarters.png", Material(covers=True), green)
    assert left / 255 == pytest.approx(np.tile((0.0, 0.9, 0.0), (4, 1)), abs=0.01)
    assert right == pytest.approx((0.0, 0.9, 0.0), abs=0.01)


@cases("""
old, new, said:
  - [<asset>, <asset>, 'two.dae: ''meshes/gone.png'': no such file']
  - ['<init_from>{picture}</init_from>', '', 'two.dae: ''meshes/i'': no such file']
  - ['<init_from>{picture}</init_from>', <init_from/>, 'two.dae: ''meshes/i'': no such file']
  - [<instance_effect url="#e0"/>, <instance_effect url="#gone"/>, '']
  - [target="#m0", target="#gone", '']
""")
def test_a_mesh_whose_material_is_broken_is_drawn_without(tmp_path, caplog, old, new, said):
    assert old in COLLADA
    left, right = collada_seen(tmp_path, "gone.png", text=COLLADA.replace(old, new))
    assert left / 255 == pytest.approx(np.full((4, 3), 0.9), abs=0.01)
    assert right == pytest.approx((0.4, 0.2, 0.2), abs=0.01)
    assert [said in line for line in caplog.messages] == [True] * bool(said)


def test_normals_tell_the_outside_of_a_mirrored_mesh(tmp_path, four):
    mirrored = COLLADA.replace("<node>", "<node><scale>1 -1 1</scale>")
    left, _ = collada_seen(tmp_path, "../quarters.png", text=mirrored, flip=True)
    assert left == pytest.approx(COLOURS[[1, 0, 3, 2]] * 0.9, abs=3)


def test_colours_and_normals_of_an_obj(tmp_path):
    (tmp_path / "m.mtl").write_text("newmtl a\nKa 0 1 0\nKd 0.5 0 1\nKe 0.1 0 0\nd 1\n")
    # A plate across the view whose normals say that it looks up.
    (tmp_path / "m.obj").write_text(
        "mtllib m.mtl\nusemtl a\nv 0 1 -1\nv 0 -1 -1\nv 0 -1 1\nv 0 1 1\nvn 0 0 1\n"
        "f 1//1 2//1 3//1 4//1\n"
    )
    visual = Visual(Mesh(tmp_path / "m.obj", "m.obj"))
    assert in_light(visual) == pytest.approx((0.1, 0.4, 0.0), abs=0.01)
    down = Light("l", "directional", Pose(), (0.5, 0.5, 0.5, 1.0), (0.0, 0.0, -1.0))
    assert in_light(visual, light=down) == pytest.approx((0.35, 0.4, 0.5), abs=0.01)


def test_a_picture_by_a_script_on_a_mesh(tmp_path, four):
    (tmp_path / "m.obj").write_text(
        "v 0 .5 -.5\nv 0 -.5 -.5\nv 0 -.5 .5\nv 0 .5 .5\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
        "f 1/1 2/2 3/3 4/4\n"
    )
    mesh = Mesh(tmp_path / "m.obj", "m.obj")
    assert quarters_seen(seen(mesh, Texture(four), covers=True)) == [0, 1, 2, 3]
