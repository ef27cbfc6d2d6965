from types import SimpleNamespace

import pytest

from bullet_lab.ros.node import publishers
from bullet_lab.ros.node.publishers import await_room


@pytest.fixture
def connection(monkeypatch):
    """A connection as rospy has them, with five messages; something happens in each sleep."""
    made = SimpleNamespace(_queue=["message"] * 5, done=False, meanwhile=[])
    monkeypatch.setattr(publishers.time, "sleep", lambda _: made.meanwhile.pop(0)())
    return made


def test_a_full_queue_is_waited_for(connection):
    connection.meanwhile += [list, connection._queue.pop]
    await_room(connection, 5)
    assert len(connection._queue) == 4


def test_nobody_waits_for_a_subscriber_that_is_gone(connection):
    connection.meanwhile.append(lambda: setattr(connection, "done", True))
    await_room(connection, 5)
    assert connection.done


@pytest.mark.parametrize("size", [6, None])
def test_where_there_is_room_nobody_waits(connection, size):
    await_room(connection, size)
    await_room(object(), size)
