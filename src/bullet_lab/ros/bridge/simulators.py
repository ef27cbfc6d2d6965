"""Which nodes of a ROS graph are alive, and whether one of them gives the time already."""

from __future__ import annotations

import xmlrpc.client

import rosgraph

from bullet_lab.ros.node.node import NodeError

CALLER = "/bullet_lab"
# Wall seconds that a node may take to say that it is there.
ANSWER_SECONDS = 5.0


class _Transport(xmlrpc.client.Transport):
    """Does not wait for ever for a node that hangs."""

    def make_connection(self, host):
        connection = super().make_connection(host)
        connection.timeout = ANSWER_SECONDS
        return connection


def answers(node: str) -> bool:
    """Return whether a node is registered with the master and alive."""
    master = rosgraph.Master(CALLER)
    try:
        uri = master.lookupNode(node)
        with xmlrpc.client.ServerProxy(uri, transport=_Transport()) as proxy:
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
