"""Ctrl-C while a program imports its modules, whatever these make of it."""

import textwrap

import pytest
from rosgraph.network import get_bind_address
from shared import cases, python

from bullet_lab.entry import keep_to_this_machine

IMPORTS = "import os, signal\n"
INTERRUPT = f"{IMPORTS}os.kill(os.getpid(), signal.SIGINT)\n"
CAUGHT = f"""
{IMPORTS}
try:
    os.kill(os.getpid(), signal.SIGINT)
except KeyboardInterrupt:
    print("caught")
"""
RUN = "from bullet_lab.entry import run\nrun('job')\n"
HELD_BACK = f"{IMPORTS}signal.pthread_sigmask(signal.SIG_BLOCK, {{signal.SIGINT}})\n"
MAIN = "def main():\n    print('started')\n"


@pytest.mark.parametrize(
    ("program", "job", "end"),
    [
        (RUN, INTERRUPT + MAIN, (130, "", "")),
        (RUN, CAUGHT + MAIN, (130, "", "")),
        # From before Python had started.
        (HELD_BACK + INTERRUPT + RUN, MAIN, (130, "", "")),
        # main gets it again.
        (RUN, f"def main():\n{textwrap.indent(CAUGHT, '    ')}", (0, "caught\n", "")),
    ],
)
def test_an_interrupt_ends_a_program_that_imports(tmp_path, program, job, end):
    (tmp_path / "job.py").write_text(job)
    assert python(program, cwd=tmp_path) == end


@cases("""
given, address:
  - [{}, 127.0.0.1]
  - [{ROS_MASTER_URI: "http://127.0.0.1:4", ROS_IP: ""}, 127.0.0.1]
  - [{ROS_MASTER_URI: nonsense}, 127.0.0.1]
  - [{ROS_MASTER_URI: "http://robot:11311"}, 0.0.0.0]
  - [{ROS_MASTER_URI: "http://localhost:11311", ROS_IP: 192.168.1.2}, 0.0.0.0]
  - [{ROS_HOSTNAME: robot}, 0.0.0.0]
""")
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


MEGABYTES = """
def megabytes():
    return int(open("/proc/self/statm").read().split()[1]) * 4 // 1024
"""
LARGE_AMONG_SMALL = """
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
    begin = "from bullet_lab.entry import give_memory_back\ngive_memory_back()\n"
    status, printed, errors = python(begin + MEGABYTES + program)
    assert status == 0, errors
    return printed


def test_memory_is_given_back():
    # Large buffers, whatever small ones stay.
    assert int(printed_with_memory_given_back(LARGE_AMONG_SMALL)) < 16
    # What is free among what is used.
    assert int(printed_with_memory_given_back(FREE_AMONG_WHAT_IS_USED)) > 20
    # Threads have no heaps of their own.
    assert printed_with_memory_given_back(HEAPS).count("<heap nr=") == 1
