"""The web page: viser's server on this machine only, behind a gate, with a socket for driving.

viser has no authentication, so the gate is hooked into its server as it starts. If that version
of viser does not call the hook, the page is not served.

The server sends each pad its time, ten times a second. A command carries the newest time that its
pad has received. So the age of a command is known without comparing clocks: it is at least the
round-trip time of the link. Times are the server's, in s of its monotonic clock.
"""

from __future__ import annotations

import asyncio
import contextlib
import contextvars
import hmac
import http
import json
import math
import secrets
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Callable, Iterator
from urllib.parse import urlsplit

from bullet_lab.errors import LabError
from bullet_lab.ros.view.panel import HOLD, STILL, Driver, Shares

HOST = "127.0.0.1"
DRIVE = "drive"
TITLE = "bullet_lab"
# The browser runs scripts and uses styles only with the page's nonce, and connects to this server
# only. viser unpacks itself in WebAssembly, and has workers.
POLICY = (
    "default-src 'none'; script-src 'nonce-{nonce}' 'wasm-unsafe-eval'; style-src 'nonce-{nonce}'; "
    "img-src 'self' data: blob:; font-src data:; worker-src blob:; connect-src 'self' data: blob:; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
HEADERS = {
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
# Names that a browser here, or at the other end of a forwarded port, uses for this machine.
OWN_NAMES = ("localhost", "127.0.0.1", "::1")
SCHEMES = ("http", "https")
# A page itself sends some hundred bytes.
MAX_MESSAGE_BYTES = 100_000
MAX_TEXT_CHARACTERS = 1000
UPDATE = "GuiUpdateMessage"
# Wall seconds between two times that the server sends.
PERIOD = 0.1
# Longer commands are invalid.
MAX_COMMAND = 100
TAKE_OVER = "take over"
# Name of the tab that the running task serves.
_TAB: contextvars.ContextVar[str] = contextvars.ContextVar("tab", default="")


class ViewError(LabError):
    """The page cannot be served."""


class Page:
    """A page for all who have its URL; each browser tab has a name.

    Args:
        port: to listen on; the next free one if it is taken.
        driver: decides which tab drives.

    Attributes:
        server: viser's, for the scene and the controls.

    Raises:
        ViewError: viser is missing, or its version does not call the gate.
    """

    def __init__(self, port: int, driver: Driver):
        self._gate = Gate()
        self._driver = driver
        self._serve_page: Callable | None = None
        viser = _import_viser()
        with self._guarding(viser):
            self.server = viser(HOST, port, label=TITLE, verbose=False)
        if self._serve_page is None:
            self.server.stop()
            raise ViewError(
                "this version of viser does not check requests; install another version"
            )
        self.server.gui.configure_theme(show_share_button=False, show_logo=False)
        self.server.gui.main_panel.dock_right()

    @property
    def url(self) -> str:
        """Address of the page, with the token."""
        return f"http://{HOST}:{self.server.get_port()}/{self._gate.token}/"

    def on_connect(self, handle: Callable[[str, Any], None]) -> None:
        """Have `handle` called with the name of each tab that opens, and viser's client for it."""

        async def connected(client: Any) -> None:
            handle(_TAB.get(), client)

        self.server.on_client_connect(connected)

    def close(self) -> None:
        """Close the page."""
        self.server.stop()

    @contextlib.contextmanager
    def _guarding(self, viser: type) -> Iterator[None]:
        """Make the server that viser starts in this block ask the gate first."""
        from websockets.asyncio import server

        plain = server.serve

        def serve(handler: Callable, *args: Any, process_request: Callable, **options: Any) -> Any:
            self._serve_page = process_request
            handle = self._handler(handler)
            return plain(handle, *args, process_request=self._answer, **options)

        server.serve = serve
        try:
            yield
        finally:
            server.serve = plain

    def _answer(self, connection: Any, request: Any) -> Any:
        """Answer a request; None accepts it as a WebSocket."""
        path = self._gate.path(request.path, request.headers)
        if path is None:
            return _response(http.HTTPStatus.FORBIDDEN)
        parts = path.strip("/").split("/")
        is_socket = request.headers.get("Upgrade") is not None
        # Valid are /, /tab and, for sockets, /tab/drive: the page puts its tab's name in the path.
        if parts[1:] not in ([], [DRIVE]) or (parts[1:] and not is_socket):
            return _response(http.HTTPStatus.NOT_FOUND)
        request.path = "/" + "/".join(parts)
        if is_socket:
            return None
        request.path = "/"
        # Uncompressed, as the pad is inserted.
        if "Accept-Encoding" in request.headers:
            del request.headers["Accept-Encoding"]
        answer = self._serve_page(connection, request)
        nonce = secrets.token_urlsafe(16)
        headers = {
            "Content-Type": "text/html; charset=utf-8",
            "Content-Security-Policy": POLICY.format(nonce=nonce),
        }
        return _response(http.HTTPStatus.OK, _with_pad(answer.body, nonce), headers)

    def _handler(self, viser: Callable) -> Callable:
        async def handle(connection: Any) -> None:
            tab, _, rest = connection.request.path.strip("/").partition("/")
            _TAB.set(tab)
            try:
                await (self._listen(connection, tab) if rest else viser(_Checked(connection)))
            finally:
                self._driver.leave(tab)

        return handle

    async def _listen(self, connection: Any, tab: str) -> None:
        """Drive by the commands of a tab's pad, until its socket closes."""
        from websockets.exceptions import ConnectionClosed

        pad = Pad(tab, self._driver)
        sending = asyncio.ensure_future(_send_state(connection, pad))
        try:
            while True:
                try:
                    text = await asyncio.wait_for(connection.recv(), pad.patience(time.monotonic()))
                except asyncio.TimeoutError:
                    pad.stop()
                else:
                    pad.take(text, time.monotonic())
        except ConnectionClosed:
            pass
        finally:
            sending.cancel()


def read_command(text: Any) -> tuple[float, Shares]:
    """Return the time that a command carries, and its shares; -inf and STILL if it is invalid.

    >>> read_command("12.5 0.5 -3")
    (12.5, (0.5, -1.0))
    >>> read_command("12.5 nan 0")
    (-inf, (0.0, 0.0))
    """
    invalid = (-math.inf, STILL)
    if not isinstance(text, str) or len(text) > MAX_COMMAND:
        return invalid
    try:
        stamp, forward, left = map(float, text.split())
    except ValueError:
        return invalid
    if not all(map(math.isfinite, (stamp, forward, left))):
        return invalid
    return stamp, (max(-1.0, min(1.0, forward)), max(-1.0, min(1.0, left)))


class Pad:
    """The pad of one tab, while its socket is open."""

    def __init__(self, tab: str, driver: Driver):
        self._tab, self._driver = tab, driver
        self._ends: float | None = None
        self._is_late = False

    def take(self, text: Any, now: float) -> None:
        """Follow a command; stop if it is late or invalid."""
        if text == TAKE_OVER:
            self._driver.take_over(self._tab)
            return
        stamp, shares = read_command(text)
        self._is_late = not 0.0 <= now - stamp < HOLD
        if shares == STILL or self._is_late:
            self.stop()
        elif self._driver.claim(self._tab):
            self._ends = stamp + HOLD
            self._driver.steer(self._tab, shares)

    def patience(self, now: float) -> float | None:
        """Return for how many seconds more the last command is valid; None at a standstill."""
        return None if self._ends is None else max(0.0, self._ends - now)

    def stop(self) -> None:
        """Stop the robot, if this tab drives it."""
        self._ends = None
        self._driver.steer(self._tab, STILL)

    def state(self, now: float) -> dict[str, Any]:
        """Return the message to the pad: the time, whether another tab drives, or the link is slow.

        The pad sends the time back with its commands.
        """
        return {
            "time": now,
            "other": self._driver.holder not in (None, self._tab),
            "late": self._is_late,
        }


async def _send_state(connection: Any, pad: Pad) -> None:
    """Send a pad its state periodically; its commands carry the time from it."""
    from websockets.exceptions import ConnectionClosed

    with contextlib.suppress(ConnectionClosed):
        while True:
            await connection.send(json.dumps(pad.state(time.monotonic())))
            await asyncio.sleep(PERIOD)


class _Checked:
    """A connection of viser's that drops invalid messages."""

    def __init__(self, connection: Any):
        self._connection = connection

    def __getattr__(self, name: str) -> Any:
        return getattr(self._connection, name)

    async def recv(self) -> bytes:
        while True:
            data = await self._connection.recv()
            if is_valid_message(data):
                return data


def _import_viser() -> Callable[..., Any]:
    try:
        import rich
        import viser
    except ImportError as error:
        raise ViewError(f"{error}: run scripts/setup.sh, or pip install viser") from error

    class Local(viser.ViserServer):
        """A server that opens no tunnel to other machines."""

        def request_share_url(self, verbose: bool = True) -> None:
            """Ignore the request for a tunnel through viser's public server."""

    # viser would print a URL without the token.
    rich.get_console().quiet = True
    return Local


def _with_pad(page: bytes, nonce: str) -> bytes:
    """Return the page with the pad, the tab's name, and the nonce on each script."""
    script = (Path(__file__).parent / "drive.js").read_bytes()
    title = f"<title>{TITLE}</title>\n<script data-tab='{secrets.token_urlsafe(9)}'>".encode()
    page = page.replace(b"<title>Viser</title>", title + script + b"</script>", 1)
    return page.replace(b"<script", f"<script nonce='{nonce}'".encode())


def _response(status: http.HTTPStatus, body: bytes = b"", more: Any = ()) -> Any:
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    headers = Headers({"Content-Type": "text/plain", **HEADERS, **dict(more)}, Connection="close")
    headers["Content-Length"] = str(len(body))
    return Response(status.value, status.phrase, headers, body)


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
        """Return the path below the token, without the query; None if the request is refused."""
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
