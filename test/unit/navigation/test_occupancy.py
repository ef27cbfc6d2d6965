"""Tests of the files of maps: what is written is read back, and read as map_server reads it."""

from pathlib import Path

import cv2
import numpy as np
from map_values import CELLS
from shared import cases, refuses

from bullet_lab.navigation.occupancy import MapError, OccupancyMap, read_map

ORIGIN = (-1.5, 2.25, 0.0)


def write(folder, text, levels=None):
    if levels is not None:
        cv2.imwrite(str(folder / "map.png"), np.array(levels, dtype=np.uint8))
    (folder / "map.yaml").write_text(text)
    return folder / "map.yaml"


def test_a_map_is_read_back(tmp_path):
    made = OccupancyMap(CELLS, 0.25, ORIGIN)
    (tmp_path / "map.pgm").write_bytes(made.pgm())
    found = read_map(write(tmp_path, made.yaml("map.pgm")))
    np.testing.assert_array_equal(found.cells, CELLS)
    assert (found.resolution, found.origin) == (0.25, ORIGIN)
    # The first row of the image is the last of the map.
    assert made.pgm() == b"P5\n3 2\n255\n" + bytes([254, 254, 0, 254, 0, 205])


HEAD = "image: map.png\nresolution: 0.1\norigin: [0, 0, 0]\n"


@cases(r"""
more, levels, values:
  - ["", [[0, 88, 89, 204, 205, 206, 255]], [100, 100, 100, -1, -1, 0, 0]]
  - ["negate: 1\n", [[0, 255, 49, 50]], [0, 100, 0, -1]]
  - ["occupied_thresh: 0.9\nfree_thresh: 0.5\n", [[0, 100, 200]], [100, -1, 0]]
  - ["mode: trinary\n", [[0, 205]], [100, -1]]
  # Of a picture with colours, the mean.
  - ["", [[[0, 0, 255], [255, 255, 240]]], [100, 0]]
""")
def test_grey_levels_mean_what_they_mean_to_map_server(tmp_path, more, levels, values):
    assert read_map(write(tmp_path, HEAD + more, levels)).cells.tolist() == [values]


@cases(r"""
old, new, expected:
  - ["origin: [0, 0, 0]", "", origin is missing]
  # In place of all of it.
  - [null, "[1, 2", is no map]
  - [null, "3", is no map]
  - [map.png, other.png, cannot read the image]
  - ["0.1", "-1", needs a resolution > 0]
  - ["0, 0, 0", "0, 0", an origin of 3]
  - ["image", "mode: scale\nimage", the mode trinary]
""")
def test_what_is_no_map_is_refused(tmp_path, old, new, expected):
    with refuses(expected, MapError):
        read_map(write(tmp_path, HEAD.replace(old or HEAD, new), [[0]]))


@cases("""
path, expected:
  - [none.yaml, cannot read]
  - ["", the map is '.'; it must be a YAML file]
""")
def test_a_file_that_is_none_is_refused(path, expected):
    with refuses(expected, MapError):
        read_map(Path(path))
