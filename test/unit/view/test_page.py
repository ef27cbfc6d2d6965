"""The page as a program sees it that knows viser's protocol; no browser."""

import time
import urllib.error
import urllib.request

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from bullet_lab.view.page import SILENCE, STILL, Page


class Driven:
    """A page, and what it was driven by."""

    def __init__(self):
        self.said = []
        self.page = Page(18200, self.said.append)
        self.origin = self.page.url.rsplit("/", 2)[0]

    def socket(self, path="drive", **options):
        address = self.page.url.replace("http", "ws", 1) + path
        return connect(address, **{"origin": self.origin, **options})

    def wait(self, number):
        deadline = time.monotonic() + 20.0
        while len(self.said) < number and time.monotonic() < deadline:
            time.sleep(0.01)
        return self.said


@pytest.fixture
def driven():
    made = Driven()
    yield made
    made.page.close()


def status_of(url):
    try:
        with urllib.request.urlopen(url) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        assert error.read() == b""
        return error.code


def test_the_page_comes_with_the_pad_and_may_load_nothing_from_elsewhere(driven):
    with urllib.request.urlopen(driven.page.url) as answer:
        page, policy = answer.read(), answer.headers["Content-Security-Policy"]
    assert b"drive-pad" in page
    assert "http:" not in policy
    assert "default-src 'self'" in policy


def test_there_is_nothing_without_the_token(driven):
    assert status_of(driven.origin + "/") == 403
    assert status_of(driven.page.url + "../../etc/passwd") == 404
    with pytest.raises(InvalidStatus):
        connect(driven.origin.replace("http", "ws", 1) + "/drive", origin=driven.origin)


@pytest.mark.parametrize("path", ["", "drive"])
@pytest.mark.parametrize("origin", [None, "http://evil.example"])
def test_there_is_no_socket_from_elsewhere(driven, path, origin):
    with pytest.raises(InvalidStatus):
        driven.socket(path, origin=origin)


def test_what_is_said_drives_and_silence_stops(driven):
    with driven.socket() as socket:
        socket.send("1 -0.5")
        start = time.monotonic()
        assert driven.wait(2) == [(1.0, -0.5), STILL]
        assert time.monotonic() - start > 0.5 * SILENCE
        socket.send("0.5 0")
        assert driven.wait(3)[-1] == (0.5, 0.0)
    assert driven.wait(4)[-1] == STILL
    # Who stands still is told so once.
    with driven.socket() as socket:
        socket.send("0 0")
        socket.send("rubbish")
    time.sleep(0.1)
    assert len(driven.said) == 4


def test_a_page_that_is_taken_moves_on_to_the_next_port(driven):
    second = Page(18200, print)
    assert second.url.rsplit("/", 2)[0] != driven.origin
    second.close()
