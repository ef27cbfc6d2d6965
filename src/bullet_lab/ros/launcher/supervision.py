"""A run of a launch file: its master, its nodes, and how it went."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import time
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
from bullet_lab.ros.launcher.jobs import Job
from bullet_lab.ros.launcher.output import tied
from bullet_lab.ros.node.node import MASTER_ERRORS

_POLL_PERIOD = 0.05
_SIGINT_TIMEOUT = 6.0
_SIGTERM_TIMEOUT = 2.0
# What the setup files of ROS put into every shell, so that it says nothing by itself.
STOCK_URI = "http://localhost:11311"
_CONNECT_TIMEOUT = 2.0


class SupervisionError(LabError):
    """The launch file cannot be run, or the master that the environment names is of no use."""


class RunMaster(NamedTuple):
    """A running master: its URI, the run id that nodes log under, and whether it is ours."""

    uri: str
    run_id: str
    own: bool


def prepare_master() -> RunMaster:
    """Find the master that ROS_MASTER_URI names, or start one in this process.

    A master of our own listens on a free port of the loopback, and so do the nodes; it
    ends with this process. The environment is set for all that is started later.

    Raises:
        SupervisionError: the variable is set to something other than the stock value of ROS's
            setup files, and no master answers there.
    """
    uri = os.environ.get("ROS_MASTER_URI", "").strip()
    is_stock = uri.rstrip("/") == STOCK_URI
    # What ROS's setup files set by themselves is no wish to join another user's nodes.
    if uri and _answers(uri) and not (is_stock and is_of_another_user(uri)):
        # The id that the master's first launch gave it; roslaunch insists on the same.
        code, _, run_id = Master(uri=uri).get().getParam("/roslaunch", "/run_id")
        return RunMaster(uri, str(run_id) if code == 1 else "nodes", own=False)
    if uri and not is_stock:
        raise SupervisionError(f"no ROS master answers at ROS_MASTER_URI={uri}")
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
        # Quickly, where roslaunch's own check may take a minute.
        socket.create_connection((address.hostname, address.port), _CONNECT_TIMEOUT).close()
    except (OSError, ValueError, TypeError):
        return False
    return Master(uri=uri).is_running()


class Death(NamedTuple):
    """The end of a node; a negative status is the number of the signal that killed it."""

    process: str
    status: int


class Verdict(NamedTuple):
    """The exit status of a run, and in one line why, when it is not 0."""

    status: int
    reason: str = ""


def judge(
    deaths: list[Death],
    names: dict[str, str],
    required: set[str],
    has_summary: bool,
    stopped_by: int | None,
) -> Verdict | None:
    """What has become of a run so far, None while it goes on.

    `names` are those of the nodes by their processes, `required` those whose end is that of the
    job; deaths are in order.
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
    """Collects the ends of nodes in their order, from roslaunch's monitor thread."""

    def __init__(self):
        self.list: list[Death] = []

    def process_died(self, process_name, exit_code):
        """Note the end of a node; called by roslaunch."""
        self.list.append(Death(process_name, 1 if exit_code is None else exit_code))


class Launch:
    """A launch file whose nodes have been started; all of them are stopped at the end."""

    def __init__(self, job: Job, values: dict[str, str], master: RunMaster):
        self._config = _load(job.path, values)
        self.required = {node.name for node in self._config.nodes if node.required}
        # roslaunch would tear down by itself at the end of a required node, and lose
        # track of nodes that it is about to start.
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
        """Start the nodes; raise SupervisionError if one of them cannot be started."""
        # What is ended early by somebody else says so by its status: others may wait for it.
        os.environ[JOB] = "1"
        # Interactive programs keep their signal handlers.
        roslib.set_interactive(True)
        try:
            self._start()
        except roslaunch.RLException as error:
            self.__exit__()
            raise SupervisionError(_one_line(error)) from error
        return self

    def _start(self) -> None:
        self._parent.config = self._config
        # The listener that ROSLaunchParent takes would miss nodes that end at once.
        self._parent.pm = roslaunch.pmon.start_process_monitor()
        self._parent.pm.add_process_listener(self._deaths)
        self._parent.start(auto_terminate=False)
        self._groups = [process.pid for process in self._parent.pm.procs if process.pid > 0]
        failed = [node.name for node in self._config.nodes if not node.process_name]
        if failed:
            raise roslaunch.RLException(f"cannot start {', '.join(failed)}")

    def __exit__(self, *_) -> None:
        """Stop all nodes: by SIGINT, then SIGTERM, then SIGKILL.

        Nodes that the master does not know yet are ended by SIGTERM at once: they may still be
        importing, where Python answers SIGINT with a traceback.
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
        """End what nodes that were killed have started: roslaunch made each a group of its own."""
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

    def wait(
        self,
        has_summary: Callable[[], bool],
        stopped_by: Callable[[], int | None],
        meanwhile: Callable[[], None],
    ) -> Verdict:
        """Wait for the end of the job, calling `meanwhile` again and again; see `judge`."""
        names = {node.process_name: node.name for node in self._config.nodes}
        while True:
            deaths = list(self._deaths.list)
            verdict = judge(deaths, names, self.required, has_summary(), stopped_by())
            if verdict is not None:
                return verdict
            meanwhile()
            time.sleep(_POLL_PERIOD)


def _load(path: Path, values: dict[str, str]) -> roslaunch.config.ROSLaunchConfig:
    # roslaunch passes over a word that it could cut in more than two.
    words = [f"{name}:={value.replace(':=', '=')}" for name, value in values.items()]
    # Signals wait: programs that roslaunch asks for values would die of Ctrl-C, loudly.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGHUP))
    try:
        with _as_supervision_error():
            return roslaunch.config.load_config_default([(str(path), words)], None)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def resolved_defaults(path: Path) -> dict[str, str]:
    """The defaults of a launch file's arguments, resolved; raises SupervisionError."""
    import roslaunch.arg_dump

    with _as_supervision_error():
        args = roslaunch.arg_dump.get_args([str(path)])
    return {name: str(default) for name, (_, default) in args.items() if default is not None}


@contextlib.contextmanager
def _as_supervision_error():
    try:
        yield
    except (roslaunch.RLException, rospkg.ResourceNotFound) as error:
        raise SupervisionError(_one_line(error)) from error


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
