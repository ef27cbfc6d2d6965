"""An error that ends a thread of a node."""

import threading

import pytest

from bullet_lab.ros.node import node


@pytest.mark.parametrize("ending", [False, True])
def test_an_error_in_a_thread_is_reported_unless_the_node_ends(monkeypatch, caplog, ending):
    reported = []
    monkeypatch.setattr(node, "is_ending", lambda: ending)
    monkeypatch.setattr(
        threading, "excepthook", lambda error: node._report_error(reported.append, error)
    )
    with caplog.at_level("INFO", logger="rospy"):
        thread = threading.Thread(target=lambda: [].close(), name="/odom")
        thread.start()
        thread.join()
    assert len(reported) == (not ending)
    assert ("AttributeError" in caplog.text) == ending
