"""Nodes that are forked look like started programs: parent, command line, folder, exit status."""

import ctypes
import json
import os
import signal

import pytest

from bullet_lab.entry import PR_SET_CHILD_SUBREAPER
from bullet_lab.ros.launcher.node_server import NodeServer, Request

PROGRAM = """\
import json, os, signal, sys
import rospy
mask, handler = signal.pthread_sigmask(signal.SIG_BLOCK, ()), signal.getsignal(signal.SIGINT)
print(json.dumps({
    "argv": sys.argv, "path": sys.path[0], "folder": os.getcwd(), "parent": os.getppid(),
    "leads": os.getsid(0) == os.getpgid(0) == os.getpid(), "mark": os.environ["MARK"],
    "namespace": rospy.get_namespace(), "mapped": dict(rospy.names.get_mappings()),
    "signals": [len(mask), handler.__name__],
    "command": open("/proc/self/cmdline").read().rstrip("\\0").split("\\0"),
    "open": sorted(map(int, os.listdir("/proc/self/fd")))[:-1],
}), flush=True)
if sys.argv[1] == "wait":
    signal.pause()
sys.exit(7)
"""


@pytest.fixture(scope="module")
def server():
    with NodeServer() as server:
        yield server
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 0)


def start(server, folder, *words):
    """Start the program in a folder; return it and its output."""
    program = folder / "program.py"
    program.write_text(PROGRAM)
    environment = {**os.environ, "MARK": "set", "ROS_NAMESPACE": "/robot"}
    with (folder / "out").open("w") as output:
        request = Request([str(program), *words], str(folder), environment)
        process = server.start(request, output.fileno())
    return process, folder / "out"


def finished(process):
    """The status of a process, when it has ended."""
    while process.poll() is None:
        os.sched_yield()
    return process.poll()


def test_a_forked_node_is_like_a_started_one(server, tmp_path):
    words = ["end", "a:=b", "__name:=node"]
    process, output = start(server, tmp_path, *words)
    assert finished(process) == 7
    said = json.loads(output.read_text())
    program = str(tmp_path / "program.py")
    assert said["argv"] == [program, *words]
    assert said["command"][1:] == [program, *words]
    assert (said["path"], said["folder"]) == (str(tmp_path), str(tmp_path))
    assert (said["parent"], said["leads"], said["mark"]) == (os.getpid(), True, "set")
    assert (said["namespace"], said["mapped"]) == ("/robot/", {"a": "b", "__name": "node"})
    # Until `entry.run` has imported the node.
    assert said["signals"] == [0, "_end_at_once"]
    assert said["open"] == [0, 1, 2]


def test_a_node_that_a_signal_kills_says_so(server, tmp_path):
    process, output = start(server, tmp_path, "wait")
    while not output.read_text().endswith("\n"):
        os.sched_yield()
    os.killpg(process.pid, signal.SIGKILL)
    assert finished(process) == -signal.SIGKILL


def test_a_server_that_has_died_is_an_error():
    with NodeServer() as server:
        server._process.kill()
        server._process.wait()
        with pytest.raises((OSError, EOFError)):
            server.start(Request(["x"], "/", {}), 1)
