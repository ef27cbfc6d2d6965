import subprocess
import sys

import pytest

# Its main thread holds a lock that the end of the node needs, until the node ends, as rospy does
# while it registers with a master that is gone.
PROGRAM = """
import os, signal, threading, time
import rospy
from bullet_lab.ros.node.node import Signals
lock = threading.Lock()
signals = Signals()
rospy.core.add_preshutdown_hook(lambda _: lock.acquire())
with lock:
    os.kill(os.getpid(), signal.{name})
    while not rospy.is_shutdown():
        time.sleep(0.01)
signals.wait()
print(rospy.is_shutdown())
"""

# The kernel may give a signal to any thread; Python's handler runs in the main thread.
SPINNING = """
import signal, threading, time
from bullet_lab.ros.node.node import Signals, spin
def kill():
    time.sleep(0.5)
    signal.pthread_kill(threading.get_ident(), signal.SIGTERM)
    time.sleep(1000)
signals = Signals()
threading.Thread(target=kill, daemon=True).start()
spin()
print(signals.number)
"""


def test_a_signal_that_another_thread_gets_ends_a_node_that_only_listens():
    run = subprocess.run(
        [sys.executable, "-c", SPINNING], capture_output=True, text=True, timeout=60
    )
    assert (run.stdout, run.stderr) == ("15\n", "")


@pytest.mark.parametrize("name", [pytest.param("SIGINT", marks=pytest.mark.long), "SIGTERM"])
def test_a_signal_ends_a_node_whose_main_thread_is_busy(name):
    program = PROGRAM.format(name=name)
    run = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60
    )
    assert (run.returncode, run.stdout, run.stderr) == (0, "True\n", "")
