"""Stands in for gzclient, Gazebo's window: there is none, and nobody who waits for it is lost."""

from __future__ import annotations

import rospy

from bullet_lab.ros.node.node import run_node


def main() -> None:
    """Run the node."""

    def body() -> None:
        rospy.loginfo("gzclient: there is no window here; RViz shows the world: /bullet_lab/world")
        # A launch file may say that all ends with the window.
        rospy.spin()

    run_node("gazebo_gui", body)
