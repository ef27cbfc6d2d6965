from types import SimpleNamespace

import pytest
import rospy
from geometry_msgs.msg import Twist

from bullet_lab.ros.bridge.topics import DeviceTopics
from bullet_lab.simulation.plugins import Input, PluginError
from bullet_lab.simulation.plugins.samples import PlanarCommand


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (PluginError("too fast"), "too fast"),
        (ZeroDivisionError("by zero"), "ZeroDivisionError: by zero"),
    ],
)
def test_a_command_that_one_plugin_cannot_take_reaches_the_others(monkeypatch, error, reason):
    told, taken, callbacks = [], [], []

    def subscriber(topic, kind, receive, **_):
        callbacks.append(receive)
        return SimpleNamespace(get_num_connections=lambda: 1)

    monkeypatch.setattr(rospy, "Subscriber", subscriber)
    monkeypatch.setattr(rospy, "logwarn", lambda line, *parts: told.append(line % parts))

    def fail(command):
        raise error

    topics = DeviceTopics(SimpleNamespace(do_now=lambda call: call()))
    inputs = [Input("/cmd_vel", PlanarCommand, handle) for handle in (fail, taken.append)]
    topics.connect([SimpleNamespace(outputs=(), inputs=inputs)], "robot")
    message = Twist()
    message.linear.x = 0.5
    message._connection_header = {"callerid": "/driver"}
    (receive,) = callbacks
    receive(message)
    assert [command.vx for command in taken] == [0.5]
    assert told == [f"/cmd_vel: refused: {reason} (1 so far)"]
