import threading
import time

import pytest

pytest.importorskip("rospy")

from bullet_lab.ros.node.publishers import await_room


class Connection:
    """A connection as rospy has them, whose queue another thread empties."""

    def __init__(self, waiting):
        self._queue = ["message"] * waiting
        self.done = False

    def later(self, action):
        def act():
            time.sleep(0.05)
            action()

        threading.Thread(target=act, daemon=True).start()


def test_a_full_queue_is_waited_for():
    connection = Connection(waiting=5)
    connection.later(connection._queue.pop)
    await_room(connection, 5)
    assert len(connection._queue) == 4


def test_nobody_waits_for_a_subscriber_that_is_gone():
    connection = Connection(waiting=5)
    connection.later(lambda: setattr(connection, "done", True))
    await_room(connection, 5)
    assert connection.done


@pytest.mark.parametrize(("waiting", "size"), [(4, 5), (5, None)])
def test_where_there_is_room_nobody_waits(waiting, size):
    await_room(Connection(waiting), size)
    await_room(object(), size)
