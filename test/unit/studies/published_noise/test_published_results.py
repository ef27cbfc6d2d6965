"""Lengths read from drawn paths, and the p-values and verdicts that follow from them."""

import numpy as np
import pytest
from scipy.stats import beta
from shared import cases, refuses

from bullet_lab.noise.published_noise import NONE, Defects, combinations
from bullet_lab.studies.published_noise.results import (
    EVIDENCE,
    UNKNOWN,
    PValue,
    Result,
    drawn,
    find_corners,
    groups_of_same,
    measure,
    nearest,
    p_value,
    ranked,
    read_published_figure,
    verdict,
)

ONE = 0.1 * np.arange(1, 100)[:, np.newaxis]
MANY = np.tile(np.arange(1, 1000)[:, np.newaxis], 2)


@cases("""
measured, value:
  # Of one length it is twice its rank among 100; of several the most unusual one counts: here the
  # tenth of 1000.
  - [[0.31], 0.08]
  - [[9.65], 0.08]
  - [[5.0], 1.0]
  - [[100.0], 0.02]
  - [[500, 9.5], 0.04]
""")
def test_p_values(measured, value):
    runs = ONE if len(measured) == 1 else MANY
    assert p_value(measured, runs).value == pytest.approx(value)


def test_the_bound_is_clopper_and_pearsons_for_all_tails_at_once():
    runs = np.linspace(0, 1, 100)[:, np.newaxis]
    # None and two of 100 runs are further out.
    assert p_value([2.0], runs).high == pytest.approx(2 * (1 - 0.025 ** (1 / 100)))
    assert p_value([0.985], runs).high == pytest.approx(2 * beta.isf(0.025, 3, 98))
    both = p_value([2.0, 0.5], np.tile(runs, 2))
    assert both.high == pytest.approx(4 * (1 - 0.0125 ** (1 / 100)))


def test_too_few_runs_exclude_nothing():
    few, many = (p_value([2.0], np.linspace(0, 1, count)[:, np.newaxis]) for count in (99, 999))
    assert not few.explains and not few.excludes
    assert many.excludes


def result(defects, value, high, size=1.0):
    p_values = dict.fromkeys(EVIDENCE, PValue(value, high))
    return Result(defects, np.full((3, 6), size), p_values, np.zeros(6))


def judged(explains, name):
    """Return the verdict on a defect if some combinations explain the figure."""
    found = [result(d, *((0.5, 0.6) if explains(d) else (1e-3, 1e-2))) for d in combinations()]
    return verdict(name, found, "all")


@cases("name, expected: [[aliasing, needed], [unbent, ruled out], [sampled, cannot be told]]")
def test_verdicts(name, expected):
    assert judged(lambda d: d.aliasing and not d.unbent, name) == expected
    assert judged(lambda d: False, name) == UNKNOWN


def test_what_is_not_excluded_leaves_the_verdict_open():
    found = [
        result(d, *((0.5, 0.6) if d.aliasing else (0.01, 0.06) if d == NONE else (1e-3, 1e-2)))
        for d in combinations()
    ]
    assert verdict("aliasing", found, "all") == UNKNOWN


def test_ranks_and_groups():
    low, high = result(NONE, 0.1, 0.2), result(Defects(aliasing=True), 0.6, 0.7, size=2.0)
    twin = result(Defects(aliasing=True, unbent=True), 0.6, 0.7, size=2.0)
    assert ranked([low, high, twin]) == [high, twin, low]
    assert groups_of_same([high, twin, low]) == [[high, twin], [low]]


def test_nearest():
    runs = np.array([[0.1, 0.001], [0.2, 0.001], [0.4, 0.001], [0.4, 0.3]])
    assert nearest(np.array([0.41, 0.001]), runs) == 2


