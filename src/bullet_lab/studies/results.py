"""Results of a study: tables, figures, texts and summary.json; and what several studies share.

That is the interval of a share, and parts of figures.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, Iterable, List, Mapping, Sequence, Tuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.special import betaincinv

from bullet_lab.core.figures import new_figure, save
from bullet_lab.core.files import write_json
from bullet_lab.studies.study import SUMMARY, whole_results, write_table

Record = Mapping[str, Any]
"""A row of a table by the names of its columns."""


def write_results(
    folder: Path,
    summary: Dict[str, Any],
    tables: Mapping[str, Iterable[Iterable[Any]]],
    figures: Mapping[str, Figure],
    texts: Mapping[str, str],
    name: str = SUMMARY,
) -> Dict[str, Any]:
    """Write all results of a study, or none of them, and return the summary.

    Args:
        folder: for the files.
        summary: content of a JSON file.
        tables: rows of CSV files, the header first, by the names of the files.
        figures: by the names of PNG files.
        texts: content of other files by their names, which may begin with a folder.
        name: of the file with the summary.

    Raises:
        FileError: a file cannot be written.
    """
    with whole_results(folder) as part:
        for file, rows in tables.items():
            write_table(part / file, rows)
        for file, figure in figures.items():
            save(figure, part / file)
        for file, text in texts.items():
            (part / file).parent.mkdir(exist_ok=True)
            (part / file).write_text(text)
        write_json(part / name, summary)
    return summary


def rows_of(records: Sequence[Record]) -> List[Iterable[Any]]:
    """Return a header and a row for each of the records, which have the same names."""
    return [records[0], *(record.values() for record in records)]


def clopper_pearson(hits: int, trials: int, tail: float) -> Tuple[float, float]:
    """Return Clopper and Pearson's interval of the probability of a hit.

    Each end is the probability for which at least so many hits, or at most so many, have the
    probability `tail`: a quantile of the beta distribution. The true probability, whatever its
    value, is beyond an end in at most that share of all experiments.
    (C. J. Clopper and E. S. Pearson, Biometrika 26, 1934.)

    >>> [round(end, 3) for end in clopper_pearson(95, 100, 0.025)]
    [0.887, 0.984]
    """
    low = betaincinv(hits, trials - hits + 1, tail) if hits else 0.0
    high = betaincinv(hits + 1, trials - hits, 1.0 - tail) if hits < trials else 1.0
    return float(low), float(high)


def panels(
    shape: Tuple[int, int],
    size: Tuple[float, float],
    title: str = "",
    labels: Tuple[str, str] = ("", ""),
    grid: bool = True,
    **more: Any,
) -> Tuple[Figure, np.ndarray]:
    """Return a figure and its axes, an array of a shape.

    Args:
        shape: numbers of rows and columns.
        size: width and height in inches.
        title: of the figure.
        labels: of x below the last row, and of y beside the first column.
        grid: whether to draw grids.
        more: as in `Figure.subplots`.
    """
    figure = new_figure(*size)
    if title:
        figure.suptitle(title)
    every = figure.subplots(*shape, squeeze=False, **more)
    for axes in every.flat if grid else ():
        axes.grid(alpha=0.3)
    for axes in every[-1]:
        axes.set_xlabel(labels[0])
    for axes in every[:, 0]:
        axes.set_ylabel(labels[1])
    return figure, every


def legend_below(
    figure: Figure, handles: Sequence[Artist], columns: int = 0, bottom: float = 0.0, **more: Any
) -> None:
    """Add a legend below the panels of a figure.

    Args:
        figure: to draw on.
        handles: with labels.
        columns: of the legend; 0 for a single row.
        bottom: share of the height for the legend; the panels are laid out above it. 0 keeps them.
        more: as in `Figure.legend`.
    """
    more = {"loc": "lower center", "ncol": columns or len(handles), "frameon": False, **more}
    if handles:
        figure.legend(handles=handles, **more)
    if bottom:
        figure.tight_layout(rect=(0.0, bottom, 1.0, 1.0))


def legend_entry(label: str, **style: Any) -> Line2D:
    """Return an entry for a legend: a line or marker in a style, with a label."""
    return Line2D([], [], label=label, **style)


def labelled(*every: Axes) -> List[Artist]:
    """Return the artists of some axes that have a label, one for each label."""
    handles: Dict[str, Artist] = {}
    for axes in every:
        for handle, label in zip(*axes.get_legend_handles_labels()):
            handles.setdefault(label, handle)
    return list(handles.values())
