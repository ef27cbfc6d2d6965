"""Values of occupancy grids at points."""

import math

import numpy as np

from bullet_lab.navigation.occupancy import UNKNOWN

CELLS = np.array([[0, 100, -1], [0, 0, 100]], dtype=np.int8)


def value_at(grid, x, y):
    """The value of the cell at a point (m); unknown off the map."""
    column, row = (math.floor((p - low) / grid.resolution) for p, low in zip((x, y), grid.origin))
    rows, columns = grid.cells.shape
    inside = 0 <= row < rows and 0 <= column < columns
    return int(grid.cells[row, column]) if inside else UNKNOWN
