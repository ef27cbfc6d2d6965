"""Which requests and which messages of a browser are accepted."""

import msgspec
import pytest
from shared import cases

from bullet_lab.ros.view.page import MAX_MESSAGE_BYTES, Gate, is_valid_message

GATE = Gate("secret")


@cases("""
target, path, headers:
  - [/secret/, /, {Host: "localhost:8080"}]
  - [/secret, "", {Host: "localhost:8080"}]
  - ["/secret/?a=b", /, {Host: "localhost:8080"}]
  - - /secret/drive
    - /drive
    - {Host: "localhost:8080", Upgrade: websocket, Origin: "http://localhost:8080"}
  # The other end of a forwarded port has a number of its own.
  - [/secret, "", {Host: "127.0.0.1:9", Origin: "http://127.0.0.1:9"}]
  - [/secret, "", {Host: "[::1]:9", Origin: "http://[::1]:9"}]
""")
def test_who_knows_the_token_and_comes_from_here_is_let_in(target, path, headers):
    assert GATE.path(target, headers) == path


@cases("""
target:
  - /
  - ""
  - /guess/
  - /secre/
  - /secrets/
  - //secret/
""")
def test_another_token_is_refused(target):
    assert GATE.path(target, {"Host": "localhost:8080"}) is None


@cases("""
headers:
  - {}
  - {Host: "localhost:8080", Upgrade: websocket}
  - {Host: "localhost:8080", Upgrade: websocket, Origin: "http://evil.example"}
  - {Host: "localhost:8080", Upgrade: websocket, Origin: "http://localhost:8081"}
  - {Host: "localhost:8080", Upgrade: websocket, Origin: "null"}
  - {Host: "localhost:8080", Origin: "http://evil.example"}
  - {Host: evil.example}
  - {Host: evil.example, Origin: "http://evil.example"}
  - {Host: "localhost.evil.example:8080"}
  - {Host: "[::1"}
""")
def test_another_origin_or_name_is_refused(headers):
    assert GATE.path("/secret/", headers) is None


def test_each_gate_has_a_token_of_its_own():
    assert Gate().token != Gate().token
    assert len(Gate().token) >= 20


@cases("""
message:
  - {type: GuiUpdateMessage, uuid: a, updates: {value: 0.5}}
  - {type: GuiUpdateMessage, uuid: a, updates: {value: /cmd_vel}}
  - {type: GuiUpdateMessage, uuid: a, updates: {value: true}}
  - {type: X, at: [0.0]}
""")
def test_messages_of_a_page_are_accepted(message):
    assert is_valid_message(msgspec.msgpack.encode(message))


@cases(f"""
message:
  - {{type: GuiUpdateMessage, uuid: a, updates: {{value: .nan}}}}
  - {{type: GuiUpdateMessage, uuid: a, updates: {{value: -.inf}}}}
  - {{type: GuiUpdateMessage, uuid: a, updates: {{value: [1.0, .nan]}}}}
  - {{type: GuiUpdateMessage, uuid: a, updates: {{value: {2000 * "x"}}}}}
  - {{type: GuiUpdateMessage, uuid: a, updates: {{value: 0.5, visible: false}}}}
  - {{type: GuiUpdateMessage, uuid: a, updates: {{update_cb: 5}}}}
  - {{type: GuiUpdateMessage, uuid: a, updates: {{}}}}
  - {{type: GuiUpdateMessage, uuid: a, updates: 5}}
  - {{type: ViewerCameraMessage, position: [0.0, .inf, 0.0]}}
  - {{.nan: 1}}
  - [GuiUpdateMessage]
""")
def test_messages_that_no_page_sends_are_dropped(message):
    assert not is_valid_message(msgspec.msgpack.encode(message))


@pytest.mark.parametrize(
    "data", ["text", b"", b"\xc1", b"\x91" * 5000 + b"\xc0", b"\xa0" * (MAX_MESSAGE_BYTES + 1)]
)
def test_garbage_is_dropped(data):
    assert not is_valid_message(data)
