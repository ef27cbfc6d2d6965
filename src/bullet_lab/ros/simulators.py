"""Which nodes of a ROS graph are alive, and whether one of them gives the time already."""

from __future__ import annotations

import xmlrpc.client

import rosgraph

from bullet_lab.ros.node import NodeError

CALLER = "/bullet_lab"


def answers(node: str) -> bool:
    """Return whether a node is registered with the master and alive."""
    master = rosgraph.Master(CALLER)
    try:
        with xmlrpc.client.ServerProxy(master.lookupNode(node)) as proxy:
            proxy.getPid(CALLER)
    except (rosgraph.MasterException, OSError, xmlrpc.client.Error):
        return False
    return True


def refuse_second_simulator() -> None:
    """Make sure that nobody else gives the time.

    Raises:
        NodeError: a living node publishes /clock already.
    """
    publishers, _, _ = rosgraph.Master(CALLER).getSystemState()
    for topic, nodes in publishers:
        for node in nodes if topic == "/clock" else ():
            if answers(node):
                raise NodeError(
                    f"{node} publishes /clock already: one simulator is enough for a ROS master"
                )
