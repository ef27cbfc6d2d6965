"""What the detectors see, side by side, as in figure 7."""

from __future__ import annotations

import textwrap
from typing import Mapping

import numpy as np
from matplotlib.figure import Figure

from bullet_lab.core.figures import new_figure

_COLUMNS = 3
_LINE_LENGTH = 58


def vision_figure(
    pictures: Mapping[str, np.ndarray], lines: Mapping[str, str], title: str
) -> Figure:
    """Draw pictures in two rows.

    Args:
        pictures: (h, w, 3) uint8, red green blue, by name.
        lines: what was found, by the same names; written below.
        title: above all.
    """
    figure = new_figure(14.0, 8.6)
    figure.suptitle(title)
    rows = -(-len(pictures) // _COLUMNS)
    grid = figure.subplots(rows, _COLUMNS, squeeze=False)
    figure.subplots_adjust(left=0.02, right=0.98, top=0.92, bottom=0.06, hspace=0.28, wspace=0.05)
    for axes in grid.ravel():
        axes.set_axis_off()
    for axes, (name, picture) in zip(grid.ravel(), pictures.items()):
        axes.imshow(picture)
        axes.set_title(name, fontsize=11, fontweight="bold")
        line = textwrap.fill(lines[name], _LINE_LENGTH)
        axes.text(0.5, -0.03, line, transform=axes.transAxes, ha="center", va="top", fontsize=9)
    return figure
