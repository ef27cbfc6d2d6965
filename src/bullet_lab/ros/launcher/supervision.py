"""A run of a launch file: its ROS master, its nodes, and how it ended."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import xmlrpc.client
from http.client import HTTPException
from pathlib import Path
from types import SimpleNamespace
from typing import Callable, Iterable, Mapping, NamedTuple
from urllib.parse import urlsplit

# On Debian 12, rosclean, which roslaunch imports, would import all of setuptools for distutils.
with contextlib.suppress(ImportError):
    if sys.version_info < (3, 12):
        import _distutils_hack

        _distutils_hack.remove_shim()

import rosgraph.names
import roslaunch
import roslaunch.config
import roslaunch.nodeprocess
import roslaunch.parent
import roslib
import rosmaster.master
import rospkg
from roslaunch.core import Master

from bullet_lab.entry import JOB
from bullet_lab.errors import LabError
from bullet_lab.jobs.declaration import Job
from bullet_lab.ros.launcher.node_server import NodeProcess, NodeServer, Request
from bullet_lab.ros.launcher.output import tied

_SIGINT_TIMEOUT = 6.0
_SIGTERM_TIMEOUT = 2.0
# The setup files of ROS set this in every shell: it does not mean that the user chose it.
STOCK_URI = "http://localhost:11311"
_CONNECT_TIMEOUT = 2.0
_PACKAGE_FOLDER = "/lib/bullet_lab"
_NAME = "__name:="


class RunMaster(NamedTuple):
    """A running master: its URI, the run id of its logs, and whether this process started it."""

    uri: str
    run_id: str
    own: bool


def prepare_master() -> RunMaster:
    """Find the master that ROS_MASTER_URI names, or start one in this process.

    The master that is started here listens on a free port of the loopback, as the nodes do, and
    ends with this process. The environment is set for all processes that are started later.

    Raises:
        LabError: the variable has another value than STOCK_URI, and no master answers.
    """
    uri = os.environ.get("ROS_MASTER_URI", "").strip()
    is_stock = uri.rstrip("/") == STOCK_URI
    # A value from the setup files does not ask to join another user's nodes.
    if uri and _answers(uri) and not (is_stock and is_of_another_user(uri)):
        # Set by the first launch on this master; roslaunch refuses any other.
        code, _, run_id = Master(uri=uri).get().getParam("/roslaunch", "/run_id")
        return RunMaster(uri, str(run_id) if code == 1 else "nodes", own=False)
    if uri and not is_stock:
        raise LabError(f"no ROS master answers at ROS_MASTER_URI={uri}")
    # roslaunch prefers ROS_HOSTNAME, which would open the master to the network.
    os.environ.pop("ROS_HOSTNAME", None)
    os.environ.pop("ROS_IPV6", None)
    os.environ["ROS_IP"] = "127.0.0.1"
    master = rosmaster.master.Master(port=0)
    master.start()
    os.environ["ROS_MASTER_URI"] = master.uri
    return RunMaster(master.uri, "nodes", own=True)


def is_of_another_user(uri: str) -> bool:
    """Return whether the master that answers on this machine runs as another user."""
    try:
        _, _, process = Master(uri=uri).get().getPid("/run")
        return Path(f"/proc/{process}").stat().st_uid != os.getuid()
    except (OSError, HTTPException, xmlrpc.client.Error):
        return False


def _answers(uri: str) -> bool:
    try:
        address = urlsplit(uri)
        # roslaunch's own check may take a minute.
        socket.create_connection((address.hostname, address.port), _CONNECT_TIMEOUT).close()
    except (OSError, ValueError, TypeError):
        return False
    return Master(uri=uri).is_running()


class Verdict(NamedTuple):
    """The exit status of a run, and the reason if it is not 0."""

    status: int
    reason: str = ""


def judge(
    deaths: Mapping[str, int],
    count: int,
    required: set[str],
    has_summary: bool,
    stopped_by: int | None,
) -> Verdict | None:
    """Return how a run has ended; None while it goes on.

    Args:
        deaths: the exit statuses of nodes that have ended, in order; -n after a signal n.
        count: number of nodes.
        required: names of the nodes whose end is the end of the job.
        has_summary: whether the summary has been written.
        stopped_by: number of the signal that asks to stop, if any.
    """
    for full_name, status in deaths.items():
        node = full_name.rsplit("/", 1)[-1]
        if status < 0:
            return Verdict(128 - status, f"{node} was killed by signal {-status}")
        if status:
            return Verdict(status, f"{node} ended with status {status}")
        if node in required:
            if has_summary:
                return Verdict(0)
            return Verdict(1, f"{node} ended before there was a summary")
    if stopped_by is not None:
        return Verdict(128 + stopped_by, f"stopped by {signal.Signals(stopped_by).name}")
    if len(deaths) >= count:
        return Verdict(1, "all nodes have ended and there is no summary")
    return None


class Launch:
    """The running nodes of a launch file; leaving the context stops them.

    With a `server`, the nodes of this package are its forks.
    """

    def __init__(
        self,
        job: Job,
        values: dict[str, str],
        master: RunMaster,
        server: NodeServer | None = None,
    ):
        self._server = server
        self._config = _load(job.path, values)
        self._required = {node.name for node in self._config.nodes if node.required}
        self._others = others_than_writers(self._config)
        # At the end of a required node, roslaunch would shut down, and lose track of nodes
        # that it is about to start.
        for node in self._config.nodes:
            node.required = False
        self._deaths: dict[str, int] = {}
        self._is_ending = False
        self._processes: dict[str, subprocess.Popen | NodeProcess] = {}
        self._parent = roslaunch.parent.ROSLaunchParent(
            master.run_id,
            [str(job.path)],
            show_summary=False,
            sigint_timeout=_SIGINT_TIMEOUT,
            sigterm_timeout=_SIGTERM_TIMEOUT,
        )

    def __enter__(self) -> Launch:
        """Start the nodes; raise LabError if one of them cannot be started."""
        # Nodes that are ended early report that by their status.
        os.environ[JOB] = "1"
        # roslib keeps the signal handlers of interactive programs.
        roslib.set_interactive(True)
        try:
            with _as_lab_error():
                self._start()
        except LabError:
            self.__exit__()
            raise
        return self

    def _start_process(self, words: list[str], **options) -> subprocess.Popen | NodeProcess:
        """Start a node; roslaunch calls this function as if it were `subprocess.Popen`."""
        process = self._fork(words, options) or subprocess.Popen(tied(*words), **options)
        name = next(word[len(_NAME) :] for word in words if word.startswith(_NAME))
        namespace = options["env"].get("ROS_NAMESPACE", "/")
        self._processes[rosgraph.names.ns_join(namespace, name)] = process
        return process

    def _fork(self, words: list[str], options: dict) -> NodeProcess | None:
        """Start a node of this package by the server of nodes; None if that is not possible."""
        own = {name for name, _ in options["env"].items() - os.environ.items()}
        is_of_package = os.path.dirname(words[0]).endswith(_PACKAGE_FOLDER)
        if not (self._server and is_of_package and all(name[:4] == "ROS_" for name in own)):
            return None
        output = options["stdout"] or sys.__stdout__
        with contextlib.suppress(OSError, EOFError):
            request = Request(words, options["cwd"], options["env"])
            return self._server.start(request, output.fileno())
        return None

    def _start(self) -> None:
        roslaunch.nodeprocess.subprocess = SimpleNamespace(
            Popen=self._start_process, PIPE=subprocess.PIPE
        )
        self._parent.config = self._config
        self._parent.start(auto_terminate=False)
        failed = [node.name for node in self._config.nodes if not node.process_name]
        if failed:
            raise roslaunch.RLException(f"cannot start the nodes {', '.join(failed)}")

    def __exit__(self, *_) -> None:
        """Stop all nodes: by SIGINT, then SIGTERM, then SIGKILL.

        Nodes that have not registered yet get SIGTERM at once: they may still be importing
        modules, and Python would answer SIGINT with a traceback.
        """
        if self._parent.pm:
            # From now on, roslaunch starts no node again, and reports no end.
            self._parent.pm.shutdown()
        self._end(self._processes)
        self._parent.shutdown()

    def end_others(self) -> None:
        """End the nodes that do not write the results, which are complete, unless it was done."""
        if not self._is_ending:
            self._is_ending = True
            self._end(self._others & self._processes.keys())

    def _end(self, names: Iterable[str]) -> None:
        for name in names:
            process = self._processes[name]
            if process.poll() is not None:
                # roslaunch starts each node in a process group: its children may still run.
                number = signal.SIGKILL
            else:
                number = signal.SIGINT if self._is_registered(name) else signal.SIGTERM
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, number)

    def _is_registered(self, name: str) -> bool:
        try:
            code, _, _ = self._config.master.get().lookupNode("/roslaunch", name)
        except (OSError, xmlrpc.client.Error):
            return False
        return code == 1

    def verdict(self, has_summary: Callable[[], bool], stopped_by: int | None) -> Verdict | None:
        """Return how the job has ended; None while it runs. See `judge`."""
        # Before the summary is looked for, which a node writes before it ends.
        for name, process in self._processes.items():
            status = process.poll()
            if status is not None and not (self._is_ending and name in self._others):
                self._deaths.setdefault(name, status)
        count = len(self._config.nodes)
        return judge(self._deaths, count, self._required, has_summary(), stopped_by)


def others_than_writers(config: roslaunch.config.ROSLaunchConfig) -> set[str]:
    """Return the nodes that end when the results are complete; none if nobody is told to write."""
    nodes = {rosgraph.names.ns_join(node.namespace, node.name): node for node in config.nodes}
    told = {name for name in nodes if f"{name}/out" in config.params}
    writers = {name for name in told if nodes[name].required}
    return {name for name, node in nodes.items() if writers and not node.respawn} - writers


class _Loader(roslaunch.xmlloader.XmlLoader):
    """Reads launch files, but sets the parameters of roscore.xml without its two programs."""

    def load(self, filename, ros_config, core=False, **options):
        """Read a launch file; called by roslaunch."""
        if not core:
            super().load(filename, ros_config, core=core, **options)
            return
        version = rospkg.RosPack().get_manifest("roslaunch").version
        distro = os.environ.get("ROS_DISTRO", "Debian")
        for name, value in {"/rosversion": version, "/rosdistro": distro}.items():
            ros_config.add_param(roslaunch.core.Param(name, f"{value}\n"))


def _load(path: Path, values: dict[str, str]) -> roslaunch.config.ROSLaunchConfig:
    # roslaunch ignores a word with a second ':='.
    words = [f"{name}:={value.replace(':=', '=')}" for name, value in values.items()]
    # Signals wait: Ctrl-C would end programs that roslaunch runs for values, with tracebacks.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGHUP))
    try:
        with _as_lab_error():
            files = [(str(path), words)]
            return roslaunch.config.load_config_default(files, None, loader=_Loader())
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def resolved_defaults(path: Path) -> dict[str, str]:
    """Return the resolved defaults of a launch file's arguments; raise LabError."""
    import roslaunch.arg_dump

    with _as_lab_error():
        args = roslaunch.arg_dump.get_args([str(path)])
    return {name: str(default) for name, (_, default) in args.items() if default is not None}


@contextlib.contextmanager
def _as_lab_error():
    try:
        yield
    except (roslaunch.RLException, rospkg.ResourceNotFound) as error:
        raise LabError(" ".join(str(error).split())) from error
