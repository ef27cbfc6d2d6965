"""Whether what was written and read again, or what is found, is the same as before."""

import math
import os
from collections.abc import Mapping
from dataclasses import is_dataclass
from itertools import zip_longest
from xml.etree.ElementTree import Element, tostring

import numpy as np
import pytest
from shared import PACKAGE

from bullet_lab.core.pose import Pose

TOLERANCE = 1e-6
# What was not given may be so after reading; a joint without end is written as one without limits.
OPEN = ("", None, "continuous")


def assert_alike(one, other, *besides, within=TOLERANCE):
    """Compare data classes and what they hold, but for some fields and rounding."""

    def parts_alike(part, again):
        assert_alike(part, again, *besides, within=within)

    if isinstance(one, Pose):
        sign = math.copysign(1.0, np.dot(one.quaternion, other.quaternion))
        assert other.position == pytest.approx(one.position, abs=within)
        assert np.multiply(sign, other.quaternion) == pytest.approx(one.quaternion, abs=within)
    elif is_dataclass(one):
        for name in vars(one).keys() - set(besides):
            parts_alike(getattr(one, name), getattr(other, name))
    elif isinstance(one, Mapping):
        assert other.keys() == one.keys()
        for key, value in one.items():
            parts_alike(value, other[key])
    elif isinstance(one, (tuple, list)):
        assert len(other) == len(one)
        for value, again in zip(one, other):
            parts_alike(value, again)
    elif isinstance(one, (int, float, np.ndarray)):
        assert other == pytest.approx(one, abs=within)
    elif isinstance(one, Element):
        assert other.get("type") == one.get("type")
    elif one not in OPEN:
        assert other == one


def shown(value):
    return f"{round(value, 8) + 0.0:.7g}" if isinstance(value, float) else str(value)


def is_made_of_parts(value):
    return is_dataclass(value) or isinstance(value, (tuple, np.ndarray))


def lines_of(value, name):
    """Yield a line for each value in data classes and what they hold, numbers to seven digits."""
    if is_dataclass(value):
        value = {"": type(value).__name__, **vars(value)}
    if isinstance(value, np.ndarray):
        value = value.ravel().tolist()
    if isinstance(value, Element):
        value = tostring(value, "unicode").split()
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from lines_of(inner, f"{name}.{key}")
    elif isinstance(value, (tuple, list)) and any(map(is_made_of_parts, value)):
        for number, inner in enumerate(value):
            yield from lines_of(inner, f"{name}.{number}")
    else:
        words = value if isinstance(value, (tuple, list)) else [value]
        yield f"{name}: {' '.join(map(shown, words))}"


def lines_of_figure(figure):
    """Yield a line for all that is written in each part of a figure, and for each line in it."""
    for number, axes in enumerate(figure.axes):
        texts = [*axes.texts, *(axes.get_legend().get_texts() if axes.get_legend() else ())]
        said = [text.get_text() for text in texts]
        said = [axes.get_title(), axes.get_xlabel(), axes.get_ylabel(), axes.get_aspect(), *said]
        yield from lines_of(said, f"{number} says")
        yield from lines_of([patch.get_facecolor() for patch in axes.patches], f"{number} patch")
        for line in axes.lines:
            x, y = (np.asarray(data, float) for data in line.get_data())
            ends = [*x[:1], *y[:1], *x[-1:], *y[-1:], np.nansum(x), np.nansum(y)]
            look = line.get_color(), line.get_marker(), len(x)
            yield from lines_of([*look, *map(float, ends)], f"{number} line")


def is_near(word, before, within):
    """Return whether two words are the same, or two numbers nearly so."""
    try:
        return math.isclose(float(word), float(before), rel_tol=within, abs_tol=within)
    except ValueError:
        return word == before


def assert_as_before(lines, path, within=TOLERANCE):
    """Compare lines with those in a file; with LAB_RENEW_TEXTS=1 in the environment, write them.

    Paths in the package are without its own; numbers may differ by a share, as libraries round.
    """
    text = "".join(f"{line}\n" for line in lines).replace(str(PACKAGE), "")
    if os.environ.get("LAB_RENEW_TEXTS"):
        path.write_text(text)
    told, before = text.splitlines(), path.read_text().splitlines()
    for line, kept in zip(told, before):
        pairs = list(zip_longest(line.split(" "), kept.split(" "), fillvalue=""))
        assert line == kept or all(is_near(*pair, within) for pair in pairs)
    assert len(told) == len(before)
