"""A noise model is one class: everything else goes through those that are registered."""

import subprocess
import sys
from dataclasses import dataclass, fields

import numpy as np
import pytest
from recorded_paths import make_rule, recover_noise

from bullet_lab.core.parameters import ParameterError, check_parameters, declarations, number
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.noise.noisy_paths import study_generator
from bullet_lab.noise.odometry_noise import (
    MODELS,
    NoiseError,
    NoiseRule,
    NoisyPath,
    ReportRule,
    noise_parameters,
    register,
    rule_of,
)
from bullet_lab.studies.noise_study.study import StudySettings, run_study

SLIP = """
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
"""
exec(SLIP)  # so that another process has the same class
SlipRule = globals()["SlipRule"]


@pytest.fixture
def slip(monkeypatch):
    for name, model in dict(MODELS).items():
        monkeypatch.setitem(MODELS, name, model)
    register(SlipRule)
    yield SlipRule
    del MODELS["slip"]


def bend():
    heading = np.concatenate([np.zeros(30), np.linspace(0.0, 1.5, 20), np.full(30, 1.5)])
    way = np.concatenate([[0.0], np.cumsum(0.1 * np.exp(1j * heading))])
    poses = np.column_stack([way.real, way.imag, np.concatenate([heading, [1.5]])])
    return Trajectory(0.1 * np.arange(len(way)), poses)


def test_a_model_that_is_registered_is_known_by_its_name(slip):
    assert rule_of("slip", {"std": 0.2, "alpha1": 0.5}) == SlipRule(0.2, 0.25)
    assert rule_of("slip", {"std": 0.2, "slip": 0.5}) == SlipRule(0.2, 0.5)
    assert make_rule("slip", 0.2, [0.5]) == SlipRule(0.2, 0.5)
    with pytest.raises(NoiseError, match="the slip model takes 1 alphas, not 2"):
        make_rule("slip", 0.2, [0.5, 0.5])
    with pytest.raises(ParameterError, match="slip is 2.0: it must be a number >= 0 and <= 1"):
        check_parameters(rule_of("slip", {"slip": 2.0}))


def test_its_noise_is_put_on_pose_by_pose(slip):
    poses, rule = bend().poses, rule_of("slip", {"std": 0.05, "slip": 0.01})
    path = NoisyPath(rule, 3)
    noisy = np.array([path.update(*pose).pose for pose in poses.tolist()])
    found = recover_noise(poses, noisy).standardised(rule)
    draws = np.random.default_rng(3).standard_normal((len(poses) - 1, 3))
    np.testing.assert_allclose(found[:, 1], draws[:, 0], atol=1e-6)


@pytest.mark.long
def test_it_is_studied_and_drawn_as_the_others_are(slip, tmp_path):
    settings = StudySettings(
        levels=(0.0, 0.05), models=("report", "slip"), rates=(10.0,), paths=2000
    )
    summary = run_study(tmp_path, settings, bend())
    assert (tmp_path / "levels_slip.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "tum" / "slip_std_0.05.tum").exists()
    case = next(c for c in summary["cases"] if (c["model"], c["std"]) == ("slip", 0.05))
    pose = case["final_pose_error"]
    exact, sample = (np.array(pose[f"{kind}_covariance"]) for kind in ("exact", "sample"))
    assert exact[0, 0] > 0.0
    np.testing.assert_allclose(sample, exact, atol=0.2 * np.abs(exact).max())
    (other,) = [c for c in summary["cases"] if (c["model"], c["std"]) == ("report", 0.05)]
    assert pose != other["final_pose_error"]


def test_the_node_takes_it_with_its_parameters():
    pytest.importorskip("bullet_lab.srv")
    code = (
        "from dataclasses import asdict, dataclass\n"
        "from bullet_lab.core.parameters import declarations, number, read_parameters\n"
        "from bullet_lab.noise.odometry_noise import NoiseRule, register, rule_of\n"
        f"{SLIP}\n"
        "register(SlipRule)\n"
        "from bullet_lab.ros.nodes.noisy_odom import NoisyOdomParameters\n"
        "said = {'~model': 'slip', '~slip': 0.5, '~std': 0.3}\n"
        "found = read_parameters(NoisyOdomParameters, said.get)\n"
        "print(rule_of(found.model, asdict(found)), list(declarations(NoisyOdomParameters)))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert done.returncode == 0
    assert "SlipRule(std=0.3, slip=0.5)" in done.stdout
    assert done.stdout.count("'std'") == 1


def test_models_share_no_name_and_no_random_numbers(slip):
    assert len({model.stream for model in MODELS.values()}) == len(MODELS)
    for name, stream in (("report", 18), ("other", 0), ("slip", 18), ("other", 17)):
        taken = type("Taken", (SlipRule,), {"name": name, "stream": stream})
        with pytest.raises(ValueError, match="has the name or the stream of"):
            register(taken)
    assert list(MODELS) == ["report", "rate_invariant", "probabilistic", "slip"]


def test_a_model_that_comes_along_changes_no_study():
    def draws():
        return [study_generator(5, m, 0.1, 20.0).standard_normal() for m in FIRST]

    before = draws()
    for name, model in [*MODELS.items()]:
        del MODELS[name]
        MODELS[name] = model
        assert draws() == before
    # The places that they had in a list once.
    assert [MODELS[name].stream for name in FIRST] == [0, 1, 2]
    assert before == pytest.approx(FIRST_DRAWS, abs=1e-12)


FIRST = ("report", "rate_invariant", "probabilistic")
FIRST_DRAWS = [-1.4242748557497682, -0.1858446316504101, 1.5277539732476193]


def test_a_parameter_of_several_models_is_declared_once():
    names = [entry.name for entry in fields(noise_parameters())]
    assert names == ["std", "alpha1", "alpha2", "alpha3", "alpha4"]
    assert set(declarations(ReportRule)) == {"std"}


def test_a_rule_without_variances_is_none():
    @dataclass(frozen=True)
    class Nothing(NoiseRule):
        name, title, stream = "nothing", "Nothing", 99
        std: float = number(0.1, "of nothing")

    with pytest.raises(TypeError, match="abstract"):
        Nothing()
