"""The functions that scripts spawn models by, as the node ends."""

import pytest
import rospy
from geometry_msgs.msg import Pose
from shared import cases

gazebo_interface = pytest.importorskip("gazebo_ros.gazebo_interface")


@cases("is_shutdown: [true, false]")
def test_a_node_that_ends_while_it_waits_has_no_traceback(monkeypatch, logged, is_shutdown):

    def wait(_service):
        raise rospy.ROSInterruptException("rospy shutdown")

    monkeypatch.setattr(rospy, "wait_for_service", wait)
    monkeypatch.setattr(rospy, "is_shutdown", lambda: is_shutdown)
    spawn = gazebo_interface.spawn_sdf_model_client
    assert spawn("box", "<sdf/>", "", Pose(), "world", "/gazebo") is False
    assert bool(logged) is not is_shutdown
