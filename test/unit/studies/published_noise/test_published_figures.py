import numpy as np
import pytest

from bullet_lab.core.figures import save
from bullet_lab.studies.published_noise.defects import ALL, DEFECTS, NONE, Defects
from bullet_lab.studies.published_noise.figures import (
    compare_figure,
    defects_figure,
    first_turns_figure,
    sides_figure,
)
from bullet_lab.studies.published_noise.results import QUANTILES, Likeness, Result
from bullet_lab.studies.published_noise.side_deviation import PublishedFigure

CORNERS = np.array([(0, 0), (2, 0), (2, -2), (0, -2), (0, 0)], dtype=float)
FIGURE_1B = PublishedFigure(CORNERS + 0.01, CORNERS, np.zeros(5), 9)


def saved(figure, path):
    save(figure, path)
    assert path.read_bytes().startswith(b"\x89PNG")


def texts(axes):
    return " ".join(text.get_text() for text in axes.texts)


def test_compare(tmp_path):
    figure = compare_figure(FIGURE_1B, CORNERS, (CORNERS + 0.1, CORNERS + 0.2), 7)
    titles = [axes.get_title() for axes in figure.axes]
    assert titles[0] == "Figure 1b as published"
    assert all("seed 7" in title for title in titles[1:])
    starts = [axes.lines[0].get_xdata()[0] for axes in figure.axes]
    assert starts == pytest.approx([0.01, 0.1, 0.2])
    saved(figure, tmp_path / "a.png")


@pytest.mark.parametrize("best", [NONE, Defects(aliasing=True, unwrapped=True, sampled=True)])
def test_sheet_shows_the_published_figure_first_then_each_combination(tmp_path, best):
    alone = [Defects(**{name: True}) for name in DEFECTS]
    all_but = [Defects(**{other: other != name for other in DEFECTS}) for name in DEFECTS]
    paths = np.stack([CORNERS, CORNERS + 0.1, CORNERS + 0.2], axis=1)
    every = [ALL, best, NONE, *alone, *all_but]
    shown = {d: (paths, 0.5 if d in (ALL, best) else 0.001) for d in every}
    figure = defects_figure(FIGURE_1B, CORNERS, shown, best, 0.1)
    first, *others = figure.axes
    assert "1b" in first.get_title()
    assert first.lines[0].get_xdata()[0] == 0.01
    drawn = [axes for axes in others if axes.lines]
    assert len(drawn) == 13
    assert all(len(axes.lines) == 4 for axes in drawn)
    explaining = [axes.get_title() for axes in drawn if "explains" in texts(axes)]
    assert len(explaining) == (3 if best == NONE else 2)
    assert any("as published" in title for title in explaining)
    saved(figure, tmp_path / "a.png")


def result_of(defects, quantiles, log10_ratio, p_value):
    # Runs whose quantiles these are.
    runs = np.array([np.interp(np.linspace(0, 1, 21), QUANTILES, q) for q in quantiles.T]).T
    logarithm = log10_ratio * np.log(10.0)
    return Result(defects, runs, Likeness(logarithm, 0.0, np.zeros(5), p_value, 0))


def test_sides(tmp_path):
    quantiles = np.outer([1e-5, 1e-4, 1e-3, 1e-2, 0.1], [1, 1, 2, 1, 1])
    alike = [Defects(aliasing=True, unwrapped=is_in, sampled=True) for is_in in (True, False)]
    results = [
        *(result_of(defects, quantiles, 0.0, 0.4) for defects in alike),
        result_of(NONE, 0.0 * quantiles, -2.0, 0.002),
        result_of(ALL, 10 * quantiles, -40.0, 0.001),
    ]
    figure = sides_figure(results, np.array([0.001, 0.0, 0.2, 0.003, 0.0]))
    switches, *sides, scores = figure.axes
    assert len(switches.lines) == 15
    assert [line.get_marker() for line in switches.lines[:5]] == ["o", "_", "o", "o", "o"]
    assert [axes.get_title() for axes in sides] == [
        *(f"side {k}" for k in (1, 2, 3, 4)),
        "end of the drive",
    ]
    medians = sides[2].lines[0].get_xdata()
    assert medians == pytest.approx([2e-3, 1e-4, 2e-2])
    assert {"1.00", "0.40", "1 / 100", "$10^{-40}$", "< 0.01"} <= {
        text.get_text() for text in scores.texts
    }
    saved(figure, tmp_path / "a.png")


def test_first_turns(tmp_path):
    stamps = np.arange(4.0)
    perfect = np.array([(0, 0, 3.0), (1, 0, 3.0), (2, 0, -3.0), (2, 0, -3.0)], dtype=float)
    noisy = perfect + [0.0, 0.1, 0.0]
    runs = dict.fromkeys((ALL, Defects(aliasing=True)), (stamps, perfect, noisy))
    figure = first_turns_figure(runs, (1.0, 2.0))
    turns = [axes.lines[0].get_ydata() for axes in figure.axes[2:4]]
    unwrapped = np.degrees(np.arctan2(-0.1, 1.0) - 3.0)
    assert turns[0][0] == pytest.approx(unwrapped)
    assert turns[1][0] == pytest.approx(unwrapped)
    assert np.abs(turns[1]).max() <= 180.0
    assert figure.axes[4].lines[0].get_ydata() == pytest.approx([100.0] * 4)
    saved(figure, tmp_path / "a.png")
