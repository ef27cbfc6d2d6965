"""Random messages on both sockets of the view's page: viser's, and the one that drives."""

import contextlib
import sys
from dataclasses import fields, is_dataclass
from pathlib import Path

from mutations import mutant
from viser import _messages
from websockets.exceptions import WebSocketException

TEST = Path(__file__).resolve().parents[1]
sys.path += [str(TEST), str(TEST / "rostest"), str(TEST / "contract")]
from contract_simulator import wait_until  # noqa: E402
from view_looker import Looker, pack  # noqa: E402

TYPES = sorted(
    name
    for name, kind in vars(_messages).items()
    if is_dataclass(kind) and issubclass(kind, _messages.Message)
)
WORDS = ("0", "1", "-1", "0.5", "nan", "inf", "-1e308", "1e-320", "x", "1 0", "١", "A" * 5000)
SHARES = ("0", "1", "-1", "0.5", "-0.25")
NUMBERS = (0, 1, -1, 0.05, 0.4, 5.0, 1e9, -1e308, float("nan"), float("inf"), 2**63)
# Values that no control could take.
VALUES = (
    *NUMBERS, True, None, "/elsewhere", "<b>", "x" * 5000, [], [1.0, "a"], {},
    {"value": {"value": 1}}, b"\xff\0",
)  # fmt: skip
# How often a command to drive makes sense, a message is for a control of the page and has a value
# of its kind, and the bytes of a message are changed.
SENSE, OF_CONTROL, OF_KIND, MUTATED = 0.6, 0.7, 0.6, 0.2
# Of so many messages, one opens the page anew.
NEW_PAGE = 50


class PageFuzzer:
    """Somebody with the page's URL who sends what no page sends.

    Args:
        url: of the page, with the token.
        random: to draw from.
    """

    def __init__(self, url, random):
        self._url, self._random = url, random
        # Another page, which is to live on.
        self._witness = Looker(url)
        self._page = Looker(url)
        self._drive = self._page.driver()
        self._told = []

    def send(self):
        """Send something; return it in words."""
        if self._random.integers(NEW_PAGE) == 0:
            self._reopen()
        try:
            return self._send_word() if self._random.integers(2) else self._send_message()
        except (WebSocketException, OSError) as error:
            self._reopen()
            return f"closed: {error}"

    def lives(self):
        """Return whether the other page is still served."""
        before = self._witness.received
        return wait_until(lambda: self._witness.received > before, 60.0, 0.1)

    def close(self):
        """Close all pages."""
        self._drive.socket.close()
        self._page.close()
        self._witness.close()

    def _reopen(self):
        with contextlib.suppress(WebSocketException, OSError):
            self._drive.socket.close()
            self._page.close()
        self._page = Looker(self._url)
        self._drive = self._page.driver()

    def _one_of(self, values):
        return values[self._random.integers(len(values))]

    def _send_word(self):
        stamp = str(self._drive.listen()["time"])
        if self._random.random() < SENSE:
            word = f"{stamp} {self._one_of(SHARES)} {self._one_of(SHARES)}"
        else:
            words = " ".join(self._one_of(WORDS) for _ in range(2))
            sent = (f"{stamp} {words}", f"{self._one_of(WORDS)} {words}", "take over", stamp)
            word = self._one_of((*sent, b"\0\xff"))
        self._drive.socket.send(word)
        return f"drive: {word!r:.100}"

    def _send_message(self):
        message = self._update() if self._random.random() < OF_CONTROL else self._any_message()
        data = pack(message)
        if self._random.random() < MUTATED:
            data = mutant([*self._told[-20:], data], self._random)
        self._told.append(data)
        self._page.say(data)
        return f"page: {message!r:.200}"

    def _update(self):
        uuid, props = self._one_of([*list(self._page.controls.items()), ("none", {})])
        key = self._one_of(("value", "value", "value", "label", "disabled"))
        value = self._value_for(props) if self._random.random() < OF_KIND else self._value()
        return {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {key: value}}

    def _value_for(self, props):
        """Return a value of the kind that a control has, in its limits or not."""
        if "options" in props:
            return self._one_of(list(props["options"]))
        return self._one_of(NUMBERS if "min" in props else (True, False))

    def _any_message(self):
        name = self._one_of(TYPES)
        parts = {field.name: self._value() for field in fields(getattr(_messages, name))}
        return {"type": name, **parts}

    def _value(self):
        return self._one_of(VALUES)
