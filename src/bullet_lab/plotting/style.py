"""What all figures share: colours, canvas, saving."""

from __future__ import annotations

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bullet_lab.recording.files import replace_file

# Okabe and Ito's palette, which the colour-blind can tell apart; as in figure 1, the noisy path
# is blue and the perfect one orange.
BLUE, ORANGE, GREEN, VERMILION, PURPLE = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7"
BLACK, GREY = "#000000", "#999999"
DOTS_PER_INCH = 110


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of a size in inches; it needs no window system and no pyplot."""
    figure = Figure(figsize=(width, height), dpi=DOTS_PER_INCH)
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG; a reader finds the old file or the new one, never a part."""
    # Without the software's version in it, the same figure is the same file.
    replace_file(path, lambda part: figure.savefig(part, format="png", metadata={"Software": ""}))
