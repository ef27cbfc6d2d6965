import os
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from picture_worlds import (
    CAMERA,
    COLOURS,
    around_the_middle,
    picture_of,
    plate,
    quarters,
    thing,
    write_plate,
)
from PIL import Image
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.rendering.drawables import read_pixels, surfaces_of
from bullet_lab.simulation.world.description import Mesh

AHEAD = Pose((0.0, 0.0, 0.5))


def flat(colour):
    return np.full((32, 32, 3), colour, np.uint8)


def test_one_file_name_with_two_contents(tmp_path):
    for colour in COLOURS[:2]:
        path = write_plate(tmp_path, "same", flat(colour), 0.8, 0.8)
        picture = picture_of(plate(path, Pose((4.0, 0.0, 0.5))), eye=AHEAD)
        assert picture[240, 320] == pytest.approx(colour, abs=2)


def test_faces_that_show_a_single_point_have_its_colour(tmp_path):
    path = write_plate(tmp_path, "quarters", quarters(), 1.0, 1.0)
    corners = ((-0.6, -0.2), (-1.0, -0.2), (-1.0, 0.2), (-0.6, 0.2))
    more = "".join(f"v 0 {a} {b}\n" for a, b in corners)
    path.write_text(f"{path.read_text()}vt 0.75 0.75\n{more}f -4/5 -3/5 -2/5 -1/5\n")
    (tmp_path / "quarters.mtl").write_text("newmtl face\nKd .5 1 .5\nmap_Kd quarters.png\n")
    picture = picture_of(thing("m", Mesh(path, path.name), Pose((3.0, 0, 0.5))), eye=AHEAD)
    wanted = COLOURS * (0.5, 1, 0.5)
    assert picture[240, 320 + round(0.8 * CAMERA.fx / 3)] == pytest.approx(wanted[1], abs=2)
    assert around_the_middle(picture) == pytest.approx(wanted, abs=3)


@cases("side: [3, 10, 63]")
def test_pictures_of_any_width(tmp_path, side):
    columns = np.arange(side) % 2 * 200 + 20
    stripes = np.tile(columns.astype(np.uint8), (side, 1))
    path = write_plate(tmp_path, "stripes", stripes, 2.0, 2.0)
    picture = picture_of(plate(path, Pose((2.5, 0, 0.5))), eye=AHEAD)
    left, width = 319.5 - CAMERA.fx / 2.5, 2.0 * CAMERA.fx / 2.5 / side
    middles = np.round(left + width * (np.arange(side) + 0.5)).astype(int)
    for row in (100, 240, 380):
        # Between two texels the nearest one, or a mean, is seen.
        assert picture[row, middles, 0] == pytest.approx(columns, abs=15 if side < 60 else 90)


def test_a_mirrored_mesh_shows_its_picture_mirrored(tmp_path):
    path = write_plate(tmp_path, "quarters", quarters(), 1.0, 1.0)
    mesh = Mesh(path, path.name, (1.0, -1.0, 1.0))
    picture = picture_of(thing("m", mesh, Pose((3, 0, 0.5))), eye=AHEAD)
    assert around_the_middle(picture) == pytest.approx(COLOURS[[1, 0, 3, 2]], abs=3)


def test_a_far_picture_is_its_mean_not_single_texels(tmp_path):
    lines = np.zeros((512, 512), np.uint8)
    lines[:, ::2] = 200
    path = write_plate(tmp_path, "lines", lines, 2.0, 2.0)
    picture = picture_of(plate(path, Pose((8.0, 0, 0.5))), eye=AHEAD)
    inner = picture[200:280, 280:360, 0].astype(float)
    assert inner.mean() == pytest.approx(100, abs=6)
    assert inner.std() < 8


