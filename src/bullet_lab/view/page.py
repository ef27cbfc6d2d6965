"""The page: viser's, behind a gate, on this machine only, with a socket beside it that drives.

viser asks nobody who he is, so its server is given the gate's hook as it starts; where that is
not taken, there is no page at all.
"""

from __future__ import annotations

import asyncio
import contextlib
import contextvars
import http
import json
import secrets
import time
from pathlib import Path
from typing import Any, Callable, Iterator, Optional

from bullet_lab.errors import LabError
from bullet_lab.view.gate import Gate
from bullet_lab.view.pad import PERIOD, Pad, Wheel
from bullet_lab.view.soundness import is_sound

HOST = "127.0.0.1"
DRIVE = "drive"
TITLE = "bullet_lab"
# Scripts and styles count only with the nonce of the page; nothing comes from, or goes to, anywhere
# else. viser unpacks itself in WebAssembly, and has workers.
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
# Which page the code at hand is about, in the tasks that serve it.
_PAGE: contextvars.ContextVar[str] = contextvars.ContextVar("page", default="")


class ViewError(LabError):
    """There is no page to be had."""


class Page:
    """A page for whoever has its URL; each browser tab has a name of its own.

    Args:
        port: to listen on; the next that is free, if it is not.
        wheel: which tab drives.

    Attributes:
        server: viser's, to make a scene and controls with.

    Raises:
        ViewError: viser is not there, or not one that lets itself be guarded.
    """

    def __init__(self, port: int, wheel: Wheel):
        self._gate = Gate()
        self._wheel = wheel
        self._serve_page: Optional[Callable] = None
        viser = _import_viser()
        with self._guarding(viser):
            self.server = viser(HOST, port, label=TITLE, verbose=False)
        if self._serve_page is None:
            self.server.stop()
            raise ViewError("this viser lets in whoever asks: another version is needed")
        self.server.gui.configure_theme(show_share_button=False, show_logo=False)
        self.server.gui.main_panel.dock_right()

    @property
    def url(self) -> str:
        """Where the page is, with the token."""
        return f"http://{HOST}:{self.server.get_port()}/{self._gate.token}/"

    def on_connect(self, handle: Callable[[str, Any], None]) -> None:
        """Call `handle` with the name of each tab that opens, and viser's client for it."""

        async def connected(client: Any) -> None:
            handle(_PAGE.get(), client)

        self.server.on_client_connect(connected)

    def close(self) -> None:
        """Close the page."""
        self.server.stop()

    @contextlib.contextmanager
    def _guarding(self, viser: type) -> Iterator[None]:
        """Have the server that viser starts meanwhile ask the gate first."""
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
        """Answer a request; None for what goes on as a WebSocket."""
        path = self._gate.path(request.path, request.headers)
        if path is None:
            return _response(http.HTTPStatus.FORBIDDEN)
        parts = path.strip("/").split("/")
        is_socket = request.headers.get("Upgrade") is not None
        # /, /tab and, for sockets, /tab/drive: the page tells the server its tab's name.
        if parts[1:] not in ([], [DRIVE]) or (parts[1:] and not is_socket):
            return _response(http.HTTPStatus.NOT_FOUND)
        request.path = "/" + "/".join(parts)
        if is_socket:
            return None
        request.path = "/"
        # As it is, to put something into it.
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
            _PAGE.set(tab)
            try:
                await (self._listen(connection, tab) if rest else viser(_Checked(connection)))
            finally:
                self._wheel.leave(tab)

        return handle

    async def _listen(self, connection: Any, tab: str) -> None:
        """Drive as the pad of a tab says, for as long as it does."""
        from websockets.exceptions import ConnectionClosed

        pad = Pad(tab, self._wheel)
        telling = asyncio.ensure_future(_tell(connection, pad))
        try:
            while True:
                try:
                    word = await asyncio.wait_for(connection.recv(), pad.patience(time.monotonic()))
                except asyncio.TimeoutError:
                    pad.stop()
                else:
                    pad.take(word, time.monotonic())
        except ConnectionClosed:
            pass
        finally:
            telling.cancel()


async def _tell(connection: Any, pad: Pad) -> None:
    """Tell a pad the time that its words have to bear, and who drives."""
    from websockets.exceptions import ConnectionClosed

    with contextlib.suppress(ConnectionClosed):
        while True:
            await connection.send(json.dumps(pad.state(time.monotonic())))
            await asyncio.sleep(PERIOD)


class _Checked:
    """A connection of viser's from which only sound messages come."""

    def __init__(self, connection: Any):
        self._connection = connection

    def __getattr__(self, name: str) -> Any:
        return getattr(self._connection, name)

    async def recv(self) -> bytes:
        while True:
            data = await self._connection.recv()
            if is_sound(data):
                return data


def _import_viser() -> Callable[..., Any]:
    try:
        import rich
        import viser
    except ImportError as error:
        raise ViewError(f"{error}: run scripts/setup.sh, or pip install viser") from error

    class Local(viser.ViserServer):
        """A server of which nothing leaves this machine."""

        def request_share_url(self, verbose: bool = True) -> None:
            """Pass over a wish for a tunnel to viser's makers."""

    # It would print a URL without the token.
    rich.get_console().quiet = True
    return Local


def _with_pad(page: bytes, nonce: str) -> bytes:
    """Return the page with its pad, its tab's name, and the nonce on each script of it."""
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
