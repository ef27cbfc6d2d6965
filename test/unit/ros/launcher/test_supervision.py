"""The ROS master that a run joins."""

import os
from types import SimpleNamespace

import pytest

from bullet_lab.ros.launcher import supervision


@pytest.mark.parametrize("user, joins", [(0, True), (1, False)])
@pytest.mark.parametrize("uri", [supervision.STOCK_URI, supervision.STOCK_URI + "/"])
def test_the_stock_master_of_another_user_is_not_joined(monkeypatch, user, joins, uri):
    running = SimpleNamespace(
        get=lambda: running,
        getPid=lambda caller: (1, "", os.getpid()),
        getParam=lambda caller, name: (1, "", "run"),
    )
    own = SimpleNamespace(uri="http://127.0.0.1:1/", start=lambda: None)
    mine = os.getuid()
    monkeypatch.setattr(supervision, "Master", lambda uri: running)
    monkeypatch.setattr(supervision, "_answers", lambda uri: True)
    monkeypatch.setattr(supervision.rosmaster.master, "Master", lambda port: own)
    monkeypatch.setattr(supervision.os, "getuid", lambda: mine + user)
    for name in ("ROS_MASTER_URI", "ROS_IP", "ROS_HOSTNAME", "ROS_IPV6"):
        monkeypatch.setenv(name, uri if name == "ROS_MASTER_URI" else "")
    assert supervision.prepare_master().own is not joins
