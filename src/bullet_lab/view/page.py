"""The page: viser's, behind a gate, on this machine only, with a socket beside it that drives.

viser asks nobody who he is, so its server is given the gate's hook as it starts; where that is
not taken, there is no page at all.
"""

from __future__ import annotations

import asyncio
import contextlib
import http
import math
from pathlib import Path
from typing import Any, Callable, Iterator, Optional, Tuple

from bullet_lab.errors import LabError
from bullet_lab.view.gate import Gate

HOST = "127.0.0.1"
DRIVE = "/drive"
# Wall seconds without a word from the page after which it no longer drives.
SILENCE = 0.5
STILL = (0.0, 0.0)
TITLE = "bullet_lab"
# Nothing is loaded from, or sent to, anywhere else.
HEADERS = {
    "Content-Security-Policy": "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; "
    "connect-src 'self' data: blob:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}

# Shares of the full speed, within [-1, 1]: forward, and turning left.
Shares = Tuple[float, float]


class ViewError(LabError):
    """There is no page to be had."""


def read_shares(word: Any) -> Shares:
    """Return what a word of the page asks for; nothing, if it makes no sense.

    >>> read_shares("0.5 -3")
    (0.5, -1.0)
    >>> read_shares("faster")
    (0.0, 0.0)
    """
    try:
        forward, left = map(float, word.split())
    except (ValueError, TypeError, AttributeError):
        return STILL
    if not (math.isfinite(forward) and math.isfinite(left)):
        return STILL
    return max(-1.0, min(1.0, forward)), max(-1.0, min(1.0, left))


class Page:
    """A page for whoever has its URL.

    Args:
        port: to listen on; the next that is free, if it is not.
        drive: called, from the page's own thread, when somebody drives, and with STILL once when
            he no longer does: has let go, is silent, or is gone.

    Attributes:
        server: viser's, to make a scene and controls with.

    Raises:
        ViewError: viser is not there, or not one that lets itself be guarded.
    """

    def __init__(self, port: int, drive: Callable[[Shares], None]):
        self._gate = Gate()
        self._drive = drive
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
        request.path = path
        if request.headers.get("Upgrade") is not None:
            known = path in ("", "/", DRIVE)
            return None if known else _response(http.HTTPStatus.NOT_FOUND)
        if path not in ("", "/"):
            return _response(http.HTTPStatus.NOT_FOUND)
        # As it is, to put something into it.
        del request.headers["Accept-Encoding"]
        answer = self._serve_page(connection, request)
        return _response(http.HTTPStatus.OK, _with_drive(answer.body), "text/html; charset=utf-8")

    def _handler(self, viser: Callable) -> Callable:
        async def handle(connection: Any) -> None:
            other = connection.request.path == DRIVE
            await (self._listen(connection) if other else viser(connection))

        return handle

    async def _listen(self, connection: Any) -> None:
        """Drive as the page says, for as long as it does."""
        from websockets.exceptions import ConnectionClosed

        moving = False
        try:
            while True:
                try:
                    word = await asyncio.wait_for(connection.recv(), SILENCE if moving else None)
                    shares = read_shares(word)
                except asyncio.TimeoutError:
                    shares = STILL
                if moving or shares != STILL:
                    self._drive(shares)
                moving = shares != STILL
        except ConnectionClosed:
            pass
        finally:
            if moving:
                self._drive(STILL)


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


def _with_drive(page: bytes) -> bytes:
    script = (Path(__file__).parent / "drive.js").read_bytes()
    page = page.replace(b"<title>Viser</title>", f"<title>{TITLE}</title>".encode(), 1)
    return page.replace(b"</title>", b"</title>\n<script>" + script + b"</script>", 1)


def _response(status: http.HTTPStatus, body: bytes = b"", kind: str = "text/plain") -> Any:
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    headers = Headers(HEADERS, Connection="close")
    headers["Content-Type"], headers["Content-Length"] = kind, str(len(body))
    return Response(status.value, status.phrase, headers, body)
