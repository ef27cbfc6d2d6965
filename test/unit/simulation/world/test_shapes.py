import math
import os
import struct
from pathlib import Path

import numpy as np
import pytest
import yaml
from alike import assert_as_before, lines_of
from shared import cases

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

HERE = Path(__file__).parent
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
    numbers = np.array([(0.1, 0, 1), *corners], "<f4").tobytes() + b"\0\0"
    return 80 * b" " + struct.pack("<I", count) + numbers


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


# Files, and the submesh that is used of them, which may be centred.
USED = """
- [beacon.dae, '', false]
- [changed.dae, '', false]
- [inches.dae, '', false]
- [nodes.dae, beacon, false]
- [nodes.dae, small, false]
- [nodes.dae, small, true]
- [nodes.dae, other, false]
- [parts.obj, first one, false]
- [parts.obj, second, false]
- [parts.obj, second, true]
- [parts.obj, third, false]
# Without such a part, the whole mesh is used.
- [nodes.dae, fourth, false]
- [parts.obj, fourth, false]
- [text.stl, fourth, false]
- [binary.STL, '', false]
- [plain.obj, '', false]
- [counts_back.obj, '', false]
- [latin.obj, '', false]
- [latin.stl, '', false]
"""


def test_meshes_and_their_parts_are_as_before(tmp_path, beacon_text, caplog):
    changed = beacon_text.replace(MATRIX, "0.5 0 0 0 0 0.5 0 0 0 0 0.75 0.75 0 0 0 1")
    plain = "v 0 0 0\nv 2 0 0\nv 0 1 0\nf 1 2 3\n"
    back = "v 9 9 9\nv 0 0 0\nv 2 0 0\nv 0 1 0\nvn 0 0 1\nf -3//-1 -2//-1 -1//-1\nv 5 5 5\n"
    texts = {
        "beacon.dae": beacon_text,
        "changed.dae": changed,
        "inches.dae": changed.replace('meter="1"', 'meter="0.0254"'),
        "nodes.dae": beacon_text.replace("</visual_scene>", NODES),
        "parts.obj": PARTS,
        "text.stl": STL.format("2"),
        "plain.obj": plain,
        "counts_back.obj": back,
        "latin.obj": "# gr\u00fcn\no t\u00fcr\n" + plain,
        "latin.stl": STL.format("2").replace("solid x", "solid t\u00fcr"),
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text, "latin-1" if name[:5] == "latin" else None)
    (tmp_path / "binary.STL").write_bytes(binary_stl(CORNERS))
    told = []
    for name, submesh, centred in yaml.safe_load(USED):
        mesh = Mesh(tmp_path / name, "", (2.0, 1.0, 1.0), submesh, centred)
        place = f"{submesh or 'all'} of {name}"
        seen = np.concatenate([part.corners.reshape(-1, 3) for part in mesh_parts(mesh)])
        assert mesh.bounds() == pytest.approx(np.array((seen.min(axis=0), seen.max(axis=0))))
        triangles = load_triangles(mesh)
        assert not (triangles.vertices.flags.writeable or triangles.faces.flags.writeable)
        told += lines_of(mesh.bounds(), f"bounds of {place}")
        if len(triangles.faces) == 1:
            told += lines_of(triangles.vertices[triangles.faces], f"corners of {place}")
    told += [line.replace(f"{tmp_path}/", "") for line in caplog.messages]
    assert_as_before(told, HERE / "meshes.txt")


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


@pytest.mark.parametrize("name", BAD)
def test_a_bad_mesh_is_one_line_that_names_the_file(load, tmp_path, name):
    content, message = BAD[name]
    with pytest.raises(LabError, match=message) as caught:
        load(name, content)
    assert str(caught.value).startswith(f"{tmp_path / name}: ")
    assert "\n" not in str(caught.value)


@cases("""
old, new, message:
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
""")
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
    assert corners.sum(axis=0) == pytest.approx((-0.15007205, 0.20084405, 2.50116006))
    assert {*map(tuple, corners.tolist())} <= {*map(tuple, points.tolist())}
    for direction in np.random.default_rng(4).normal(size=(50, 3)):
        direction /= np.linalg.norm(direction)
        reach = (points @ direction).max()
        assert 0.0 <= reach - (corners @ direction).max() <= 1e-3 * reach
    flat = stored(points * (1.0, 1.0, 0.0), tmp_path)
    assert len(shapes.hull_corners(flat)) > 100


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
