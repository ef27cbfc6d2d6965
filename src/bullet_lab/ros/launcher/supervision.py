"""A run of a launch file: its ROS master, its nodes, and how it ended."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import xmlrpc.client
from pathlib import Path
from typing import Callable, NamedTuple
from urllib.parse import urlsplit

import rosgraph.names
import roslaunch
import roslaunch.config
import roslaunch.parent
import roslaunch.pmon
import roslib
import rosmaster.master
import rospkg
from roslaunch.core import Master

from bullet_lab.entry import JOB
from bullet_lab.errors import LabError
from bullet_lab.jobs.declaration import Job
from bullet_lab.ros.launcher.output import tied
from bullet_lab.ros.node.node import MASTER_ERRORS

_SIGINT_TIMEOUT = 6.0
_SIGTERM_TIMEOUT = 2.0
# The setup files of ROS set this in every shell: it does not mean that the user chose it.
STOCK_URI = "http://localhost:11311"
_CONNECT_TIMEOUT = 2.0



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
    except (*MASTER_ERRORS, OSError):
        return False


def _answers(uri: str) -> bool:
    try:
        address = urlsplit(uri)
        # roslaunch's own check may take a minute.
        socket.create_connection((address.hostname, address.port), _CONNECT_TIMEOUT).close()
    except (OSError, ValueError, TypeError):
        return False
    return Master(uri=uri).is_running()


class Death(NamedTuple):
    """The end of a node; a negative status is the negated number of the signal that killed it."""

    process: str
    status: int


class Verdict(NamedTuple):
    """The exit status of a run, and the reason if it is not 0."""

    status: int
    reason: str = ""


def judge(
    deaths: list[Death],
    names: dict[str, str],
    required: set[str],
    has_summary: bool,
    stopped_by: int | None,
) -> Verdict | None:
    """Return how a run has ended; None while it goes on.

    Args:
        deaths: the ends of nodes, in order.
        names: names of the nodes by those of their processes.
        required: names of the nodes whose end is the end of the job.
        has_summary: whether the summary has been written.
        stopped_by: number of the signal that asks to stop, if any.
    """
    for death in deaths:
        name = names.get(death.process, death.process)
        if death.status < 0:
            return Verdict(128 - death.status, f"{name} was killed by signal {-death.status}")
        if death.status:
            return Verdict(death.status, f"{name} ended with status {death.status}")
        if name in required:
            if has_summary:
                return Verdict(0)
            return Verdict(1, f"{name} ended before there was a summary")
    if stopped_by is not None:
        return Verdict(128 + stopped_by, f"stopped by {signal.Signals(stopped_by).name}")
    if len(deaths) >= len(names):
        return Verdict(1, "all nodes have ended and there is no summary")
    return None


class Deaths(roslaunch.pmon.ProcessListener):
    """Collects the ends of nodes in order, from roslaunch's monitor thread."""

    def __init__(self):
        self.list: list[Death] = []

    def process_died(self, process_name, exit_code):
        """Add the end of a node; called by roslaunch."""
        self.list.append(Death(process_name, 1 if exit_code is None else exit_code))


class Launch:
    """The running nodes of a launch file; leaving the context stops them."""

    def __init__(self, job: Job, values: dict[str, str], master: RunMaster):
        self._config = _load(job.path, values)
        self.required = {node.name for node in self._config.nodes if node.required}
        # At the end of a required node, roslaunch would shut down, and lose track of nodes
        # that it is about to start.
        for node in self._config.nodes:
            node.required = False
            node.launch_prefix = " ".join(tied(node.launch_prefix or "")).strip()
        self._deaths = Deaths()
        self._groups: list[int] = []
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
            self._start()
        except roslaunch.RLException as error:
            self.__exit__()
            raise LabError(_one_line(error)) from error
        return self

    def _start(self) -> None:
        self._parent.config = self._config
        # A listener that is given to ROSLaunchParent would miss nodes that end at once.
        self._parent.pm = roslaunch.pmon.start_process_monitor()
        self._parent.pm.add_process_listener(self._deaths)
        self._parent.start(auto_terminate=False)
        self._groups = [process.pid for process in self._parent.pm.procs if process.pid > 0]
        failed = [node.name for node in self._config.nodes if not node.process_name]
        if failed:
            raise roslaunch.RLException(f"cannot start the nodes {', '.join(failed)}")

    def __exit__(self, *_) -> None:
        """Stop all nodes: by SIGINT, then SIGTERM, then SIGKILL.

        Nodes that have not registered yet get SIGTERM at once: they may still be importing
        modules, and Python would answer SIGINT with a traceback.
        """
        names = {node.process_name: node for node in self._config.nodes}
        alive = list(self._parent.pm.procs) if self._parent.pm else []
        self._end_orphans({process.pid for process in alive})
        for process in alive:
            if process.name in names and not self._is_registered(names[process.name]):
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    if process.pid > 0 and process.is_alive():
                        os.kill(process.pid, signal.SIGTERM)
        self._parent.shutdown()

    def _end_orphans(self, alive: set[int]) -> None:
        """Kill the children of dead nodes: roslaunch starts each node in a process group."""
        for group in set(self._groups) - alive:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(group, signal.SIGKILL)

    def _is_registered(self, node) -> bool:
        name = rosgraph.names.ns_join(node.namespace, node.name)
        try:
            code, _, _ = self._config.master.get().lookupNode("/roslaunch", name)
        except (OSError, xmlrpc.client.Error):
            return False
        return code == 1

    def verdict(self, has_summary: Callable[[], bool], stopped_by: int | None) -> Verdict | None:
        """Return how the job has ended; None while it runs. See `judge`."""
        names = {node.process_name: node.name for node in self._config.nodes}
        # Read before the summary is looked for, which a node writes before it ends.
        deaths = list(self._deaths.list)
        return judge(deaths, names, self.required, has_summary(), stopped_by)


def _load(path: Path, values: dict[str, str]) -> roslaunch.config.ROSLaunchConfig:
    # roslaunch ignores a word with a second ':='.
    words = [f"{name}:={value.replace(':=', '=')}" for name, value in values.items()]
    # Signals wait: Ctrl-C would end programs that roslaunch runs for values, with tracebacks.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGHUP))
    try:
        with _as_supervision_error():
            return roslaunch.config.load_config_default([(str(path), words)], None)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def resolved_defaults(path: Path) -> dict[str, str]:
    """Return the resolved defaults of a launch file's arguments; raise LabError."""
    import roslaunch.arg_dump

    with _as_supervision_error():
        args = roslaunch.arg_dump.get_args([str(path)])
    return {name: str(default) for name, (_, default) in args.items() if default is not None}


@contextlib.contextmanager
def _as_supervision_error():
    try:
        yield
    except (roslaunch.RLException, rospkg.ResourceNotFound) as error:
        raise LabError(_one_line(error)) from error


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
