import os
import signal
import subprocess
import sys

import pytest

CODE = """
import os, signal, time
from bullet_lab.studies.interruption import interrupt_once
interrupt_once()
try:
    print("ready", flush=True)
    time.sleep(60.0)
except KeyboardInterrupt:
    for number in (signal.SIGTERM, signal.SIGINT):
        os.kill(os.getpid(), number)
        time.sleep(0.01)
    print("cleared away", flush=True)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_second_signal_does_not_interrupt_what_the_first_one_has_begun(number):
    process = subprocess.Popen([sys.executable, "-c", CODE], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "ready\n"
    os.kill(process.pid, number)
    rest, _ = process.communicate(timeout=30.0)
    assert rest == "cleared away\n"
    assert process.returncode == 0
