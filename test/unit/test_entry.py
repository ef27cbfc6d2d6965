"""Ctrl-C while a program imports its modules, whatever these make of it."""

import subprocess
import sys

import pytest
from rosgraph.network import get_bind_address

from bullet_lab.entry import keep_to_this_machine

INTERRUPT = "import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n"
SWALLOWED = f"try:\n    exec({INTERRUPT!r})\nexcept KeyboardInterrupt:\n    pass\n"
MAIN = "def main():\n    print('started')\n"


@pytest.mark.parametrize("imported", [SWALLOWED, f"exec({INTERRUPT!r})\n"])
def test_an_interrupted_import_ends_it_with_130(tmp_path, imported):
    (tmp_path / "slow.py").write_text(imported + MAIN)
    (tmp_path / "program.py").write_text("from bullet_lab.entry import run\nrun('slow')\n")
    run = subprocess.run(
        [sys.executable, "-m", "program"], cwd=tmp_path, capture_output=True, text=True
    )
    assert (run.returncode, run.stdout, run.stderr) == (130, "", "")


def test_an_interrupt_that_was_held_back_while_python_started_is_answered(tmp_path):
    block = "signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})"
    program = (
        f"import os, signal\n{block}\n{INTERRUPT}from bullet_lab.entry import run\nrun('os')\n"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (run.returncode, run.stdout, run.stderr) == (130, "", "")


def test_main_gets_the_interrupt_again(tmp_path):
    (tmp_path / "job.py").write_text(
        f"def main():\n    try:\n        exec({INTERRUPT!r})\n"
        "    except KeyboardInterrupt:\n        print('in order')\n"
    )
    (tmp_path / "program.py").write_text("from bullet_lab.entry import run\nrun('job')\n")
    run = subprocess.run(
        [sys.executable, "-m", "program"], cwd=tmp_path, capture_output=True, text=True
    )
    assert run.stdout == "in order\n", run.stderr


@pytest.mark.parametrize(
    ("given", "address"),
    [
        ({}, "127.0.0.1"),
        ({"ROS_MASTER_URI": "http://127.0.0.1:4", "ROS_IP": ""}, "127.0.0.1"),
        ({"ROS_MASTER_URI": "nonsense"}, "127.0.0.1"),
        ({"ROS_MASTER_URI": "http://robot:11311"}, "0.0.0.0"),
        ({"ROS_MASTER_URI": "http://localhost:11311", "ROS_IP": "192.168.1.2"}, "0.0.0.0"),
        ({"ROS_HOSTNAME": "robot"}, "0.0.0.0"),
    ],
)
def test_nodes_listen_on_the_loopback_unless_they_are_opened(monkeypatch, given, address):
    for name in ("ROS_MASTER_URI", "ROS_IP", "ROS_HOSTNAME", "ROS_IPV6"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.argv", ["node"])
    # Set and taken back: what the function itself sets goes with it.
    monkeypatch.setenv("ROS_HOSTNAME", "")
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    keep_to_this_machine()
    assert get_bind_address() == address


LARGE_AMONG_SMALL = """
def megabytes():
    return int(open("/proc/self/statm").read().split()[1]) * 4 // 1024

# Where it is not told otherwise, glibc takes these sizes for small from here on.
del bytearray(16 * 2**20)[:]
before, small, large = megabytes(), [], []
for _ in range(6):
    large.append(bytearray(b"1") * (16 * 2**20))
    small.append(bytearray(100_000))
large.clear()
print(megabytes() - before)
"""
FREE_AMONG_WHAT_IS_USED = """
from bullet_lab.entry import trim_memory

def megabytes():
    return int(open("/proc/self/statm").read().split()[1]) * 4 // 1024

pictures, small = [], []
for _ in range(50):
    pictures.append(bytearray(b"1") * 900_000)
    small.append(bytearray(20_000))
before = megabytes()
pictures.clear()
trim_memory()
print(before - megabytes())
"""
HEAPS = """
import ctypes, threading
libc = ctypes.CDLL(None)
libc.fdopen.restype = ctypes.c_void_p
barrier = threading.Barrier(5)

def take():
    kept = bytearray(10_000)
    barrier.wait()

for _ in range(4):
    threading.Thread(target=take).start()
barrier.wait()
out = ctypes.c_void_p(libc.fdopen(1, b"w"))
libc.malloc_info(0, out)
libc.fflush(out)
"""


def printed_with_memory_given_back(program):
    code = f"from bullet_lab.entry import give_memory_back\ngive_memory_back()\n{program}"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return run.stdout


def test_large_buffers_are_given_back_whatever_small_ones_stay():
    assert int(printed_with_memory_given_back(LARGE_AMONG_SMALL)) < 16


def test_what_is_free_among_what_is_used_is_given_back():
    assert int(printed_with_memory_given_back(FREE_AMONG_WHAT_IS_USED)) > 20


def test_threads_have_no_heaps_of_their_own():
    assert printed_with_memory_given_back(HEAPS).count("<heap nr=") == 1
