import numpy as np
import pytest

from bullet_lab.noise.published_noise import ALL, DEFECTS, NONE, Defects
from bullet_lab.studies.published_noise.figures import (
    compare_figure,
    corners_figure,
    defects_figure,
    first_turns_figure,
    lengths_figure,
)
from bullet_lab.studies.published_noise.results import (
    EVIDENCE,
    LENGTHS,
    QUANTILES,
    PublishedFigure,
    PValue,
    Result,
)

CORNERS = np.array([(0, 0), (2, 0), (2, -2), (0, -2), (0, 0)], dtype=float)
FIGURE_1B = PublishedFigure(CORNERS + 0.01, np.arange(5), CORNERS, np.zeros(6))
EXPLAINS, EXCLUDED, OPEN = PValue(0.5, 0.6), PValue(0.001, 0.002), PValue(0.04, 0.1)


def texts(axes):
    return " ".join(text.get_text() for text in axes.texts)


def test_compare():
    figure = compare_figure(FIGURE_1B, CORNERS, (CORNERS + 0.1, CORNERS + 0.2), 7)
    titles = [axes.get_title() for axes in figure.axes]
    assert titles[0] == "Figure 1b as published"
    assert all("seed 7" in title for title in titles[1:])
    starts = [axes.lines[0].get_xdata()[0] for axes in figure.axes]
    assert starts == pytest.approx([0.01, 0.1, 0.2])


def test_sheet_shows_the_published_figure_first_then_each_combination():
    best = Defects(aliasing=True, unwrapped=True, sampled=True)
    paths = np.stack([CORNERS, CORNERS + 0.1, CORNERS + 0.2], axis=1)
    # The last of those that are alone has too few seeds.
    found = {ALL: EXPLAINS, best: EXPLAINS, Defects(**{DEFECTS[-1]: True}): OPEN}

    def shown(defects):
        return paths, found.get(defects, EXCLUDED)

    first, *others = defects_figure(FIGURE_1B, CORNERS, shown, best, 0.1).axes
    assert "1b" in first.get_title()
    assert first.lines[0].get_xdata()[0] == 0.01
    drawn = [axes for axes in others if axes.lines]
    assert [len(axes.lines) for axes in drawn] == [4] * 13
    explaining = [axes.get_title() for axes in drawn if "explains" in texts(axes)]
    assert len(explaining) == 2
    assert any("as published" in title for title in explaining)
    assert sum("too few seeds" in texts(axes) for axes in drawn) == 1


def test_corners():
    paths = np.stack([CORNERS, CORNERS + 0.003], axis=1)
    figure = corners_figure(FIGURE_1B, CORNERS, {"one": paths, "other": paths + 0.001})
    starts, ends = figure.axes[:3], figure.axes[3:]
    assert [axes.get_title() for axes in starts] == ["figure 1b", "one", "other"]
    bold = [axes.lines[-2] for axes in (starts[0], starts[2], ends[2])]
    assert [line.get_ydata()[0] for line in bold[:2]] == pytest.approx([10.0, 1.0])
    # In mm from the first corner.
    assert bold[2].get_xdata()[:2] == pytest.approx([-1999.0, 1.0])


def result_of(defects, quantiles, p_value):
    # Runs whose quantiles these are.
    runs = np.array([np.interp(np.linspace(0, 1, 21), QUANTILES, q) for q in quantiles.T]).T
    return Result(defects, runs, dict.fromkeys(EVIDENCE, p_value), np.zeros(6))


def test_lengths():
    quantiles = np.outer([1e-5, 1e-4, 1e-3, 1e-2, 0.1], [1, 1, 2, 1, 1, 1])
    alike = [Defects(aliasing=True, unwrapped=is_in, sampled=True) for is_in in (True, False)]
    results = [
        *(result_of(defects, quantiles, EXPLAINS) for defects in alike),
        result_of(NONE, 0.0 * quantiles, OPEN),
        result_of(ALL, 10 * quantiles, EXCLUDED),
    ]
    figure = lengths_figure(results, np.array([0.001, 0.0, 0.2, 0.003, 0.0, 0.001]))
    switches, *middle, right = figure.axes
    assert len(switches.lines) == 15
    assert [line.get_marker() for line in switches.lines[:5]] == ["o", "_", "o", "o", "o"]
    assert [axes.get_title().replace(" ", "") for axes in middle] == list(LENGTHS)
    medians = middle[2].lines[0].get_xdata()
    assert medians == pytest.approx([2e-3, 1e-4, 2e-2])
    assert {"0.50", "0.04", "< 0.002", "p of\ncorners"} <= {text.get_text() for text in right.texts}


def test_first_turns():
    perfect = np.array([(0, 0, 3.0), (1, 0, 3.0), (2, 0, -3.0), (2, 0, -3.0)], dtype=float)
    run = np.arange(4.0), perfect, perfect + [0.0, 0.1, 0.0]
    figure = first_turns_figure({ALL: run, Defects(aliasing=True): run}, (1.0, 2.0))
    turns = [axes.lines[0].get_ydata() for axes in figure.axes[2:4]]
    unwrapped = np.degrees(np.arctan2(-0.1, 1.0) - 3.0)
    assert [turn[0] for turn in turns] == pytest.approx([unwrapped] * 2)
    assert np.abs(turns[1]).max() <= 180.0
    assert figure.axes[4].lines[0].get_ydata() == pytest.approx([100.0] * 4)
