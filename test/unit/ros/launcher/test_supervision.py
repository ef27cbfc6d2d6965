"""The ROS master that a run joins."""

import os

import pytest

from bullet_lab.ros.launcher import supervision


@pytest.mark.parametrize(("user", "joins"), [(0, True), (1, False)])
@pytest.mark.parametrize("uri", [supervision.STOCK_URI, supervision.STOCK_URI + "/"])
def test_the_stock_master_of_another_user_is_not_joined(monkeypatch, user, joins, uri):
    class Master:
        def __init__(self, uri):
            pass

        def get(self):
            return self

        def getPid(self, caller):  # noqa: N802
            return 1, "", os.getpid()

        def getParam(self, caller, name):  # noqa: N802
            return 1, "", "run"

    class Own:
        uri = "http://127.0.0.1:1/"

        def __init__(self, port):
            pass

        def start(self):
            pass

    mine = os.getuid()
    monkeypatch.setattr(supervision, "Master", Master)
    monkeypatch.setattr(supervision, "_answers", lambda uri: True)
    monkeypatch.setattr(supervision.rosmaster.master, "Master", Own)
    monkeypatch.setattr(supervision.os, "getuid", lambda: mine + user)
    for name in ("ROS_MASTER_URI", "ROS_IP", "ROS_HOSTNAME", "ROS_IPV6"):
        monkeypatch.setenv(name, uri if name == "ROS_MASTER_URI" else "")
    assert supervision.prepare_master().own is not joins
