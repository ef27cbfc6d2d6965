import gc
import threading
import time
import weakref

import pytest

pytest.importorskip("rospy")

from bullet_lab.ros.node import node


class Thing:
    def __init__(self):
        self.myself = self


def test_what_holds_itself_is_freed_however_seldom_python_looks(monkeypatch):
    over = threading.Event()
    monkeypatch.setattr(node, "GARBAGE_SECONDS", 0.01)
    monkeypatch.setattr(node.rospy, "is_shutdown", over.is_set)
    collector = threading.Thread(target=node._collect_garbage)
    gc.disable()
    try:
        collector.start()
        thing = weakref.ref(Thing())
        end = time.monotonic() + 20.0
        while thing() is not None and time.monotonic() < end:
            time.sleep(0.01)
        assert thing() is None
    finally:
        over.set()
        collector.join()
        gc.enable()
        gc.unfreeze()
