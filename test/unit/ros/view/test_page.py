"""The page as a program sees it that knows viser's protocol, and its pad; no browser."""

import http.client
import json
import math
import re
import time
import urllib.error
import urllib.request
from types import SimpleNamespace

import pytest
from geometry_msgs.msg import Twist, Vector3
from shared import cases
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from bullet_lab.ros.view.page import PERIOD, TAKE_OVER, Pad, Page, read_command
from bullet_lab.ros.view.panel import HOLD, STILL, Driver


class Wheel(Driver):
    """Notes by whom it drives how; the topic of a tab has its name."""

    def __init__(self):
        self.driven = []
        super().__init__(lambda tab: SimpleNamespace(drive_topic=tab, twist=self.twist))

    @staticmethod
    def twist(shares):
        return Twist(Vector3(shares[0], 0.0, 0.0), Vector3(0.0, 0.0, shares[1]))

    def _publish(self, topic, message):
        self.driven.append([topic, message.linear.x, message.angular.z])


class Driven:
    """A page, and what it was driven by."""

    def __init__(self):
        self.wheel = Wheel()
        self.page = Page(18200, self.wheel)
        self.origin = self.page.url.rsplit("/", 2)[0]

    @property
    def sent(self):
        return [tuple(shares) for _, *shares in self.wheel.driven]

    def socket(self, path="tab/drive", origin=""):
        address = self.page.url.replace("http", "ws", 1) + path
        return connect(address, origin=self.origin if origin == "" else origin)

    def drive(self, socket, shares):
        """Send shares with each time from the server, until one was in time."""
        deadline = time.monotonic() + 60.0
        while shares not in self.sent:
            assert time.monotonic() < deadline
            socket.send("{} {} {}".format(json.loads(socket.recv(60))["time"], *shares))

    def all_until_still(self):
        """Return what has driven, once the last of it is a stop."""
        deadline = time.monotonic() + 60.0
        while self.sent[-1:] != [STILL]:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        return set(self.sent)


@pytest.fixture
def driven(shown):
    shown.wheel.driven.clear()
    return shown


@pytest.fixture(scope="module")
def shown():
    made = Driven()
    yield made
    made.page.close()


def test_the_page_comes_with_the_pad_and_may_load_nothing_from_elsewhere(shown):
    with urllib.request.urlopen(shown.page.url) as answer:
        page, policy = answer.read(), answer.headers["Content-Security-Policy"]
    assert b"drive-pad" in page
    assert "default-src 'none'" in policy
    assert not re.search("http:|unsafe-inline|'unsafe-eval'", policy)
    (nonce,) = set(re.findall(b"<script nonce='([^']*)'", page))
    assert len(re.findall(b"<script", page)) == len(re.findall(b"<script nonce=", page))
    assert f"'nonce-{nonce.decode()}'" in policy
    with urllib.request.urlopen(shown.page.url) as answer:
        assert nonce not in answer.read()


@cases("headers: [{}, {Accept-Encoding: gzip}]")
def test_a_request_is_answered_whatever_encodings_it_accepts(shown, headers):
    scheme, _, host, path = shown.page.url.split("/", 3)
    connection = http.client.HTTPConnection(host)
    connection.putrequest("GET", f"/{path}", skip_accept_encoding=True)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    assert connection.getresponse().status == 200
    connection.close()


def test_there_is_nothing_without_the_token(shown):
    for url, status in ((shown.origin + "/", 403), (shown.page.url + "../../etc/passwd", 404)):
        with pytest.raises(urllib.error.HTTPError) as refusal:
            urllib.request.urlopen(url)
        assert (refusal.value.code, refusal.value.read()) == (status, b"")
    with pytest.raises(InvalidStatus):
        connect(shown.origin.replace("http", "ws", 1) + "/drive", origin=shown.origin)


@cases("""
path:
  - ""
  - tab/drive
""")
@cases("origin: [null, http://evil.example]")
def test_there_is_no_socket_from_elsewhere(shown, path, origin):
    with pytest.raises(InvalidStatus):
        shown.socket(path, origin=origin)


