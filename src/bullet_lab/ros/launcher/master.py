"""The ROS master of a run: the one that the user names, or one of its own."""

from __future__ import annotations

import os
import socket
from dataclasses import dataclass
from urllib.parse import urlsplit

import rosmaster.master
from roslaunch.core import Master

from bullet_lab.errors import LabError

# What the setup files of ROS put into every shell, so that it says nothing by itself.
STOCK_URI = "http://localhost:11311"
_CONNECT_TIMEOUT = 2.0


class MasterError(LabError):
    """The master that the environment names is of no use."""


@dataclass(frozen=True)
class RunMaster:
    """A running master: its URI, the run id that nodes log under, and whether it is ours."""

    uri: str
    run_id: str
    own: bool


def prepare_master() -> RunMaster:
    """Find the master that ROS_MASTER_URI names, or start one in this process.

    A master of our own listens on a free port of the loopback, and so do the nodes; it
    ends with this process. The environment is set for all that is started later.

    Raises:
        MasterError: the variable is set to something other than the stock value of ROS's
            setup files, and no master answers there.
    """
    uri = os.environ.get("ROS_MASTER_URI", "").strip()
    if uri and _answers(uri):
        return RunMaster(uri, _run_id(uri), own=False)
    if uri and uri.rstrip("/") != STOCK_URI:
        raise MasterError(f"no ROS master answers at ROS_MASTER_URI={uri}")
    return _start_master()


def _answers(uri: str) -> bool:
    try:
        address = urlsplit(uri)
        # Quickly, where roslaunch's own check may take a minute.
        socket.create_connection((address.hostname, address.port), _CONNECT_TIMEOUT).close()
    except (OSError, ValueError, TypeError):
        return False
    return Master(uri=uri).is_running()


def _run_id(uri: str) -> str:
    """The id that the master's first launch gave it; roslaunch insists on the same."""
    code, _, run_id = Master(uri=uri).get().getParam("/roslaunch", "/run_id")
    return str(run_id) if code == 1 else "nodes"


def _start_master() -> RunMaster:
    # roslaunch prefers ROS_HOSTNAME, which would open the master to the network.
    os.environ.pop("ROS_HOSTNAME", None)
    os.environ.pop("ROS_IPV6", None)
    os.environ["ROS_IP"] = "127.0.0.1"
    master = rosmaster.master.Master(port=0)
    master.start()
    os.environ["ROS_MASTER_URI"] = master.uri
    return RunMaster(master.uri, "nodes", own=True)
