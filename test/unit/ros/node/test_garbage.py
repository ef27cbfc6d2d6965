import gc
import weakref
from types import SimpleNamespace

from bullet_lab.ros.node import node


class Thing:
    def __init__(self):
        self.myself = self


def test_what_holds_itself_is_freed_however_seldom_python_looks(monkeypatch):
    things = []
    clock = SimpleNamespace(sleep=lambda _: things.append(weakref.ref(Thing())))
    monkeypatch.setattr(node, "time", clock)
    monkeypatch.setattr(node.rospy, "is_shutdown", lambda: len(things) > 1)
    gc.disable()
    try:
        node._collect_garbage()
    finally:
        gc.enable()
        gc.unfreeze()
    assert [thing() for thing in things] == [None, None]
