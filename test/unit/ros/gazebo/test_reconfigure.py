"""Settings as dynamic_reconfigure's generator would describe them."""

from types import SimpleNamespace
from unittest import mock

import pytest
from shared import cases, refuses

pytest.importorskip("dynamic_reconfigure.encoding")

from dynamic_reconfigure.encoding import decode_description, encode_description

from bullet_lab.errors import LabError
from bullet_lab.ros.gazebo import physics
from bullet_lab.ros.gazebo.devices import COMPRESSION, check_calibration
from bullet_lab.ros.gazebo.physics import _type_of
from bullet_lab.ros.messages.poses import InputError
from bullet_lab.simulation.plugins.controllers.controller import Setting


def test_clients_read_names_kinds_limits_and_choices():
    read = decode_description(encode_description(_type_of(COMPRESSION)))
    found = {parameter["name"]: parameter for parameter in read["parameters"]}
    assert list(found) == [setting.name for setting in COMPRESSION]
    quality = {"type": "int", "min": 1, "max": 100, "default": 80}
    assert quality.items() <= found["jpeg_quality"].items()
    switch = {"type": "bool", "min": False, "max": True}
    assert switch.items() <= found["jpeg_optimize"].items()
    assert "png" in found["format"]["edit_method"]


class Server:
    """The server of dynamic_reconfigure, to which clients speak in the tests."""

    def __init__(self, kind, take, namespace):
        self.config = take(dict(kind.defaults), -1)
        self.take = take

    def _set_callback(self, request):
        return request.config.groups


RATE = Setting("rate", 2.0, "Hz", 0.0, 50.0)


@pytest.fixture
def settings(monkeypatch):
    """A function that offers a rate of 2 Hz and returns its server."""
    monkeypatch.setattr(physics, "Server", Server)
    return lambda change: physics.Reconfigurable("/eye", [RATE], change)._server


def test_what_is_changed_is_asked_for_and_the_start_is_not(settings):
    change = mock.Mock(return_value={"rate": 5.0})
    server = settings(change)
    assert not change.called
    assert server.take({"rate": 9.0}, 1) == {"rate": 5.0}
    change.assert_called_once_with({"rate": 9.0})


@cases("rate: [.nan, .inf, 0.0]")
def test_what_is_refused_changes_nothing(settings, rate):
    def change(values):
        if not values["rate"] > 0.0:
            raise LabError("the rate has to be positive")
        return values

    server = settings(change)
    taken = [server.take({"rate": given}, 1)["rate"] for given in (rate, 9.0, rate)]
    assert taken == [2.0, 9.0, 9.0]


USUAL = {
    "D": [0.1] * 5,
    "K": [1.0] * 9,
    "R": [1.0] * 9,
    "P": [1.0] * 12,
    "distortion_model": "plumb_bob",
}


@cases("""
name, value, times, wrong:
  - [D, [.nan], 1, not finite]
  - [P, [.inf], 12, not finite]
  - [D, [0.0], 100000, at most 14]
  - [distortion_model, x, 10000, characters]
""")
def test_a_calibration_has_numbers_and_a_usual_size(name, value, times, wrong):
    check_calibration(USUAL)
    with refuses(wrong, InputError):
        check_calibration({**USUAL, name: times * value})


def test_without_the_package_nothing_is_offered(monkeypatch):
    monkeypatch.setattr(physics, "Server", None)
    physics.Reconfigurable("/eye", [RATE], dict).shutdown()


def test_groups_of_a_request_are_ignored(settings):
    without_a_first = SimpleNamespace(config=SimpleNamespace(groups=["id 7, parent 7"]))
    assert settings(dict)._set_callback(without_a_first) == []
