import numpy as np
from alike import lines_of_figure
from test_published_results import CORNERS

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
    QUANTILES,
    PublishedFigure,
    PValue,
    Result,
)

FIGURE_1B = PublishedFigure(CORNERS + 0.01, np.arange(5), CORNERS, np.zeros(6))
EXPLAINS, EXCLUDED, OPEN = PValue(0.5, 0.6), PValue(0.001, 0.002), PValue(0.04, 0.1)


def result_of(defects, quantiles, p_value):
    # Runs whose quantiles these are.
    runs = np.array([np.interp(np.linspace(0, 1, 21), QUANTILES, q) for q in quantiles.T]).T
    return Result(defects, runs, dict.fromkeys(EVIDENCE, p_value), np.zeros(6))


def figures():
    yield compare_figure(FIGURE_1B, CORNERS, (CORNERS + 0.1, CORNERS + 0.2), 7)
    best = Defects(aliasing=True, unwrapped=True, sampled=True)
    # The last of those that are alone has too few seeds.
    found = {ALL: EXPLAINS, best: EXPLAINS, Defects(**{DEFECTS[-1]: True}): OPEN}
    paths = np.stack([CORNERS, CORNERS + 0.1, CORNERS + 0.2], axis=1)

    def shown(defects):
        return paths, found.get(defects, EXCLUDED)

    yield defects_figure(FIGURE_1B, CORNERS, shown, best, 0.1)
    near = np.stack([CORNERS, CORNERS + 0.003], axis=1)
    yield corners_figure(FIGURE_1B, CORNERS, {"one": near, "other": near + 0.001})
    quantiles = np.outer([1e-5, 1e-4, 1e-3, 1e-2, 0.1], [1, 1, 2, 1, 1, 1])
    alike = [Defects(aliasing=True, unwrapped=is_in, sampled=True) for is_in in (True, False)]
    results = [
        *(result_of(defects, quantiles, EXPLAINS) for defects in alike),
        result_of(NONE, 0.0 * quantiles, OPEN),
        result_of(ALL, 10 * quantiles, EXCLUDED),
    ]
    yield lengths_figure(results, np.array([0.001, 0.0, 0.2, 0.003, 0.0, 0.001]))
    perfect = np.array([(0, 0, 3.0), (1, 0, 3.0), (2, 0, -3.0), (2, 0, -3.0)], dtype=float)
    run = np.arange(4.0), perfect, perfect + [0.0, 0.1, 0.0]
    yield first_turns_figure({ALL: run, Defects(aliasing=True): run}, (1.0, 2.0))


def test_figures_are_as_before(as_before):
    told = [line for figure in figures() for line in lines_of_figure(figure)]
    as_before(told, "figures.txt")
