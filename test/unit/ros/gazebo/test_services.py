import pytest

from bullet_lab.errors import LabError
from bullet_lab.ros.gazebo import services
from bullet_lab.ros.messages.gazebo_types import srv


def raising(error):
    raise error


@pytest.mark.parametrize(
    "error, message, is_logged",
    [
        (LabError("no such model"), "DeleteModel: no such model", False),
        (RuntimeError("unexpected"), "unexpected", True),
    ],
)
def test_errors_are_answers(monkeypatch, logged, error, message, is_logged):
    monkeypatch.setattr(services.rospy, "Service", lambda name, kind, handle: handle)
    kind = srv.DeleteModel
    handle = services.offer("x", kind, lambda request: raising(error), failed="DeleteModel: ")
    answer = handle(srv.DeleteModel._request_class("a"))
    assert not answer.success
    assert message in answer.status_message
    assert bool(logged) == is_logged
