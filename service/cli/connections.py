"""Connections to the server: how many there may be, and how long one may stay silent before its request.

What uvicorn does not bound by itself, this does, so that nobody can hold all connections by sending half a request.
Encryption, and limits that hold over several servers, are the task of a proxy in front.
"""

from __future__ import annotations

import asyncio
import os
import resource
import socket
from collections.abc import Collection
from typing import Any

import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.http.h11_impl import H11Protocol

from lbacal_core.errors import LbacalError

HEAD_S = 10.0
"""A request's head comes within this time."""
KEEP_ALIVE_S = 5
BACKLOG = 50
"""Connections that are accepted in one turn of the event loop; one above the limit is closed some turns later."""
SPARE_FILES = 5 * BACKLOG + 100
"""Files and sockets that the server needs besides the connections it keeps."""


class BoundedProtocol(H11Protocol):
    """One connection: closed where there are too many, or when the head of its next request does not come.

    No address has more connections than are left for all others, but for the proxies that `FORWARDED_ALLOW_IPS` names.
    """

    most = 500
    proxies: Collection[str] = ()
    _awaited: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for the head of the first request."""
        super().connection_made(transport)
        address = self.client and self.client[0]
        own = sum((getattr(one, "client", None) or ("",))[0] == address for one in self.connections)
        left = self.most - len(self.connections)
        if left < 0 or (own > left + 1 and not {address, "*"} & set(self.proxies)):
            transport.abort()
        else:
            self._await_head()

    def data_received(self, data: bytes) -> None:
        """Stop waiting when a request has begun."""
        super().data_received(data)
        if self.cycle is None or self.cycle.response_complete:
            self._await_head()
        else:
            self._stop_waiting()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop waiting."""
        self._stop_waiting()
        super().connection_lost(exc)

    def _await_head(self) -> None:
        if self._awaited is None:
            self._awaited = self.loop.call_later(HEAD_S, self._give_up)

    def _stop_waiting(self) -> None:
        if self._awaited is not None:
            self._awaited.cancel()
            self._awaited = None

    def _give_up(self) -> None:
        self._awaited = None
        if self.cycle is None or self.cycle.response_complete:
            self.transport.abort()


def limit_connections(wanted: int) -> type[BoundedProtocol]:
    """The protocol of a server with at most so many connections, and no more than the system has files for."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < wanted + SPARE_FILES:
        soft = wanted + SPARE_FILES if hard == resource.RLIM_INFINITY else min(wanted + SPARE_FILES, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    proxies = os.environ.get("FORWARDED_ALLOW_IPS", "").replace(" ", "").split(",")
    own = {"most": max(1, min(wanted, soft - SPARE_FILES)), "proxies": proxies}
    return type("LimitedProtocol", (BoundedProtocol,), own)


def listen(host: str, port: int) -> socket.socket:
    """The address of the server, taken before anything else is begun."""
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        listening = socket.create_server((host, port), family=family, backlog=BACKLOG)
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno and error.errno > 0 else error.strerror
        raise LbacalError(f"{host}, port {port}: {reason}; choose another with --port") from error
    # connections inherit it; asyncio sets it only where a socket names its protocol, and this one does not: an answer
    # in two parts would wait 40 ms for the client to acknowledge the first
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listening


def configure_server(app: FastAPI, connections: int) -> uvicorn.Config:
    """How the application is served: our own log, our own limits."""
    options: dict[str, Any] = {"log_config": None, "access_log": False, "timeout_keep_alive": KEEP_ALIVE_S}
    options["backlog"] = BACKLOG
    return uvicorn.Config(app, http=limit_connections(connections), **options)
