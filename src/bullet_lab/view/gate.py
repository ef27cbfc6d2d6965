"""Who may come in: requests that know the token, from this page, to this machine."""

from __future__ import annotations

import hmac
import secrets
from dataclasses import dataclass, field
from typing import Any, Optional
from urllib.parse import urlsplit

# What a browser on this machine, or at the end of a forwarded port, calls this machine.
OWN_NAMES = ("localhost", "127.0.0.1", "::1")
SCHEMES = ("http", "https")


@dataclass(frozen=True)
class Gate:
    """Lets in who has the token, which is the first part of every path.

    A page from elsewhere can make a browser ask this machine, and open a WebSocket to it without
    the browser's own policy in the way: so the Origin has to be this page's, and the Host one of
    this machine's names, lest a foreign name is made to point here. The port may be another one,
    as a forwarded port is.

    >>> gate = Gate("secret")
    >>> gate.path("/secret/drive", {"Host": "localhost:8080"})
    '/drive'
    >>> gate.path("/guess/drive", {"Host": "localhost:8080"}) is None
    True
    """

    token: str = field(default_factory=lambda: secrets.token_urlsafe(16))

    def path(self, target: str, headers: Any) -> Optional[str]:
        """Return what is asked for, below the token and without a query; None to refuse.

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
            # One of them is there twice.
            return None
        if not _is_own(host) or (origin is None and asks_for_socket):
            return None
        if origin is not None and not _is_of(origin, host):
            return None
        return slash + path


def _is_own(host: str) -> bool:
    try:
        return urlsplit(f"//{host}").hostname in OWN_NAMES
    except ValueError:
        return False


def _is_of(origin: str, host: str) -> bool:
    scheme, _, rest = origin.partition("://")
    return scheme in SCHEMES and rest.lower() == host.lower()
