"""What a page may send: messages with finite numbers, short texts, and values of controls."""

from __future__ import annotations

import math
from typing import Any

# Characters of a text, and bytes of a message; a page itself sends some hundred.
LONGEST_TEXT, LARGEST = 1000, 100_000
UPDATE = "GuiUpdateMessage"


def is_sound(data: Any) -> bool:
    """Return whether a message of the page, in viser's protocol, is to be read.

    Of a control, a page says the value and nothing else. Whether a menu has the option, and a
    slider the number, is for those who read them.
    """
    import msgspec

    if not isinstance(data, bytes) or len(data) > LARGEST:
        return False
    try:
        message = msgspec.msgpack.decode(data)
    except (msgspec.DecodeError, RecursionError):
        return False
    if not isinstance(message, dict) or not _is_sound(message):
        return False
    if message.get("type") != UPDATE:
        return True
    updates = message.get("updates")
    return isinstance(updates, dict) and set(updates) == {"value"}


def _is_sound(value: Any) -> bool:
    if isinstance(value, dict):
        return all(_is_sound(part) for pair in value.items() for part in pair)
    if isinstance(value, list):
        return all(map(_is_sound, value))
    if isinstance(value, str):
        return len(value) <= LONGEST_TEXT
    return not isinstance(value, float) or math.isfinite(value)
