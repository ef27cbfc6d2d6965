import math

import pytest

pytest.importorskip("rospy")

from geometry_msgs.msg import Vector3, Wrench
from visualization_msgs.msg import Marker

from bullet_lab.ros.messages.gazebo_types import msg
from bullet_lab.ros.messages.poses import InputError
from bullet_lab.ros.nodes.show_sensors import contact_markers, total_wrench


def touching(force=2.0):
    wrenches = [Wrench(Vector3(-force, 0, 0), Vector3(0, 0, 1)), Wrench(Vector3(), Vector3())]
    state = msg.ContactState(
        wrenches=wrenches,
        total_wrench=Wrench(Vector3(-force, 0, 0), Vector3(0, 0, 1)),
        contact_positions=[Vector3(1, 2, 3), Vector3(1, 3, 3)],
        contact_normals=[Vector3(-1, 0, 0), Vector3(-1, 0, 0)],
    )
    message = msg.ContactsState(states=[state, state])
    message.header.frame_id = "bumper_link"
    return message


def test_each_point_has_a_sphere_a_normal_and_its_force():
    first, *markers = contact_markers(touching(), 0.1)
    assert first.action == Marker.DELETEALL
    kinds = [marker.ns for marker in markers]
    # The second point of each pair of shapes bears nothing: no arrow.
    assert [kinds.count(kind) for kind in ("point", "normal", "force")] == [4, 4, 2]
    assert len({(marker.ns, marker.id) for marker in markers}) == len(markers)
    force = next(marker for marker in markers if marker.ns == "force")
    assert force.header.frame_id == "bumper_link"
    start, end = force.points
    assert (start.x, start.y, start.z) == (1, 2, 3)
    assert (end.x, end.y, end.z) == pytest.approx((0.8, 2.0, 3.0))


def test_the_wrench_is_that_of_all_contacts():
    total = total_wrench(touching())
    assert (total.force.x, total.torque.z) == (-4.0, 2.0)
    none = total_wrench(msg.ContactsState())
    assert (none.force.x, none.force.y, none.force.z) == (0, 0, 0)


def test_nothing_touched_takes_the_markers_away():
    (marker,) = contact_markers(msg.ContactsState(), 0.1)
    assert marker.action == Marker.DELETEALL


def test_what_is_refused():
    with pytest.raises(InputError, match="not finite"):
        total_wrench(touching(math.nan))
    with pytest.raises(InputError, match="not finite"):
        list(contact_markers(touching(math.inf), 0.1))
    bad = touching()
    bad.states[0].contact_normals.pop()
    with pytest.raises(InputError, match="without a normal"):
        list(contact_markers(bad, 0.1))
