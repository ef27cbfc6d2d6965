from message_fields import message, plain
from shared import cases, refuses
from visualization_msgs.msg import Marker

from bullet_lab.ros.messages.gazebo_types import msg
from bullet_lab.ros.messages.poses import InputError
from bullet_lab.ros.nodes.show_sensors import contact_markers, total_wrench


def touching(force=2.0, normals="[{x: -1}, {x: -1}]", before=False):
    """Return two pairs of shapes that touch in two points each, of which the second is idle.

    With `before`, the message has the same of the step before.
    """
    wrench = f"{{force: {{x: {-force}}}, torque: {{z: 1}}}}"
    state = f"""
          - info: "time:TIME"
            wrenches: [{wrench}, {{}}]
            total_wrench: {wrench}
            contact_positions: [{{x: 1, y: 2, z: 3}}, {{x: 1, y: 3, z: 3}}]
            contact_normals: {normals}
    """
    text = f"""
        header: {{frame_id: bumper_link}}
        states: {2 * before * state.replace("TIME", "0.1")}{2 * state.replace("TIME", "0.2")}
    """
    return message(msg.ContactsState, text.replace("-inf", "-.inf").replace("nan", ".nan"))


@cases("before: [false, true]")
def test_each_point_of_the_last_step_has_a_sphere_a_normal_and_its_force(before, as_before):
    # The second point of each pair of shapes bears nothing: no arrow.
    markers = contact_markers(touching(before=before), 0.1)
    told = [line for marker in markers for line in str(marker).splitlines()]
    as_before(told, "contacts.txt")


@cases("before: [false, true]")
def test_the_wrench_is_that_of_all_contacts_of_the_last_step(before):
    assert plain(total_wrench(touching(before=before))) == [[-4.0, 0.0, 0.0], [0.0, 0.0, 2.0]]
    assert plain(total_wrench(msg.ContactsState())) == [[0.0] * 3] * 2


def test_nothing_touched_takes_the_markers_away():
    (marker,) = contact_markers(msg.ContactsState(), 0.1)
    assert marker.action == Marker.DELETEALL


def test_what_is_refused():
    with refuses("not finite", InputError):
        total_wrench(touching(float("nan")))
    with refuses("not finite", InputError):
        list(contact_markers(touching(float("inf")), 0.1))
    with refuses("without a normal", InputError):
        list(contact_markers(touching(normals="[{x: -1}]"), 0.1))
