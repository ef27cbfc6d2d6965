import subprocess
import sys

import pytest

# Its main thread holds a lock, as rospy does that of its connection to the master, which the end
# of the node needs.
PROGRAM = """
import os, signal, threading, time
import rospy
from bullet_lab.ros.node.node import Signals
lock = threading.Lock()
rospy.core.add_preshutdown_hook(lambda _: lock.acquire())
signals = Signals()
with lock:
    os.kill(os.getpid(), signal.{name})
    time.sleep(0.1)
signals.wait()
print(rospy.is_shutdown())
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_signal_ends_a_node_whose_main_thread_is_busy(name):
    program = PROGRAM.format(name=name)
    run = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60
    )
    assert (run.returncode, run.stdout, run.stderr) == (0, "True\n", "")
