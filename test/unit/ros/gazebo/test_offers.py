import pytest

pytest.importorskip("rospy")

from bullet_lab.errors import LabError
from bullet_lab.ros.gazebo import offers
from bullet_lab.ros.messages.gazebo_types import srv


def raising(error):
    raise error


@pytest.mark.parametrize(
    ("error", "said", "logged"),
    [
        (LabError("no such model"), "DeleteModel: no such model", False),
        (RuntimeError("never thought of"), "never thought of", True),
    ],
)
def test_errors_are_answers(monkeypatch, error, said, logged):
    log = []
    monkeypatch.setattr(offers.rospy, "Service", lambda name, kind, handle: handle)
    monkeypatch.setattr(offers.rospy, "logerr", lambda *words: log.append(words))
    handle = offers.offer("delete_model", srv.DeleteModel, lambda request: raising(error))
    answer = handle(srv.DeleteModel._request_class("a"))
    assert not answer.success
    assert said in answer.status_message
    assert bool(log) == logged
