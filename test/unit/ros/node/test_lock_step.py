from types import SimpleNamespace

import pytest
import rospy
from bullet_lab.srv import AdvanceResponse
from geometry_msgs.msg import Twist
from message_fields import check
from nav_msgs.msg import Odometry
from shared import cases, refuses
from std_msgs.msg import Time

from bullet_lab.ros.node import lock_step
from bullet_lab.ros.node.lock_step import END_OF_TIME, Member, await_room, in_lock_step
from bullet_lab.ros.node.node import NodeError
from bullet_lab.ros.node.odometry import planar_pose


class Bridge:
    """Answers as the bridge does, of which time and epoch are set by the test."""

    def __init__(self):
        self.now, self.epoch = 0, 1
        self.heard = ["/cmd_vel"]
        self.requests = []

    def __call__(self, request):
        self.requests.append(request)
        known = request.epoch == self.epoch or request.until == END_OF_TIME
        if known and request.until != END_OF_TIME:
            self.now = request.until.secs
        success = known or not request.epoch
        heard = () if request.epoch else self.heard
        return AdvanceResponse(rospy.Time(self.now), self.epoch, success, "", heard)


def publisher(topic, kind, messages=0, receiver="/bridge"):
    connection = SimpleNamespace(endpoint_id=receiver, stat_num_msg=messages)
    made = SimpleNamespace(resolved_name=topic, data_class=kind, published=[])
    made.impl = SimpleNamespace(connections=[connection])
    made.publish = made.published.append
    return made


@pytest.fixture
def bridge(monkeypatch):
    made = Bridge()
    monkeypatch.setattr(rospy, "wait_for_service", lambda *_: None)
    monkeypatch.setattr(lock_step, "_bridge_is_there", lambda: True)
    monkeypatch.setattr(rospy, "ServiceProxy", lambda *_, **__: made)
    monkeypatch.setattr(rospy, "get_name", lambda: "/member")
    monkeypatch.setattr(lock_step, "ROUTE_CHECK_SECONDS", 0.0)
    return made


@pytest.fixture
def member(bridge):
    made = Member()
    assert made.join() == rospy.Time(0)
    bridge.requests.clear()
    return made


def test_no_node_is_in_lock_step_unasked():
    assert not in_lock_step()


def test_after_a_reset_of_the_world_it_is_asked_for_again(bridge, member):
    assert member.advance(rospy.Time(5)).secs == 5
    bridge.epoch = 2
    assert member.advance(rospy.Time(10)).secs == 10
    assert [request.epoch for request in bridge.requests] == [1, 1, 2]


def test_a_reset_of_time_is_told_at_once(bridge, member):
    member.advance(rospy.Time(5))
    bridge.now, bridge.epoch = 0, 2
    assert member.advance(rospy.Time(10)).secs == 0
    assert member.advance(rospy.Time(5)).secs == 5


def test_a_bridge_that_ends_is_not_asked_again_and_again(bridge, member):
    bridge_ends = AdvanceResponse(rospy.Time(3), 1, False, "the bridge shuts down", ())
    member._call = lambda request: bridge_ends
    assert member.advance(rospy.Time(10)).secs == 3


def test_a_bridge_that_is_gone_is_an_error(member):
    def gone(_request):
        raise rospy.ServiceException("gone")

    member._call = gone
    with refuses("/bullet_lab/advance: gone", NodeError):
        member.advance(rospy.Time(10))


def test_what_was_sent_is_told_connection_by_connection(bridge, member):
    gone = publisher("/b", Time)
    gone.impl = None
    commands = publisher("/cmd_vel", Twist, 7, "/relay")
    member.publishers += [publisher("/a", Time, 3), commands, gone]
    member.advance(rospy.Time(5))
    request = bridge.requests[-1]
    check(request, "{topics: [/a, /cmd_vel], receivers: [/bridge, /relay], messages: [3, 7]}")


def test_a_relay_is_given_something_to_pass_on(bridge):
    member = Member()
    commands, status = publisher("/wish", Twist), publisher("/status", Time)
    member.publishers += [commands, status]

    def publish(message):
        commands.published.append(message)
        if len(commands.published) == 3:
            bridge.heard = ["/wish"]

    commands.publish = publish
    member.join()
    assert (commands.published, status.published) == (3 * [Twist()], [])
    assert all(request.epoch == 0 for request in bridge.requests)


def test_commands_that_lead_nowhere_do_not_keep_a_node_from_its_work(bridge, monkeypatch):
    monkeypatch.setattr(lock_step, "WAIT_FOR_ROUTE_SECONDS", 0.0)
    member = Member()
    member.publishers.append(publisher("/wish", Twist))
    member.join()


def test_what_a_callback_refuses_is_logged_and_does_not_end_its_thread(monkeypatch, logged):
    monkeypatch.setattr(rospy, "Subscriber", lambda topic, kind, receive, **_: receive)
    receive = lock_step.subscriber("odom", Time, lambda message: planar_pose(Odometry()))
    receive(Time())
    assert logged == ["odom: refused: an orientation of length 0 is no unit quaternion (1 so far)"]


@pytest.fixture
def connection(monkeypatch):
    """A connection as rospy has them, with five messages; something happens in each sleep."""
    made = SimpleNamespace(_queue=["message"] * 5, done=False, meanwhile=[])
    monkeypatch.setattr(lock_step.time, "sleep", lambda _: made.meanwhile.pop(0)())
    return made


def test_a_full_queue_is_waited_for(connection):
    connection.meanwhile += [list, connection._queue.pop]
    await_room(connection, 5)
    assert len(connection._queue) == 4


def test_nobody_waits_for_a_subscriber_that_is_gone(connection):
    connection.meanwhile.append(lambda: setattr(connection, "done", True))
    await_room(connection, 5)
    assert connection.done


@cases("size: [6, null]")
def test_where_there_is_room_nobody_waits(connection, size):
    await_room(connection, size)
    await_room(object(), size)