def test_a_command_drives_and_silence_stops(driven):
    with driven.socket() as socket:
        driven.drive(socket, (1.0, -0.5))
        assert driven.all_until_still() == {(1.0, -0.5), STILL}


def test_a_closed_page_stops_the_robot(driven):
    with driven.socket() as socket:
        driven.drive(socket, (1.0, 0.0))
    driven.all_until_still()


def test_16_mb_of_text_drive_nothing_and_harm_nobody(driven):
    with driven.socket() as socket:
        socket.send("1" * 2**24)
        driven.drive(socket, (0.5, 0.0))
    assert driven.all_until_still() == {(0.5, 0.0), STILL}


def test_a_page_that_is_taken_moves_on_to_the_next_port(shown):
    second = Page(18200, Wheel())
    assert second.url.rsplit("/", 2)[0] != shown.origin
    second.close()


# How long a command of the pad is valid, and which tab drives; on a clock of the test.


@pytest.fixture
def wheel():
    """A driver, and the pads of two tabs."""
    wheel = Wheel()
    wheel.pads = {tab: Pad(tab, wheel) for tab in "ab"}
    return wheel


@pytest.mark.parametrize(
    "text", ["1 nan 0", "inf 1 0", "1 1e999 0", "1 0", "1 0 0 0", "", b"1 1 0", None, "1 " * 10**6]
)
def test_an_invalid_command_is_late_and_a_stop(text):
    assert read_command(text) == (-math.inf, STILL)


def test_a_command_is_valid_from_the_time_that_it_carries(wheel):
    pad = wheel.pads["a"]
    pad.take("10 1 0", 10.3)
    assert wheel.driven == [["a", 1.0, 0.0]]
    assert pad.patience(10.3) == pytest.approx(HOLD - 0.3)
    pad.stop()
    assert wheel.driven[-1] == ["a", *STILL]
    assert pad.patience(10.4) is None


@cases(f"age: [{HOLD}, 2.0, 6.0, -1.0]")
def test_a_late_command_is_a_stop(wheel, age):
    pad = wheel.pads["a"]
    pad.take(f"{10.0 - age} 1 0", 10.0)
    assert not wheel.driven
    assert pad.state(10.0)["late"]
    pad.take("10 1 0", 10.0)
    pad.take(f"{10.0 - age} 1 0", 10.1)
    assert wheel.driven == [["a", 1.0, 0.0], ["a", *STILL]]


def test_a_burst_of_old_words_drives_nothing(wheel):
    for number in range(60):
        wheel.pads["a"].take(f"{10.0 + number * PERIOD} 1 0", 17.0)
    assert not wheel.driven


@cases(f"""
story:
  # What the tabs send or do at 10 s, and how the robot is driven then.
  # One tab drives, and another takes over by asking.
  - - [a, 10 1 0, [[a, 1, 0]]]
    - [b, 10 -1 0, []]
    - [b, {TAKE_OVER}, [[a, 0, 0]]]
    - [a, 10 1 0, []]
    - [b, 10 -1 0, [[b, -1, 0]]]
  # Who leaves is stopped, and others may drive.
  - - [a, 10 1 0, [[a, 1, 0]]]
    - [b, leaves, []]
    - [a, leaves, [[a, 0, 0]]]
    - [b, 10 1 0, [[b, 1, 0]]]
  # A stop is passed on once.
  - [[a, 10 0 0, []], [a, 10 1 0, [[a, 1, 0]]], [a, 10 0 0, [[a, 0, 0]]], [a, 10 0 0, []]]
""")
def test_who_drives(wheel, story):
    for tab, word, driven in story:
        wheel.driven.clear()
        if word == "leaves":
            wheel.leave(tab)
        else:
            wheel.pads[tab].take(word, 10.0)
        assert wheel.driven == driven


def test_a_page_says_that_another_tab_drives(wheel):
    wheel.pads["a"].take("10 1 0", 10.0)
    assert [wheel.pads[tab].state(10.0)["other"] for tab in "ab"] == [False, True]
