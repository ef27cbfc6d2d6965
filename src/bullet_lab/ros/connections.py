"""Whether a node really gets what is published, which rospy's own counts do not tell."""

from __future__ import annotations

import xmlrpc.client
from collections import defaultdict
from typing import Dict, Set

import rospy

# Where the slave API's getBusInfo has what.
DESTINATION, DIRECTION, TOPIC = 1, 2, 4
INBOUND, OUTBOUND = "i", "o"


def publishers_know_this_node() -> bool:
    """Return whether the publishers of all that this node listens to have it on their lists.

    A rospy subscriber counts a connection as soon as it begins to make it. What is published
    before the publisher has noted it never comes.
    """
    wanted: Dict[str, Set[str]] = defaultdict(set)
    for entry in _connections(rospy.get_node_uri()):
        if entry[DIRECTION] == INBOUND:
            wanted[entry[DESTINATION]].add(entry[TOPIC])
    return all(topics <= _sent_here(publisher) for publisher, topics in wanted.items())


def _sent_here(publisher: str) -> Set[str]:
    """Return the topics that a node publishes to this one."""
    name = rospy.get_name()
    return {
        entry[TOPIC]
        for entry in _connections(publisher)
        if entry[DIRECTION] == OUTBOUND and entry[DESTINATION] == name
    }


def _connections(uri: str) -> list:
    """Return the connections of a node by its URI; none where it does not answer."""
    try:
        with xmlrpc.client.ServerProxy(uri) as node:
            code, _, entries = node.getBusInfo(rospy.get_name())
    except (OSError, xmlrpc.client.Error):
        return []
    return entries if code == 1 else []
