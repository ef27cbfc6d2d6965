"""What all figures share."""

import io
import math
import re
from pathlib import Path

import matplotlib
from alike import assert_as_before
from PIL import Image

from bullet_lab.core.figures import (
    BLUE,
    draw_plan,
    labelled,
    legend_below,
    legend_entry,
    new_figure,
    panels,
    save,
    show_around,
)


def lines_of_drawing(figure):
    """All that is drawn, as SVG without the names of its parts; numbers are apart from words."""
    file = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "", "svg.fonttype": "none"}):
        figure.savefig(file, format="svg", metadata={"Date": None})
    drawn = re.sub(r"\b[mp][0-9a-f]{10}\b", "", file.getvalue().partition("<g ")[2])
    return re.sub(r'([(),;:"])', r" \1 ", drawn).splitlines()


def test_a_plan_is_to_scale_and_has_a_legend(tmp_path):
    figure, every = panels((2, 1), (3.0, 3.0), "title", ("along", "aside"), sharex=True)
    above, axes = every.flat
    draw_plan(axes, [[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)]], (1.0, 2.0, 0.5 * math.pi))
    draw_plan(above, [], (0.0, 0.0, 0.3))
    show_around(axes, [[(0.0, 0.0)], [(1.0, 2.0)]], 0.5)
    assert (axes.get_xlim(), axes.get_ylim()) == ((-0.5, 1.5), (-0.5, 2.5))
    above.set(xticks=[0.0], yticks=[1.0])
    handles = [*labelled(axes, axes), legend_entry("entry", color=BLUE)]
    legend_below(figure, handles, bottom=0.2)
    legend_below(figure, handles, 1)
    save(figure, tmp_path / "a")
    picture = Image.open(str(tmp_path / "a"))
    assert (picture.size, picture.info["Software"]) == ((330, 330), "")
    legend_below(bare := new_figure(1.0, 1.0), [])
    assert not (bare.legends or bare.texts)
    assert_as_before(lines_of_drawing(figure), Path(__file__).parent / "plan.txt")