CORNERS = np.array([(0, 0), (2, 0), (2, -2), (0, -2), (0, 0)], dtype=float)
# Beside each side by 1, 2, 3 and 4 cm; beyond a corner, where that must not count.
VERTICES = np.array(
    [
        *((0, 0), (0.5, 0.005), (1.5, 0.01), (2.1, 0)),
        *((2, 0), (1.98, -1)),
        *((2, -2), (1, -2.03), (0.5, -1.99)),
        *((0, -2), (0.04, -1.5), (0, -1), (0, 0)),
    ]
)
FOUND = [0, 4, 6, 9, 12]


def test_a_line_is_drawn_from_end_to_end():
    line = np.outer(np.linspace(0, 1, 200), (1.9, 0.3))
    # matplotlib draws the end twice.
    np.testing.assert_allclose(drawn(line), line[[0, -1, -1]], atol=1e-12)


def test_what_is_left_out_is_hardly_beside_the_line():
    rng = np.random.default_rng(1)
    path = np.column_stack([np.linspace(0, 2, 300), 0.002 * rng.standard_normal(300)])
    shown = drawn(path)
    assert 50 < len(shown) < 290
    # 1/9 point is 0.9 mm along y; the vertices on either side may be moved by as much.
    off = np.abs(np.interp(path[:, 0], *shown.T) - path[:, 1])
    assert 1e-4 < off.max() < 2.0 / 9.0 / 122.9


def test_corners_wherever_the_square_is():
    assert find_corners(VERTICES).tolist() == FOUND
    angle = 0.7
    turn = np.array([(np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))])
    assert find_corners(VERTICES @ turn + [3, 4]).tolist() == FOUND


def test_a_zigzag_moves_no_corner():
    zigzag = [(2 - 0.2 * k, -2 + 0.2 * (-1) ** k) for k in range(1, 10)]
    path = [(0, 0), (1, 0), (2, 0), (2, -1), (2, -2), *zigzag, (0, -2), (0, -1), (0, 0)]
    assert find_corners(path).tolist() == [0, 2, 4, 14, 16]


def test_a_path_of_many_vertices_has_corners_too():
    sides = [np.linspace(a, b, 150, endpoint=False) for a, b in zip(CORNERS, CORNERS[1:])]
    path = np.concatenate([*sides, CORNERS[-1:]])
    assert np.hypot(*(path[find_corners(path)] - CORNERS).T).max() < 0.1


@pytest.mark.parametrize("vertices", [CORNERS[:4], np.zeros((8, 2))])
def test_four_vertices_are_no_square(vertices):
    with refuses("four sides"):
        find_corners(vertices)


def test_lengths():
    perfect = CORNERS + [(9, 9), (0.003, 0.004), (0, 0.002), (0, 0), (9, 9)]
    expected = [0.01, 0.02, 0.03, 0.04, 0.005, 0.005]
    np.testing.assert_allclose(measure(VERTICES, perfect), expected, atol=1e-12)


def test_what_figure_1b_shows(package):
    figure = read_published_figure(package / "data" / "fig1_paths.csv")
    expected = [1.6, 3.0, 213.6, 1.55, 1.6, 0.41]
    np.testing.assert_allclose(1e3 * figure.lengths, expected, atol=0.06)
    assert figure.third_side_steps == 9
    # The noisy path ends where the perfect one does.
    assert np.hypot(*(figure.points[-1] - figure.perfect_corners[-1])) < 1e-3


@cases(r"""
text, error:
  - ["", "has to name the columns series, x_m, y_m"]
  - ["series,x_m,y_m\nfig1b_noisy,1\n", "line 2: a value is not a number"]
  - ["series,x_m,y_m\nfig1b_noisy,0,0\n", no path fig1b_perfect]
  - ["series,x_m,y_m\nfig1b_noisy,0,0\nfig1b_perfect,1,1\n", four sides]
""")
def test_a_bad_figure_file(tmp_path, text, error):
    path = tmp_path / "figure.csv"
    with refuses("cannot read"):
        read_published_figure(path)
    path.write_text(text)
    with refuses(error):
        read_published_figure(path)
