"""Which requests and which messages of a browser are accepted."""

import math

import msgspec
import pytest

from bullet_lab.view.gate import MAX_MESSAGE_BYTES, Gate, is_valid_message

GATE = Gate("secret")
HERE = {"Host": "localhost:8080"}
SOCKET = {**HERE, "Upgrade": "websocket"}
ORIGIN = {"Origin": "http://localhost:8080"}


@pytest.mark.parametrize(
    ("target", "headers", "path"),
    [
        ("/secret/", HERE, "/"),
        ("/secret", HERE, ""),
        ("/secret/?a=b", HERE, "/"),
        ("/secret/drive", {**SOCKET, **ORIGIN}, "/drive"),
        # The other end of a forwarded port has a number of its own.
        ("/secret", {"Host": "127.0.0.1:9", "Origin": "http://127.0.0.1:9"}, ""),
        ("/secret", {"Host": "[::1]:9", "Origin": "http://[::1]:9"}, ""),
    ],
)
def test_who_knows_the_token_and_comes_from_here_is_let_in(target, headers, path):
    assert GATE.path(target, headers) == path


@pytest.mark.parametrize(
    "target", ["/", "", "/guess/", "/secre/", "/secrets/", "//secret/", "/Secret/"]
)
def test_another_token_is_refused(target):
    assert GATE.path(target, HERE) is None


@pytest.mark.parametrize(
    "headers",
    [
        {},
        SOCKET,
        {**SOCKET, "Origin": "http://evil.example"},
        {**SOCKET, "Origin": "http://localhost:8081"},
        {**SOCKET, "Origin": "null"},
        {**HERE, "Origin": "http://evil.example"},
        {"Host": "evil.example"},
        {"Host": "evil.example", "Origin": "http://evil.example"},
        {"Host": "localhost.evil.example:8080"},
        {"Host": "[::1"},
    ],
)
def test_another_origin_or_name_is_refused(headers):
    assert GATE.path("/secret/", headers) is None


def test_each_gate_has_a_token_of_its_own():
    assert Gate().token != Gate().token
    assert len(Gate().token) >= 20


def update(**updates):
    return {"type": "GuiUpdateMessage", "uuid": "a", "updates": updates}


@pytest.mark.parametrize(
    "message",
    [update(value=0.5), update(value="/cmd_vel"), update(value=True), {"type": "X", "at": [0.0]}],
)
def test_messages_of_a_page_are_accepted(message):
    assert is_valid_message(msgspec.msgpack.encode(message))


@pytest.mark.parametrize(
    "message",
    [
        update(value=math.nan),
        update(value=-math.inf),
        update(value=[1.0, math.nan]),
        update(value="x" * 2000),
        update(value=0.5, visible=False),
        update(update_cb=5),
        update(),
        {"type": "GuiUpdateMessage", "uuid": "a", "updates": 5},
        {"type": "ViewerCameraMessage", "position": [0.0, math.inf, 0.0]},
        {math.nan: 1},
        ["GuiUpdateMessage"],
    ],
)
def test_messages_that_no_page_sends_are_dropped(message):
    assert not is_valid_message(msgspec.msgpack.encode(message))


@pytest.mark.parametrize(
    "data", ["text", b"", b"\xc1", b"\x91" * 5000 + b"\xc0", b"\xa0" * (MAX_MESSAGE_BYTES + 1)]
)
def test_garbage_is_dropped(data):
    assert not is_valid_message(data)
