"""A noise model is one class: everything else goes through those that are registered.

The parameter std is checked where it comes in, and nowhere else on its way to a draw.
"""

import sys
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np
import pytest
from alike import assert_as_before, lines_of
from noise_paths import drive
from recorded_paths import make_rule
from shared import cases

from bullet_lab.core import parameters
from bullet_lab.core.parameters import (
    ParameterError,
    check_parameters,
    declarations,
    number,
    read_parameters,
)
from bullet_lab.noise.calibration import Problem, fit, intervals
from bullet_lab.noise.goodness import drawn_pairs
from bullet_lab.noise.likelihood import StepPairs
from bullet_lab.noise.noisy_odom import NONE, PRESETS, OdometryNoise, with_preset
from bullet_lab.noise.noisy_paths import study_generator
from bullet_lab.noise.odometry_noise import (
    MODELS,
    NoiseRule,
    ReportRule,
    noise_parameters,
    register,
    rule_of,
)
from bullet_lab.noise.systematic import SystematicErrors, SystematicSpread
from bullet_lab.studies.squares import SquaresSettings


@dataclass(frozen=True)
class SlipRule(NoiseRule):
    name, title, stream = "slip", "Slipping", 17

    std: float = number(0.1, "per metre", minimum=0.0)
    slip: float = number(0.25, "m per message", minimum=0.0, maximum=1.0)

    @classmethod
    def at_level(cls, std):
        return cls(std, 0.1 * std)

    def variances(self, rot1, trans, rot2):
        return 0.0 * rot1, (self.std * trans) ** 2 + self.slip**2, (self.std * rot2) ** 2


@pytest.fixture
def slip(monkeypatch):
    for name, model in dict(MODELS).items():
        monkeypatch.setitem(MODELS, name, model)
    register(SlipRule)
    yield SlipRule
    del MODELS["slip"]


def test_a_model_that_is_registered_is_known_by_its_name(slip):
    assert rule_of("slip", {"std": 0.2, "alpha1": 0.5}) == SlipRule(0.2, 0.25)
    assert rule_of("slip", {"std": 0.2, "slip": 0.5}) == SlipRule(0.2, 0.5)
    assert make_rule("slip", 0.2, [0.5]) == SlipRule(0.2, 0.5)
    with pytest.raises(ParameterError, match="slip is 2.0: it must be a number >= 0 and <= 1"):
        check_parameters(rule_of("slip", {"slip": 2.0}))


def test_its_parameters_are_calibrated(slip):
    steps = np.tile([[0.04, 0.0, 0.0], [0.0, 0.0, 0.1]], (100, 1))
    true = StepPairs(steps, steps[np.newaxis])
    pairs = drawn_pairs(true, SlipRule(0.1, 0.02), np.random.default_rng(1), 1, steps)
    std, slipped = intervals(fit(Problem(pairs, "slip")))[0]
    assert 0.05 < std[0] < 0.1 < std[1] < 0.15
    assert 0.01 < slipped[0] < 0.02 < slipped[1] < 0.03


def test_models_share_no_name_and_no_random_numbers(slip):
    assert len({model.stream for model in MODELS.values()}) == len(MODELS)
    for name, stream in (("report", 18), ("other", 0), ("slip", 18), ("other", 17)):
        taken = type("Taken", (SlipRule,), {"name": name, "stream": stream})
        with pytest.raises(ValueError, match="has the name or the stream of"):
            register(taken)
    assert list(MODELS) == ["report", "rate_invariant", "probabilistic", "random_walk", "slip"]


def test_a_model_that_comes_along_changes_no_study():
    names = ("report", "rate_invariant", "probabilistic")
    draws = [study_generator(5, name, 0.1, 20.0).standard_normal() for name in names]
    # As before models could be registered, when their places in a list were the streams.
    before = [-1.4242748557497682, -0.1858446316504101, 1.5277539732476193]
    assert draws == pytest.approx(before, abs=1e-12)


def test_a_parameter_of_several_models_is_declared_once(slip):
    names = [entry.name for entry in fields(noise_parameters())]
    alphas = ["alpha1", "alpha2", "alpha3", "alpha4"]
    assert names == ["std", *alphas, "way_std", "heading_std", "turn_std", "slip"]
    assert set(declarations(ReportRule)) == {"std"}


def test_parameters_and_their_limits_are_as_before():
    found = {}
    for kind in (*MODELS.values(), SystematicErrors, SystematicSpread):
        said = {name: (one.doc, one.allowed) for name, one in declarations(kind).items()}
        found[kind.__name__] = kind(), said
    found["scaled"] = tuple(model.at_level(0.3).scaled(2.5) for model in MODELS.values())
    assert_as_before(lines_of({**found, **PRESETS}, ""), Path(__file__).with_name("models.txt"))


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_valid_and_complete(name):
    found = with_preset(SquaresSettings(noise=name))
    check_parameters(found)
    assert asdict(found).items() >= PRESETS[name].items()


@pytest.mark.parametrize("as_published", [False, True])
def test_noise_and_systematic_errors_are_added_as_before(as_published):
    """To a robot that drives on arcs ahead and back, with a rest."""
    settings = SquaresSettings(noise="create_vicon", seed=3, as_published=as_published)
    noise = OdometryNoise(settings, 1.1)
    path = drive((1.0, 2.0, 3.0), (9, (0.1, 0.0, 0.2)), (3, (0.0, 0.0, 0.0)), (9, (-0.1, 0.0, 0.1)))
    found = []
    for _ in range(2):
        found += [noise.update(0.4 * number, pose) for number, pose in enumerate(path)]
        noise.restart()
    text = Path(__file__).with_name(f"added_{as_published}.txt")
    assert_as_before(lines_of(tuple(found), ""), text)


def test_without_a_preset_nothing_changes():
    given = SquaresSettings(std=0.3)
    assert with_preset(given) == given == replace(given, noise=NONE)


# No default, and no other parameter's value.
STD = 0.2731


@pytest.fixture
def checks():
    """The checks of a number that is `STD`."""
    found = []

    def count(frame, event, _):
        is_check = event == "call" and frame.f_code is parameters._float.__code__
        if is_check and str(frame.f_locals["value"]) == str(STD):
            found.append(frame.f_locals["value"])

    sys.setprofile(count)
    yield found
    sys.setprofile(None)


@pytest.fixture
def noisy_odom(monkeypatch):
    """The node's module, without a connection to a master."""
    pytest.importorskip("rospy")
    from bullet_lab.ros.nodes import noisy_odom

    for name in ("publisher", "Publisher", "subscriber"):
        monkeypatch.setattr(noisy_odom, name, lambda *args, **more: None)
    monkeypatch.setattr(noisy_odom.rospy, "Service", lambda *args: None)
    return noisy_odom


@pytest.mark.parametrize("model", MODELS)
@cases("""
as_published:
  - "true"
  - "false"
""")
def test_in_a_start_of_noisy_odom(noisy_odom, checks, model, as_published):
    given = {"~std": STD, "~model": model, "~as_published": as_published, "~robots": 2}
    read = read_parameters(noisy_odom.NoisyOdomParameters, given.get)
    every = noisy_odom.robots_of(read).items()
    robots = [noisy_odom.NoisyOdometry(own, name) for name, own in every]
    assert [robot.std for robot in robots] == [STD, STD]
    assert len(checks) == 1
