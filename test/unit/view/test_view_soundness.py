"""Which messages of a page are read."""

import math

import msgspec
import pytest

from bullet_lab.view.soundness import LARGEST, is_sound


def update(**updates):
    return {"type": "GuiUpdateMessage", "uuid": "a", "updates": updates}


@pytest.mark.parametrize(
    "message",
    [update(value=0.5), update(value="/cmd_vel"), update(value=True), {"type": "X", "at": [0.0]}],
)
def test_what_a_page_says_is_read(message):
    assert is_sound(msgspec.msgpack.encode(message))


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
def test_what_no_page_says_is_not_read(message):
    assert not is_sound(msgspec.msgpack.encode(message))


@pytest.mark.parametrize(
    "data", ["text", b"", b"\xc1", b"\x91" * 5000 + b"\xc0", b"\xa0" * (LARGEST + 1)]
)
def test_garbage_is_not_read(data):
    assert not is_sound(data)
