"""The names under which browsers reach the viewer, as the headers Host and Origin give them.

A page of another site can open a websocket to ``localhost``, and a name of its own can be made to point there (DNS
rebinding). A browser tells both by these headers.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

HOST = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[^\s\[\]:/@,]+)(?::(\d{1,5}))?")  # with or without a port
LOOPBACK = ("localhost", "127.0.0.1", "[::1]")
_PORTS = {"http": 80, "https": 443}


@dataclass(frozen=True)
class Names:
    """Hold the names under which browsers reach a viewer.

    Attributes:
        own: Names and addresses that need the viewer's port behind them.
        allowed: Names of a user's choice, ``name`` for any port or ``name:port``.
    """

    own: Sequence[str]
    allowed: Sequence[str]

    def accept(self, host: str | None, port: int, default_port: int = _PORTS["http"]) -> bool:
        """Tell whether ``host``, the value of a header Host, names the viewer at ``port``."""
        parts = HOST.fullmatch(host.lower()) if host is not None else None
        if parts is None:
            return False
        name, given = parts[1], int(parts[2] or default_port)
        allowed = [entry.lower() for entry in self.allowed]
        return name in allowed or f"{name}:{given}" in allowed or (given == port and name in self.own)

    def accept_origin(self, origin: str, port: int) -> bool:
        """Tell whether ``origin``, the value of a header Origin, is the viewer's own page."""
        scheme, _, host = origin.lower().partition("://")
        return scheme in _PORTS and self.accept(host, port, _PORTS[scheme])


def bracketed(address: str) -> str:
    """Return a host as it stands in a URL, an IPv6 address in brackets."""
    return f"[{address}]" if ":" in address else address.lower()
