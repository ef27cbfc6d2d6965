"""The page as a program sees it that knows viser's protocol; no browser."""

import http.client
import json
import re
import time
import urllib.error
import urllib.request

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from bullet_lab.ros.view.pad import STILL, DriverSeat
from bullet_lab.ros.view.page import Page


class Driven:
    """A page, and what it was driven by."""

    def __init__(self):
        self.sent = []
        self.page = Page(18200, DriverSeat(lambda tab, shares: self.sent.append(shares)))
        self.origin = self.page.url.rsplit("/", 2)[0]

    def socket(self, path="tab/drive", origin=""):
        address = self.page.url.replace("http", "ws", 1) + path
        return connect(address, origin=self.origin if origin == "" else origin)

    def drive(self, socket, shares):
        """Send shares with each time from the server, until one was in time."""
        while shares not in self.sent:
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
    shown.sent.clear()
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


@pytest.mark.parametrize("headers", [{}, {"Accept-Encoding": "gzip"}])
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


@pytest.mark.parametrize("path", ["", "tab/drive"])
@pytest.mark.parametrize("origin", [None, "http://evil.example"])
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
    second = Page(18200, DriverSeat(print))
    assert second.url.rsplit("/", 2)[0] != shown.origin
    second.close()
