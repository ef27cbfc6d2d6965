import threading

import pytest

from bullet_lab.ros.node import node

OWN, OTHER = "http://here:1", "http://there:2"


class FakeMaster:
    """A master that answers one thing after the other, and the last one again and again."""

    def __init__(self, *answers):
        self.answers = list(answers)

    def lookupNode(self, name):  # noqa: N802 (as rosgraph has it)
        answer = self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
        if answer is None:
            raise OSError
        return answer


@pytest.mark.parametrize("end", [None, OTHER])
def test_a_node_ends_when_its_master_is_gone_or_another_one_but_not_for_a_single_miss(
    monkeypatch, end
):
    master, reasons = FakeMaster(OWN, OWN, end, OWN, end, end), []
    monkeypatch.setattr(node, "MASTER_CHECK_SECONDS", 0.001)
    monkeypatch.setattr(node.rosgraph, "Master", lambda _: master)
    monkeypatch.setattr(node.rospy, "get_node_uri", lambda: OWN)
    monkeypatch.setattr(node.rospy, "is_shutdown", lambda: bool(reasons))
    monkeypatch.setattr(node.rospy, "signal_shutdown", reasons.append)
    gone = threading.Event()
    node._watch_master(gone)
    assert gone.is_set()
    assert reasons == ["the ROS master is gone"]
    assert master.answers == [end]
