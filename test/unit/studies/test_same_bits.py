"""The last bit of functions that systems round differently does not change a result."""

import math

import numpy as np
from shared import cases

from bullet_lab.studies.squares import SquaresSettings, run_squares

ROUNDED_DIFFERENTLY = {
    math: ("hypot", "dist", "atan2", "atan", "asin", "acos", "tan"),
    np: ("hypot", "arctan2", "arctan", "arcsin", "arccos", "tan"),
}


def nudged(function):
    """Return a function whose results are the next larger numbers."""
    return lambda *numbers, **options: np.nextafter(function(*numbers, **options), np.inf) * 1.0


@cases("settings: [{std: 0.1}, {std: 0.1, as_published: true}, {model: probabilistic}]")
def test_squares_are_the_same_to_the_byte(settings, tmp_path, monkeypatch):
    run_squares(tmp_path / "here", SquaresSettings(**settings))
    for module, names in ROUNDED_DIFFERENTLY.items():
        for name in names:
            monkeypatch.setattr(module, name, nudged(getattr(module, name)))
    run_squares(tmp_path / "there", SquaresSettings(**settings))
    for ours in (tmp_path / "here").iterdir():
        assert ours.read_bytes() == (tmp_path / "there" / ours.name).read_bytes(), ours.name
