"""The parameter std is checked where it comes in, and nowhere else on its way to a draw."""

from types import SimpleNamespace

import pytest

from bullet_lab.core.parameters import ParameterError
from bullet_lab.studies import squares

# No default, and no other parameter's value.
STD = 0.2731


@pytest.fixture
def noisy_odom(monkeypatch):
    """The node's module, without a connection to a master."""
    pytest.importorskip("rospy")
    from bullet_lab.ros.nodes import noisy_odom

    for name in ("publisher", "Publisher", "subscriber"):
        monkeypatch.setattr(noisy_odom, name, lambda *args, **more: None)
    monkeypatch.setattr(noisy_odom.rospy, "Service", lambda *args: None)
    return noisy_odom


def test_settings_made_in_python_are_checked(tmp_path):
    with pytest.raises(ParameterError, match="std"):
        squares.run_squares(tmp_path, squares.SquaresSettings(std=-1.0))


def test_a_request_to_the_node_is_checked(noisy_odom):
    node = noisy_odom.NoisyOdometry(noisy_odom.NoisyOdomParameters(seed=1))
    refused = node.set_noise(SimpleNamespace(model="report", std=-1.0, alphas=[]))
    assert (refused.success, "std is -1.0: it must be" in refused.status_message) == (False, True)
    refused = node.set_noise(SimpleNamespace(model="probabilistic", std=0.1, alphas=[0, 0, -1, 0]))
    assert "alpha3 is -1: it must be" in refused.status_message
    refused = node.set_noise(SimpleNamespace(model="nix", std=0.1, alphas=[]))
    assert "unknown noise model 'nix'" in refused.status_message
    assert node.std == noisy_odom.NoisyOdomParameters.std
    assert node.set_noise(SimpleNamespace(model="report", std=0.3, alphas=[])).success
    assert node.std == 0.3
