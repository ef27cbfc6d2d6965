"""run.sh's launcher as a process."""

import subprocess
import sys

from bullet_lab.ros.launcher.command import STATUS_FAILED

ENDING = """
import os, signal
from bullet_lab.ros.launcher import command

class Last:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)

command._dispatch = lambda words: command.STATUS_FAILED
last = Last()
command.main()
"""


def test_ctrl_c_while_python_ends_changes_no_status():
    assert subprocess.run([sys.executable, "-c", ENDING], timeout=60).returncode == STATUS_FAILED
