"""Tests of the map of a world: walls, legs and meshes are where they are."""

import math
import re

import numpy as np
import pytest
from map_values import value_at
from scipy.ndimage import binary_dilation
from shared import cases, refuses
from study_runs import run_main, summary_of

from bullet_lab.navigation.occupancy import FREE, OCCUPIED, UNKNOWN, MapError, read_map
from bullet_lab.studies.map import MapSettings, main, map_world

WORLD = """<sdf version="1.6"><world name="w"><include><uri>model://ground_plane</uri></include>
{}</world></sdf>"""
MODEL = """<model name="{name}"><static>{static}</static><pose>{pose}</pose><link name="link">
<collision name="c"><geometry>{shape}</geometry></collision></link></model>"""


def box(x, y, z):
    return f"<box><size>{x} {y} {z}</size></box>"


def model(name, pose, shape, static=1):
    return MODEL.format(name=name, pose=pose, shape=shape, static=static)


# A room of 4 x 3 m inside, its walls 0.1 m thick.
ROOM = "".join(
    model(f"wall_{index}", f"{x} {y} 1 0 0 0", box(wide, deep, 2))
    for index, (x, y, wide, deep) in enumerate(
        ((-2.05, 0, 0.1, 3.2), (2.05, 0, 0.1, 3.2), (0, -1.55, 4.0, 0.1), (0, 1.55, 4.0, 0.1))
    )
)
CYLINDER = "<cylinder><radius>0.3</radius><length>1</length></cylinder>"
COLUMN = model("column", "1 0.5 0.5 0 0 0", CYLINDER)


@pytest.fixture
def mapped(tmp_path):
    def make(models, **settings):
        path = tmp_path / "test.world"
        path.write_text(WORLD.format(models))
        return map_world(MapSettings(world=str(path), **settings))

    return make


def middles(found):
    rows, columns = np.indices(found.cells.shape)
    return [low + (i + 0.5) * found.resolution for low, i in zip(found.origin, (columns, rows))]


@cases("resolution, turn: [[0.05, 0.0], [0.1, 0.4], [0.03, 0.4]]")
def test_a_room_is_mapped_within_a_cell(mapped, resolution, turn):
    turned = f'<model name="room"><static>1</static><pose>0 0 0 0 0 {turn}</pose>{ROOM}</model>'
    found = mapped(turned + COLUMN, resolution=resolution)
    x, y = middles(found)
    u, v = math.cos(turn) * x + math.sin(turn) * y, math.cos(turn) * y - math.sin(turn) * x
    # m inside the room's walls, and from the column.
    inside = np.minimum(2.0 - np.abs(u), 1.5 - np.abs(v))
    away = np.hypot(x - 1.0, y - 0.5) - 0.3
    near = 1.5 * resolution
    assert (found.cells[(inside > near) & (away > near)] == FREE).all()
    wall = ((inside <= near) & (inside >= -0.1 - near)) | (np.abs(away) <= near)
    assert wall[found.cells == OCCUPIED].all()
    # Inside of the column and outside of the room, nobody can look.
    assert (found.cells[(away < -near) | (inside < -0.1 - near)] == UNKNOWN).all()
    # There is no gap: around the free floor, all is occupied.
    free = found.cells == FREE
    beside = binary_dilation(free)
    assert (found.cells[beside & ~free] == OCCUPIED).all()


TABLE = model("top", "0.5 0 0.72 0 0 0", box(0.8, 0.8, 0.01)) + model(
    "leg", "0.5 0 0.35 0 0 0", box(0.04, 0.04, 0.7)
)


@cases("low, high, occupied: [[0.1, 0.1, 0.0], [0.1, 0.5, 0.0], [0.1, 0.8, 0.64]]")
def test_a_table_is_its_leg_or_its_top_by_height(mapped, low, high, occupied):
    found = mapped(ROOM + TABLE, low=low, high=high, x=-1.0)
    x, y = middles(found)
    at_table = (np.abs(x - 0.5) < 0.55) & (np.abs(y) < 0.55)
    area = (found.cells[at_table] == OCCUPIED).sum() * 0.05**2
    assert area == pytest.approx(occupied, abs=0.1)
    assert value_at(found, 0.501, 0.001) == OCCUPIED


def test_loose_things_are_mapped_where_they_come_to_rest_and_robots_are_not(mapped):
    falling = model("loose", "-1 0 1 0 0 0", box(0.4, 0.4, 0.2), static=0).replace(
        "<collision", "<inertial><mass>1</mass></inertial><collision"
    )
    robot = falling.replace("loose", "robot").replace("-1 0 1", "1 0.5 0.2").replace(
        "</model>", '<plugin name="p" filename="libgazebo_ros_planar_move.so"/></model>'
    )
    found = mapped(ROOM + falling + robot)
    assert value_at(found, -0.81, 0.0) == OCCUPIED
    assert value_at(found, 1.0, 0.5) == FREE


def test_a_mesh_is_mapped_as_its_triangles(mapped, tmp_path):
    # A hollow tent without a floor, open at both ends.
    (tmp_path / "tent.obj").write_text(
        "v -1 -1 0\nv 1 -1 0\nv 1 0 2\nv -1 0 2\nv -1 1 0\nv 1 1 0\nf 1 2 3 4\nf 4 3 6 5\n"
    )
    mesh = f"<mesh><uri>file://{tmp_path}/tent.obj</uri></mesh>"
    found = mapped(ROOM + model("tent", "0 0 0 0 0 0", mesh), low=0.2, high=0.2)
    assert [value_at(found, 0.0, y) for y in (-0.9, 0.9)] == [OCCUPIED, OCCUPIED]
    assert value_at(found, 0.0, 0.0) == FREE and value_at(found, 0.0, -1.2) == FREE


@cases("""
settings, line:
  - [{x: 2.05}, "the start (2.05, 0) m is occupied"]
  - [{low: 0.6}, "high is 0.5: it must not be below low, 0.6"]
  - [{resolution: 0.005, x: 100.0, y: 100.0}, at most 4000000]
""")
def test_what_cannot_be_mapped_is_refused(mapped, settings, line):
    with refuses(re.escape(line), MapError):
        mapped(ROOM, **settings)


def test_the_job_writes_what_map_server_reads(tmp_path):
    world, out = tmp_path / "test.world", tmp_path / "out"
    world.write_text(WORLD.format(ROOM))
    assert run_main(main, out, "--world", world, "--resolution", "0.1")[0] == 0
    summary, found = summary_of(out), read_map(out / "map.yaml")
    assert summary["is_closed"] and summary["free_m2"] == pytest.approx(12.0, rel=0.05)
    assert found.cells.shape == (summary["rows"], summary["columns"])
    assert (found.cells == FREE).sum() * 0.01 == pytest.approx(summary["free_m2"])
    assert (out / "map.png").stat().st_size > 1000
