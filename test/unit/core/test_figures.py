"""What all figures share."""

import math
from pathlib import Path

from alike import assert_as_before, lines_of_figure

from bullet_lab.core.figures import draw_plan, labelled, legend_below, new_figure, show_around


def test_a_plan_is_to_scale_and_has_a_legend():
    figure = new_figure(4.0, 3.0)
    axes = figure.subplots()
    draw_plan(axes, [[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)]], (1.0, 2.0, 0.5 * math.pi))
    assert_as_before(lines_of_figure(figure), Path(__file__).parent / "plan.txt")
    legend_below(figure, labelled(axes, axes))
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["marker"]
    show_around(axes, [[(0.0, 0.0)], [(1.0, 2.0)]], 0.5)
    assert (axes.get_xlim(), axes.get_ylim()) == ((-0.5, 1.5), (-0.5, 2.5))
