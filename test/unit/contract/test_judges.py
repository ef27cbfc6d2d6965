"""Each kind of expectation holds for right values, and names what is wrong for wrong ones."""

import functools
from types import SimpleNamespace

import pytest
import yaml
from contract_judges import JUDGES, Evidence, Heard, Scene, judge
from geometry_msgs.msg import Transform
from message_fields import data_of, message
from nav_msgs.msg import Odometry

MD5 = Odometry._md5sum
TYPES = {"nav_msgs/Odometry": MD5, "std_srvs/Empty": "d41d8cd98f00b204e9800998ecf8427e"}


@functools.lru_cache(maxsize=None)
def odometry(stamp, x=0.0):
    secs, nsecs = divmod(round(stamp * 1e9), 10**9)
    made = message(Odometry, "header: {frame_id: odom}")
    made.header.stamp.secs, made.header.stamp.nsecs = secs, nsecs
    made.pose.pose.position.x = x
    return data_of(made)


def scene(
    topic="/a/odom", type="nav_msgs/Odometry", md5=MD5, latching=False, messages=21, error=None
):
    """A topic with 21 messages, 20 per second, in which x goes from 5 to 6."""
    buffers = [odometry(0.05 * number, 5.0 + 0.05 * number) for number in range(messages)]
    evidence = Evidence(
        published={"/a/odom": type},
        taken={"/a/cmd": "geometry_msgs/Twist"},
        services={"/a/zero": ("std_srvs/Empty", TYPES["std_srvs/Empty"])},
        heard={
            "/a/odom": Heard(type, md5, latching, Odometry, buffers),
            "/a/twin": Heard("", "", False, Odometry, buffers),
        },
        frames={("odom", "base")},
        parameters={"/use_sim_time": True},
        seconds=1.0,
    )
    answer = SimpleNamespace(__slots__=[], success=True, names=["a", "b"], text="all is well")
    made = Scene(evidence, TYPES, "/a/odom", (5.0, 0.0, 0.0), answer)
    made.topic = topic
    if error is not None:
        made.error = error
    return made


# Word, what is expected, and changes of the scene.
HOLD = yaml.safe_load("""
- [publishes, nav_msgs/Odometry, {}]
- [takes, geometry_msgs/Twist, {topic: /a/cmd}]
- [absent, true, {topic: /a/nothing}]
- [offers, std_srvs/Empty, {topic: /a/zero}]
- [latched, false, {}]
- [silent, true, {topic: /a/nothing}]
- [silent, nav_msgs/Odometry, {messages: 0}]
- [parameter, {/use_sim_time: true}, {}]
- [rate, 20, {}]
- [fields, {header.frame_id: odom}, {}]
- [fields, {pose.pose.position.x: {near: 1.0, from: x}}, {}]
- [fields, {pose.covariance: {length: 36}, "pose.covariance[0]": 0.0}, {}]
- [change, {pose.pose.position.x: {near: 1.0, within: 0.001}}, {}]
- [spread, {pose.pose.position.y: 0.0}, {}]
- [stamped, twin, {}]
- [tf, [odom, base], {}]
- [no_tf, [odom, wheel], {}]
- [answers, {success: true, names: {holds: [a], lacks: [c]}}, {}]
- [answers, {text: {matches: ^all}, names: [a, b]}, {}]
- [fails, true, {error: "no"}]
""")
# The same, and what is said.
BREAK = yaml.safe_load("""
- [publishes, nav_msgs/Odometry, {topic: /a/path}, nobody publishes /a/path]
- [publishes, nav_msgs/Odometry, {type: nav_msgs/Path}, has nav_msgs/Path]
- [publishes, nav_msgs/Odometry, {md5: "0"}, md5 0]
- [publishes, nav_msgs/Odometry, {messages: 0}, nothing came]
- [takes, geometry_msgs/Twist, {topic: /a/go}, nobody]
- [takes, geometry_msgs/Pose, {topic: /a/cmd}, geometry_msgs/Twist]
- [absent, true, {}, there is /a/odom]
- [absent, true, {topic: /a/zero}, there is /a/zero]
- [offers, std_srvs/Empty, {topic: /a/one}, no service]
- [offers, std_srvs/SetBool, {topic: /a/zero}, std_srvs/Empty]
- [latched, false, {latching: true}, "latched: True"]
- [silent, true, {}, 21 messages]
- [silent, nav_msgs/Odometry, {}, 21 messages]
- [silent, nav_msgs/Path, {messages: 0}, has nav_msgs/Odometry]
- [silent, nav_msgs/Odometry, {topic: /a/path}, no publisher]
- [parameter, {/use_sim_time: false}, {}, /use_sim_time is True]
- [rate, 25, {}, 20 Hz]
- [rate, 20, {messages: 1}, nan]
- [fields, {header.frame_id: map}, {}, header.frame_id is odom]
- [fields, {pose.pose.position.x: {near: 1.2, within: 0.1, from: x}}, {}, is 6]
- [fields, {pose.pose.nothing: 1}, {}, no field]
- [fields, {"pose.covariance[36]": 1}, {}, only 36]
- [fields, {header.seq: false}, {}, seq]
- [change, {pose.pose.position.x: {near: 0.5, within: 0.1}}, {}, is 1]
- [spread, {pose.pose.position.x: 0.0}, {}, is 0.30]
- [stamped, nix, {}, nothing came on /a/nix]
- [tf, [map, base], {}, in odom]
- [tf, [odom, wheel], {}, not at all]
- [no_tf, [odom, base], {}, on /tf]
- [answers, {success: false}, {}, success is True]
- [answers, {success: true}, {error: no such service}, no such service]
- [answers, {names: {holds: [c]}}, {}, names is]
- [answers, {names: {lacks: [a]}}, {}, names is]
- [answers, {names: {length: 3}}, {}, names is]
- [answers, {text: {matches: ^well}}, {}, text is]
- [answers, {names: [b, a]}, {}, names is]
- [fails, true, {}, it answered]
""")


@pytest.mark.parametrize("word, expected, changes", HOLD)
def test_right_values_hold(word, expected, changes):
    assert judge(word, expected, scene(**changes)) == ""


@pytest.mark.parametrize("word, expected, changes, found", BREAK)
def test_wrong_values_are_named(word, expected, changes, found):
    assert found in judge(word, expected, scene(**changes))


def test_each_word_is_tested_to_hold_and_to_break():
    assert {word for word, *_ in HOLD} == {word for word, *_ in BREAK} == set(JUDGES)


def test_stamps_between_those_of_the_other_topic_are_found():
    other = scene()
    other.evidence.heard["/a/twin"].buffers = [odometry(0.05 * n + 0.01) for n in range(21)]
    assert "no twin at" in judge("stamped", "twin", other)


def test_messages_without_stamps_are_counted():
    counted = scene()
    heard = counted.evidence.heard["/a/odom"]
    heard.kind, heard.buffers = Transform, [b""] * 50
    assert judge("rate", 50, counted) == ""
    assert "50 Hz" in judge("rate", 100, counted)
