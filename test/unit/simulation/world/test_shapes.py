import math
import os
import struct

import numpy as np
import pytest
import yaml

from bullet_lab.errors import LabError
from bullet_lab.simulation.physics.physics import SHAPES as BODIES
from bullet_lab.simulation.world import shapes
from bullet_lab.simulation.world.mesh_parts import mesh_parts
from bullet_lab.simulation.world.shapes import (
    Box,
    Cylinder,
    Mesh,
    Plane,
    Shape,
    Sphere,
    load_triangles,
)

MATRIX = "0.25 0 0 0 0 0.25 0 0 0 0 1 1 0 0 0 1"
STL = (
    "solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex {} 0 0\nvertex 0 1 0\n"
    "endloop\nendfacet\nendsolid\n"
)
CORNERS = [[0, 0, 0], [2, 0, 0], [0, 1, 0]]


@pytest.fixture(scope="module")
def beacon_text(package):
    return (package / "meshes" / "beacon.dae").read_text()


@pytest.fixture
def load(tmp_path):
    def load(name, content, scale=(1.0, 1.0, 1.0)):
        path = tmp_path / name
        if content is not None:
            path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return load_triangles(Mesh(path, name, scale))

    return load


def binary_stl(corners, count=1):
    numbers = np.array([(0, 0, 1), *corners], "<f4").tobytes() + b"\0\0"
    return 80 * b" " + struct.pack("<I", count) + numbers


def extent(triangles):
    return np.array([triangles.vertices.min(axis=0), triangles.vertices.max(axis=0)])


def test_the_transform_and_the_scale_size_the_beacon(load, beacon_text):
    assert extent(load("b.dae", beacon_text)) == pytest.approx(
        np.array([[-0.25, -0.25, 0], [0.25, 0.25, 2]])
    )
    changed = beacon_text.replace(MATRIX, "0.5 0 0 0 0 0.5 0 0 0 0 0.75 0.75 0 0 0 1")
    assert extent(load("b.dae", changed, (2.0, 1.0, 1.0))) == pytest.approx(
        np.array([[-1.0, -0.5, 0], [1.0, 0.5, 1.5]])
    )
    inches = changed.replace('meter="1"', 'meter="0.0254"')
    assert extent(load("b.dae", inches))[1] == pytest.approx((0.0127, 0.0127, 0.0381))


# Beside the beacon, a smaller one in a node within a node, and that again, elsewhere.
NODES = """<node name="group"><translate>5 0 0</translate><node name="small">
  <scale>0.1 0.1 0.1</scale><instance_geometry url="#beacon-mesh"/></node></node>
<node id="again" name="other"><translate>0 3 0</translate>
  <instance_geometry url="#beacon-mesh"/></node></visual_scene>"""
# Two triangles in objects, of two materials the second, and one in a group with two names.
PARTS = """mtllib gone.mtl
o first one
v 0 0 0
v 1 0 0
v 0 1 0
f 1 2 3
o second
v 5 5 5
v 6 5 5
v 5 6 5
usemtl red
f -3 -2 -1
usemtl green
f 4 6 5
g third fourth
f 1 2 6
"""


@pytest.fixture
def bounds_of(tmp_path, beacon_text):
    """Return the bounds of a submesh of a file, by its triangles and by what is seen of it."""
    texts = {
        "m.dae": beacon_text.replace("</visual_scene>", NODES),
        "m.obj": PARTS,
        "m.stl": STL.format("2"),
    }

    def read(name, submesh, centred=False):
        path = tmp_path / name
        path.write_text(texts[name])
        mesh = Mesh(path, "", (2.0, 1.0, 1.0), submesh, centred)
        corners = np.concatenate([part.corners.reshape(-1, 3) for part in mesh_parts(mesh)])
        assert mesh.bounds() == pytest.approx(np.array((corners.min(axis=0), corners.max(axis=0))))
        return mesh.bounds()

    return read


SUBMESHES = """
- [m.dae, beacon, false, [[-0.5, -0.25, 0], [0.5, 0.25, 2]]]
- [m.dae, small, false, [[9.8, -0.1, -0.1], [10.2, 0.1, 0.1]]]
- [m.dae, small, true, [[-0.2, -0.1, -0.1], [0.2, 0.1, 0.1]]]
- [m.dae, other, false, [[-2, 2, -1], [2, 4, 1]]]
- [m.obj, first one, false, [[0, 0, 0], [2, 1, 0]]]
- [m.obj, second, false, [[10, 5, 5], [12, 6, 5]]]
- [m.obj, second, true, [[-1, -0.5, 0], [1, 0.5, 0]]]
- [m.obj, third, false, [[0, 0, 0], [10, 6, 5]]]
"""


@pytest.mark.parametrize("name, submesh, centred, bounds", yaml.safe_load(SUBMESHES))
def test_a_part_of_a_file_by_the_name_of_its_node_object_or_group(
    bounds_of, caplog, name, submesh, centred, bounds
):
    assert bounds_of(name, submesh, centred) == pytest.approx(np.array(bounds))
    assert caplog.messages == []


