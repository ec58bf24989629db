"""The viewer's server: viser's, behind checks of every request and of every message from a browser."""

from __future__ import annotations

import http
import logging
import socket
from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from typing import Any

import viser
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from gctd3.compat import control_of, served_with, wake_by_the_loop
from gctd3.viz.browser_messages import Gate
from gctd3.viz.hosts import LOOPBACK, Names, bracketed

_LARGEST = 1 << 16  # bytes of a message from a browser; its longest is a camera's view, of some 300
_POLICY = 1008  # websocket close code: a message that breaks the server's policy (RFC 6455, section 7.4.1)
_Answer = Response | None | Awaitable[Response | None]


def serve(host: str, port: int, allowed_hosts: Sequence[str] = ()) -> viser.ViserServer:
    """Start a viser server that answers to its own page alone.

    Requests are refused (403) whose Host or Origin is not one of the viewer's names. Frames that hold no message end
    their connection; a message that the viewer's page would not send is dropped. Neither is logged.

    Args:
        host: Address to listen at.
        port: Port to listen at; 0 for any that is free.
        allowed_hosts: Further names of the viewer, ``name`` for any port or ``name:port``.

    Raises:
        CompatError: If viser serves in another way, past the checks.
    """
    gate = Gate(lambda uuid: control_of(started[0], uuid) if started else None)
    started: list[viser.ViserServer] = []
    quiet = logging.getLogger("gctd3.viewer.connections")
    quiet.disabled = True  # or whoever connects could fill the log
    changed = {"create_connection": partial(_CheckedConnection, gate), "max_size": _LARGEST, "logger": quiet}
    names = Names([*LOOPBACK, *_names_of(host)], allowed_hosts)
    wake_by_the_loop()
    with served_with(lambda given: given | changed | {"process_request": _checked(names, given["process_request"])}):
        started.append(viser.ViserServer(host=host, port=port, label="gctd3", verbose=False))
    return started[0]


def _names_of(host: str) -> list[str]:
    """Return the names of this machine at the address that it listens at."""
    return [bracketed(host), *([socket.gethostname().lower()] if host in ("0.0.0.0", "::", "") else [])]


def _checked(
    names: Names, serve_page: Callable[[ServerConnection, Request], _Answer]
) -> Callable[[ServerConnection, Request], _Answer]:
    """Wrap the function that answers requests to refuse foreign ones."""

    def answer(connection: ServerConnection, request: Request) -> _Answer:
        address, port = connection.local_address[:2]
        # No site's name is an address, so that the one which was connected to is safe.
        here = Names([*names.own, bracketed(address)], names.allowed)
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        # Programs send no Origin; browsers always do where a page of another site asks.
        if len(hosts) == 1 and here.accept(hosts[0], port) and all(here.accept_origin(o, port) for o in origins):
            return serve_page(connection, request)
        return connection.respond(
            http.HTTPStatus.FORBIDDEN,
            f"This viewer answers to http://localhost:{port} alone. For another name of it: allowed_hosts=[NAME].\n",
        )

    return answer


class _CheckedConnection(ServerConnection):
    """Receive only messages that a gate lets through."""

    def __init__(self, gate: Gate, *args: Any, **kwargs: Any) -> None:  # noqa: ANN401 - websockets'
        super().__init__(*args, **kwargs)
        self._gate, self._introduced = gate, False

    async def recv(self, decode: bool | None = None) -> Any:  # noqa: ANN401 - bytes, in a type that is overloaded
        """Receive the next message that the viewer handles."""
        while True:
            frame = await super().recv(decode)
            message = self._gate.read(frame)
            if message is None:
                # What arrived before is read to its end; then it raises that the connection is closed.
                await self.close(_POLICY, "not a message of the viewer's page")
            elif self._gate.is_view(message):
                self._introduced = True
                return frame
            # viser keeps a value without calling anybody before it has seen a browser's camera.
            elif self._introduced and (self._gate.is_value(message) or self._gate.is_key(message)):
                return frame
