"""The ROS master that a run joins."""

import os
from unittest import mock

import pytest

from bullet_lab.ros.launcher import supervision


@pytest.mark.parametrize("user, joins", [(0, True), (1, False)])
@pytest.mark.parametrize("uri", [supervision.STOCK_URI, supervision.STOCK_URI + "/"])
def test_the_stock_master_of_another_user_is_not_joined(monkeypatch, user, joins, uri):
    running, own, mine = mock.Mock(), mock.Mock(uri="http://127.0.0.1:1/"), os.getuid()
    running.get.return_value = running
    running.getPid.return_value = (1, "", os.getpid())
    running.getParam.return_value = (1, "", "run")
    monkeypatch.setattr(supervision, "Master", lambda uri: running)
    monkeypatch.setattr(supervision, "_answers", lambda uri: True)
    monkeypatch.setattr(supervision.rosmaster.master, "Master", lambda port: own)
    monkeypatch.setattr(supervision.os, "getuid", lambda: mine + user)
    monkeypatch.setattr(supervision.os, "environ", {"ROS_MASTER_URI": uri})
    assert supervision.prepare_master().own is not joins