@pytest.mark.parametrize("name", ["m.dae", "m.obj", "m.stl"])
def test_without_such_a_part_the_whole_mesh_is_used(bounds_of, caplog, name):
    assert np.array_equal(bounds_of(name, "fourth"), bounds_of(name, ""))
    assert f"{name}: no submesh 'fourth'; the whole mesh is used" in caplog.text


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.stl", STL.format("2")),
        ("c.STL", binary_stl(CORNERS)),
        ("d.obj", "v 0 0 0\nv 2 0 0\nv 0 1 0\nf 1 2 3\n"),
    ],
)
def test_stl_and_obj(load, name, content):
    triangles = load(name, content, (1.0, 2.0, 1.0))
    assert not (triangles.vertices.flags.writeable or triangles.faces.flags.writeable)
    corners = triangles.vertices[triangles.faces[0]]
    assert corners == pytest.approx(np.array(CORNERS) * (1, 2, 1))


def test_indices_of_an_obj_that_count_back(load):
    text = "v 9 9 9\nv 0 0 0\nv 2 0 0\nv 0 1 0\nvn 0 0 1\nf -3//-1 -2//-1 -1//-1\nv 5 5 5\n"
    triangles = load("d.obj", text)
    assert triangles.vertices[triangles.faces].tolist() == [CORNERS]


BAD = r"""
e.dae: ['', not well-formed XML]
e.stl: ['', no triangles]
g.obj: [garbage, no triangles]
one_of_two.obj: ["v 0 0 0\nv 1 0 0\nv 0 1 0\nv nan 0 0\nf 1 2 3\nf 1 2 4\n", finite]
word.obj: ["v 0 0 x\nf 1 1 1\n", not a readable mesh]
flat.obj: ["v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", a corner needs three coordinates]
index.obj: ["v 0 0 0\nv 1 0 0\nf 1 2 99\n", not a readable mesh|unknown corner]
back.obj: ["v 0 0 0\nv 2 0 0\nv 0 1 0\nf 1 2 -4\n", index -4 of 3]
points.obj: ["v 0 0 0\nv 1 1 1\n", not a readable mesh]
a.ply: [ply, 'unknown kind of mesh; use .dae, .stl, .obj']
plain.dae: [<COLLADA/>, there is no scene]
nix.stl: [null, No such file or directory$]
nix.dae: [null, No such file or directory$]
"""
BAD = {
    **yaml.safe_load(BAD),
    "t.stl": (binary_stl(CORNERS)[:100], "neither a whole binary mesh nor text"),
    "count.stl": (binary_stl(CORNERS, count=9), "mesh"),
    "one_of_two.stl": (STL.format("2").replace("endsolid\n", STL.format("nan")[8:]), "finite"),
    "binary_nan.stl": (binary_stl([[0, 0, np.nan], [1, 0, 0], [0, 1, 0]]), "finite"),
    "latin.dae": ("<ü/>".encode("latin-1"), "not UTF-8 text"),
}


def test_names_in_other_encodings_do_not_matter(load):
    text = "# gr\u00fcn\no t\u00fcr\nv 0 0 0\nv 2 0 0\nv 0 1 0\nf 1 2 3\n".encode("latin-1")
    assert load("a.obj", text).vertices.tolist() == CORNERS
    text = STL.format("2").replace("solid x", "solid t\u00fcr").encode("latin-1")
    assert load("a.stl", text).vertices.tolist() == CORNERS


@pytest.mark.parametrize("name", BAD)
def test_a_bad_mesh_is_one_line_that_names_the_file(load, tmp_path, name):
    content, message = BAD[name]
    with pytest.raises(LabError, match=message) as caught:
        load(name, content)
    assert str(caught.value).startswith(f"{tmp_path / name}: ")
    assert "\n" not in str(caught.value)


BROKEN = """
- ['<COLLADA ', '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]><COLLADA ', document types
   and entities are refused]
- [0.25 0 0 0 0 0.25 0 0 0 0 1 1 0 0 0 1, wide 0 0 0 0 wide 0 0 0 0 1 1 0 0 0 1, not a readable
   mesh]
- [0.25 0 0 0 0 0.25 0 0 0 0 1 1 0 0 0 1, nan 0 0 0 0 nan 0 0 0 0 1 1 0 0 0 1, finite]
- [0.991445 0.130526 -1, nan 0.130526 -1, a number is not finite]
- [0.991445 0.130526 -1, x 0.130526 -1, not a readable mesh]
- ['48 49 78 ', '48 49 7800 ', not a readable mesh]
- ['48 49 78 ', '-48 49 78 ', a triangle has an unknown corner]
- [triangles, polygon_soup, no triangles]
- [url="#beacon-mesh", url="#nix", no triangles]
- [meter="1", meter="long", '<unit>: ''long'' is not a finite number']
"""


