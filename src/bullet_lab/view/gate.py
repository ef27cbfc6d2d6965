"""Checks of what a browser sends: HTTP requests and messages of viser's protocol."""

from __future__ import annotations

import hmac
import math
import secrets
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

# Names that a browser here, or at the other end of a forwarded port, uses for this machine.
OWN_NAMES = ("localhost", "127.0.0.1", "::1")
SCHEMES = ("http", "https")
# A page itself sends some hundred bytes.
MAX_MESSAGE_BYTES = 100_000
MAX_TEXT_CHARACTERS = 1000
UPDATE = "GuiUpdateMessage"


@dataclass(frozen=True)
class Gate:
    """Admits requests that know the token, which is the first part of every path.

    A foreign page can make a browser send requests to this machine, and open a WebSocket to it:
    the same-origin policy does not cover WebSockets. So the Origin must be this page's. The Host
    must be a name of this machine, in case a foreign name resolves to it. The port may differ, as
    that of a forwarded port does.

    >>> gate = Gate("secret")
    >>> gate.path("/secret/drive", {"Host": "localhost:8080"})
    '/drive'
    >>> gate.path("/guess/drive", {"Host": "localhost:8080"}) is None
    True
    """

    token: str = field(default_factory=lambda: secrets.token_urlsafe(16))

    def path(self, target: str, headers: Any) -> str | None:
        """Return the path below the token, without the query; None if the request is refused.

        Args:
            target: of the request, with the token.
            headers: of the request, a mapping, as of `websockets`.
        """
        _, _, rest = target.partition("?")[0].partition("/")
        token, slash, path = rest.partition("/")
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return None
        try:
            host, origin = headers.get("Host", ""), headers.get("Origin")
            asks_for_socket = headers.get("Upgrade") is not None
        except LookupError:
            # A header occurs twice.
            return None
        if not _is_own(host) or (origin is None and asks_for_socket):
            return None
        if origin is not None and not _is_same_origin(origin, host):
            return None
        return slash + path


def _is_own(host: str) -> bool:
    try:
        return urlsplit(f"//{host}").hostname in OWN_NAMES
    except ValueError:
        return False


def _is_same_origin(origin: str, host: str) -> bool:
    scheme, _, rest = origin.partition("://")
    return scheme in SCHEMES and rest.lower() == host.lower()


def is_valid_message(data: Any) -> bool:
    """Return whether a message of the page, in viser's protocol, may be passed on to viser.

    Its numbers are finite, its texts short, and of a control it sets the value only. The code that
    reads a value checks whether the menu has that option, and whether it is within the slider.
    """
    import msgspec

    if not isinstance(data, bytes) or len(data) > MAX_MESSAGE_BYTES:
        return False
    try:
        message = msgspec.msgpack.decode(data)
    except (msgspec.DecodeError, RecursionError):
        return False
    if not isinstance(message, dict) or not _is_valid(message):
        return False
    if message.get("type") != UPDATE:
        return True
    updates = message.get("updates")
    return isinstance(updates, dict) and set(updates) == {"value"}


def _is_valid(value: Any) -> bool:
    if isinstance(value, dict):
        return all(_is_valid(part) for pair in value.items() for part in pair)
    if isinstance(value, list):
        return all(map(_is_valid, value))
    if isinstance(value, str):
        return len(value) <= MAX_TEXT_CHARACTERS
    return not isinstance(value, float) or math.isfinite(value)
