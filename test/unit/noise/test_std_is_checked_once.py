"""The parameter std is checked where it comes in, and nowhere else on its way to a draw."""

import sys
from types import SimpleNamespace

import pytest

from bullet_lab.core import parameters
from bullet_lab.core.parameters import ParameterError, read_parameters
from bullet_lab.noise.odometry_noise import MODELS
from bullet_lab.studies import squares
from bullet_lab.studies.study import UnfinishedError

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
@pytest.mark.parametrize("as_published", ["true", "false"])
def test_in_a_start_of_noisy_odom(noisy_odom, checks, model, as_published):
    given = {"~std": STD, "~model": model, "~as_published": as_published, "~robots": 2}
    read = read_parameters(noisy_odom.NoisyOdomParameters, given.get)
    every = noisy_odom.robots_of(read).items()
    robots = [noisy_odom.NoisyOdometry(own, name) for name, own in every]
    assert [robot.std for robot in robots] == [STD, STD]
    assert len(checks) == 1


@pytest.mark.parametrize("as_published", ["true", "false"])
def test_in_the_squares_in_one_process(monkeypatch, capfd, tmp_path, checks, as_published):
    def drive(*args):
        raise UnfinishedError("the noise is there")

    monkeypatch.setattr(squares, "drive_square", drive)
    words = ["--std", str(STD), "--as-published", as_published]
    with pytest.raises(SystemExit):
        squares.main([str(tmp_path / "out"), *words])
    assert "the noise is there" in capfd.readouterr().err
    assert checks == [str(STD)]


def test_settings_made_in_python_are_checked(tmp_path):
    with pytest.raises(ParameterError, match="std"):
        squares.run_squares(tmp_path, squares.SquaresSettings(std=-1.0))


@pytest.mark.parametrize("model", MODELS)
def test_a_request_to_the_node_is_checked(noisy_odom, model):
    node = noisy_odom.NoisyOdometry(noisy_odom.NoisyOdomParameters(seed=1))

    def ask(*given):
        return node.set_noise(SimpleNamespace(**dict(zip(("model", "std", "alphas"), given))))

    for given, said in (
        ((model, -1.0, []), "std is -1.0: it must be"),
        (("probabilistic", 0.1, [0, 0, -1, 0]), "alpha3 is -1: it must be"),
        (("nix", 0.1, []), "unknown noise model 'nix'"),
    ):
        refused = ask(*given)
        assert not refused.success and said in refused.status_message
    assert node.std == noisy_odom.NoisyOdomParameters.std
    assert ask(model, 0.3, []).success
    assert node.std == 0.3
