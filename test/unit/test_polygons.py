import numpy as np
import pytest

from bullet_lab.simulation.rendering.polygons import Piece, Shadow, grown, joined, outline

SQUARE = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)]
INNER = [(1.0, 1.0), (2.0, 1.0), (2.0, 3.0), (1.0, 3.0)]


def area(polygon):
    x, y = np.array(polygon).T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def areas(piece):
    found = {}
    for part in piece.pieces():
        found[part.unseen] = found.get(part.unseen, 0.0) + area(part.corners)
    return found


def test_an_outline_goes_counterclockwise_around_the_outermost_points():
    inside = np.random.default_rng(1).uniform(0.1, 3.9, (200, 2))
    found = outline(np.concatenate((inside, SQUARE)))
    assert found == pytest.approx(np.array(SQUARE))
    assert outline(np.array(SQUARE)[[2, 0, 3, 1]]) == SQUARE


def test_points_in_a_line_have_no_outline():
    assert outline(np.array([(0.0, 0.0), (1.0, 1.0), (2.0, 2.0)])) == []


def test_a_shadow_cuts_out_its_area():
    piece = Piece(SQUARE)
    piece.darken(Shadow(INNER, 0))
    assert areas(piece) == pytest.approx({0: 14.0, 1: 2.0})


def test_shadows_of_several_lights_overlap():
    piece = Piece(SQUARE)
    piece.darken(Shadow(INNER, 0))
    piece.darken(Shadow([(1.5, 0.0), (4.0, 0.0), (4.0, 4.0), (1.5, 4.0)], 2))
    assert areas(piece) == pytest.approx({0: 5.0, 1: 1.0, 4: 9.0, 5: 1.0})


def test_shadows_of_one_light_count_once():
    piece = Piece(SQUARE)
    for _ in range(3):
        piece.darken(Shadow(INNER, 0))
    piece.darken(Shadow([(1.0, 2.0), (4.0, 2.0), (4.0, 3.0), (1.0, 3.0)], 0))
    assert areas(piece) == pytest.approx({0: 12.0, 1: 4.0})


@pytest.mark.parametrize(
    ("shadow", "unseen"),
    [
        ([(-1.0, -1.0), (9.0, -1.0), (9.0, 9.0), (-1.0, 9.0)], 1),
        ([(4.0, 0.0), (9.0, 0.0), (9.0, 4.0), (4.0, 4.0)], 0),
        # Its box meets the square, it does not.
        ([(3.0, 6.0), (6.0, 3.0), (6.0, 6.0)], 0),
    ],
)
def test_what_no_edge_crosses_is_not_cut(shadow, unseen):
    piece = Piece(SQUARE)
    piece.darken(Shadow(shadow, 0))
    assert [(p.corners, p.unseen) for p in piece.pieces()] == [(SQUARE, unseen)]


def test_a_small_shadow_is_cut_out_of_its_own_corner():
    piece = Piece([(0.0, 0.0), (100.0, 0.0), (100.0, 100.0), (0.0, 100.0)])
    piece.enclose((1.0, 1.0, 2.0, 3.0))
    piece.darken(Shadow([(1.0, 1.0), (2.0, 2.0), (2.0, 3.0)], 0))
    assert areas(piece) == pytest.approx({0: 9999.5, 1: 0.5})
    inside = [p for p in piece.pieces() if np.max(p.corners) <= 3.0 and np.min(p.corners) >= 1.0]
    assert sum(area(p.corners) for p in inside) == pytest.approx(2.0)
    assert len(list(piece.pieces())) == 4 + len(inside)


def test_neighbours_are_joined_where_that_is_convex():
    triangles = [[(0.0, 0.0), (4.0, 0.0), (4.0, 4.0)], [(0.0, 0.0), (4.0, 4.0), (0.0, 4.0)]]
    (whole,) = joined(triangles)
    assert sorted(whole) == sorted(SQUARE)
    assert area(whole) == pytest.approx(16.0)
    roof = [(0.0, 4.0), (4.0, 4.0), (2.0, 5.0)]
    assert len(joined([*triangles, roof])) == 1
    spread = [(4.0, 0.0), (9.0, -5.0), (9.0, 9.0), (4.0, 4.0)]
    found = joined([*triangles, spread])
    assert len(found) == 2
    assert sum(map(area, found)) == pytest.approx(16.0 + area(spread))


def test_a_grown_polygon_reaches_over_all_its_sides():
    found = grown(SQUARE, 0.1)
    assert np.array(found) == pytest.approx(
        np.array([(-0.1, -0.1), (4.1, -0.1), (4.1, 4.1), (-0.1, 4.1)])
    )