def test_several_materials_and_faces_without_a_picture(tmp_path):
    for n in (0, 1):
        Image.fromarray(flat(COLOURS[n])).save(tmp_path / f"c{n}.png")
    (tmp_path / "m.mtl").write_text(
        "# two\nnewmtl a\nKd .5 .5 .5\nmap_Kd c0.png\nnewmtl b\nKd 1 1 1\nmap_Kd -s 1 1 1 c1.png\n"
    )
    text = "mtllib m.mtl\nvt 0 0\nvt 1 0\nvt 1 1\n"
    for n, material in enumerate("abc"):
        y = 1.0 - n
        text += f"v 0 {y + 0.4} -.4\nv 0 {y - 0.4} -.4\nv 0 {y - 0.4} .4\nv 0 {y + 0.4} .4\n"
        text += f"usemtl {material}\n"
        text += "f -4/1 -3/2 -2/3 -1/3\n" if material != "c" else "f -4 -3 -2 -1\n"
    (tmp_path / "m.obj").write_text(text)
    model = thing("m", Mesh(tmp_path / "m.obj", "m.obj"), Pose((4, 0, 0.5)), (0.5, 0.4, 0.3, 1))
    picture = picture_of(model, eye=AHEAD)
    # The model's own colour is for what brings none.
    wanted = np.array([COLOURS[0] / 2, COLOURS[1], (127.5, 102, 76.5)])
    columns = [round(319.5 - CAMERA.fx * y / 4.0) for y in (1.0, 0.0, -1.0)]
    assert picture[240, columns] == pytest.approx(wanted, abs=3)


@cases("""
model, picture:
  - [., textures/q.png]
  # In the package that the model lies in.
  - [models/shelf, photos/q.png]
""")
def test_pictures_beside_the_meshes_of_a_model_and_in_its_package(tmp_path, model, picture):
    meshes = tmp_path / model / "meshes"
    meshes.mkdir(parents=True)
    (tmp_path / "package.xml").write_text("<package/>")
    (tmp_path / model / "model.config").write_text("<model/>")
    path = write_plate(meshes, "p", flat(COLOURS[1]), 1.0, 1.0)
    (tmp_path / picture).parent.mkdir()
    shutil.move(meshes / "p.png", tmp_path / picture)
    named = os.path.relpath(tmp_path / picture, meshes)
    (meshes / "p.mtl").write_text(f"newmtl face\nmap_Kd {named}\n")
    (surface,) = surfaces_of(Mesh(path, ""))
    assert surface.corners.shape == (2, 3, 3)
    assert (read_pixels(surface.look[1].texture) == COLOURS[1]).all()


@cases(r"""
name, content, message:
  - [p.mtl, "newmtl face\nmap_Kd nix.png\n", 'p.mtl: .*nix.png']
  - [p.mtl, "newmtl face\nmap_Kd ../secret.png\n", 'p.mtl: .*leaves its folder']
  - [p.mtl, "newmtl face\nmap_Kd http://example.org/a.png\n", 'p.mtl: .*only package://']
  - [p.png, no image, 'p.png: .*not a readable image']
  - [p.obj, "mtllib p.mtl\nusemtl face\nv 0 9 -9\nv 0 -9 -9\nv 0 0 9\nf 1 2 3\n", 'p.png: .*no
     texture coordinates']
""")
def test_a_picture_that_cannot_be_shown_is_named_once_and_left_out(
    tmp_path, name, content, message, caplog
):
    folder = tmp_path / "meshes"
    folder.mkdir()
    path = write_plate(folder, "p", flat(COLOURS[0]), 1.0, 1.0)
    shutil.copy(folder / "p.png", tmp_path / "secret.png")
    (folder / name).write_text(content)
    models = [replace(plate(path, Pose((3.0, y, 0.5))), name=f"m{y}") for y in (0.0, 5.0)]
    picture = picture_of(*models, eye=AHEAD)
    (line,) = caplog.messages
    assert re.match(f"{folder}/{message}", line)
    assert (picture[240, 320] == 255).all()


def test_a_material_file_that_nobody_has_is_passed_over(tmp_path):
    path = write_plate(tmp_path, "p", flat(COLOURS[0]), 1.0, 1.0)
    (tmp_path / "p.mtl").unlink()
    (surface,) = surfaces_of(Mesh(path, ""))
    assert surface.look is None