@pytest.mark.parametrize("old, new, message", yaml.safe_load(BROKEN))
def test_a_broken_collada_file_is_one_line(load, beacon_text, tmp_path, old, new, message):
    assert old in beacon_text
    broken = beacon_text.replace(old, new)
    with pytest.raises(LabError, match=message) as caught:
        load("b.dae", broken)
    with pytest.raises(LabError, match=message):
        mesh_parts(Mesh(tmp_path / "b.dae", ""))
    assert str(tmp_path / "b.dae") in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_huge_mesh_is_refused(load, tmp_path):
    (tmp_path / "a.stl").touch()
    os.truncate(tmp_path / "a.stl", 200_000_001)
    with pytest.raises(LabError, match="larger than 200000000 bytes$"):
        load("a.stl", None)


def test_an_alien_encoding_hides_nothing_from_the_check(load, beacon_text):
    # In UTF-7 this is a document type that reads a file; nothing decodes it.
    hidden = "+ADwAIQ-DOCTYPE x +AFsAPAAh-ENTITY a SYSTEM 'file:///etc/passwd'+AD4AXQA+-"
    body = beacon_text.split("?>", 1)[1]
    with pytest.raises(LabError, match="not well-formed XML"):
        load("b.dae", f'<?xml version="1.0" encoding="utf-7"?>{hidden}{body}')


def stored(vertices, folder):
    """A mesh file with a triangle for each three of the vertices."""
    lines = ["v " + " ".join(map(repr, vertex)) for vertex in np.asarray(vertices).tolist()]
    lines += [f"f {i} {i + 1} {i + 2}" for i in range(1, len(lines), 3)]
    path = folder / "mesh.obj"
    path.write_text("\n".join(lines) + "\n")
    return Mesh(path, "")


def random_ball(count):
    points = np.random.default_rng(3).normal(size=(count, 3))
    points *= (0.3, 2.0, 40.0) / np.linalg.norm(points, axis=1, keepdims=True)
    return points


def test_a_hull_has_each_corner_once(tmp_path):
    mesh = stored(CORNERS + CORNERS[::-1], tmp_path)
    assert sorted(shapes.hull_corners(mesh).tolist()) == sorted(CORNERS)


def test_a_hull_of_too_many_corners_is_the_same_to_a_thousandth(tmp_path, monkeypatch):
    monkeypatch.setattr(shapes, "MOST_CORNERS", 20_000)
    points = random_ball(30_000)
    mesh = stored(points, tmp_path)
    corners = shapes.hull_corners(mesh)
    assert len(corners) <= 20_000
    assert {*map(tuple, corners.tolist())} <= {*map(tuple, points.tolist())}
    for direction in np.random.default_rng(4).normal(size=(50, 3)):
        direction /= np.linalg.norm(direction)
        reach = (points @ direction).max()
        assert 0.0 <= reach - (corners @ direction).max() <= 1e-3 * reach


def test_triangles_in_pieces(tmp_path, monkeypatch):
    monkeypatch.setattr(shapes, "MOST_CORNERS", 8)
    points = random_ball(12)
    mesh = stored(points, tmp_path)
    pieces = shapes.triangle_corners(mesh)
    assert [len(piece) for piece in pieces] == [6, 6]
    assert np.array_equal(np.concatenate(pieces), points)


SOLIDS = [Box((0.4, 1.0, 2.0)), Cylinder(0.3, 1.2), Sphere(0.7)]
# The greatest corner, and the distances of a point inside and one outside.
SIZES = [((0.2, 0.5, 1.0), 0.2, 0.5), ((0.3, 0.3, 0.6), 0.2, 0.4), ((0.7, 0.7, 0.7), 0.6, 0.0)]


def test_a_plane_has_no_end():
    assert Plane().bounds().tolist() == [[-math.inf] * 3, [math.inf] * 3]
    assert Plane() == Plane((0.0, 0.0, 1.0), (100.0, 100.0))
    assert Plane((0.0, 3.0, 4.0)).distance((9.0, 0.0, 1.0)) == pytest.approx(0.8)


@pytest.mark.parametrize("shape, size", [*zip(SOLIDS, SIZES)])
def test_a_shape_has_its_size(shape, size):
    corner, inside, outside = size
    assert np.ravel(shape.bounds()) == pytest.approx([-value for value in corner] + [*corner])
    assert shape.distance((0.0, -0.1, 0.0)) == pytest.approx(inside)
    assert shape.distance((0.7, 0.0, 0.0)) == pytest.approx(outside)


def test_all_that_makes_something_of_shapes_knows_each():
    pytest.importorskip("rospy")
    from bullet_lab.ros.messages.conversions import MARKERS

    kinds = set(Shape.__subclasses__())
    assert set(MARKERS) == kinds
    # A mesh is made by its corners.
    assert set(BODIES) == kinds - {Mesh}
