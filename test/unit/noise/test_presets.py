"""Measured noise has valid parameters and takes the place of given ones."""

from dataclasses import asdict, replace

import pytest

from bullet_lab.core.parameters import check_parameters
from bullet_lab.noise.presets import NONE, PRESETS, with_preset
from bullet_lab.studies.squares import SquaresSettings


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_valid_and_complete(name):
    found = with_preset(SquaresSettings(noise=name))
    check_parameters(found)
    assert {key: asdict(found)[key] for key in PRESETS[name]} == PRESETS[name]
    assert found.model == PRESETS[name]["model"]


def test_without_a_preset_nothing_changes():
    given = SquaresSettings(std=0.3)
    assert with_preset(given) == given == replace(given, noise=NONE)
