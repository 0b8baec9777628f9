"""A process records that it lives, every few seconds, for as long as its work runs."""

from __future__ import annotations

import os
import secrets
import socket
import threading
from dataclasses import dataclass, field
from typing import Self

import structlog

from lbacal_core.errors import LbacalError
from service.storage.database import Database

BEAT_S = 5.0
log = structlog.get_logger()


def name_process() -> str:
    """A name that no other process has, even in two containers with one host name and number."""
    return f"{socket.gethostname()}:{os.getpid()}:{secrets.token_hex(3)}"


@dataclass
class Pulse:
    """Beats between entering and leaving; a beat that fails is tried again at the next."""

    database: Database
    kind: str
    inputs: str | None = None
    name: str = field(default_factory=name_process)
    _stop: threading.Event = field(default_factory=threading.Event, repr=False)

    def __enter__(self) -> Self:
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        try:
            with self.database.write() as stores:
                stores.processes.leave(self.name)
        except LbacalError as error:
            log.warning("end not noted", error=str(error))

    def beat(self) -> None:
        """Note that the process lives."""
        try:
            with self.database.write() as stores:
                stores.processes.see(self.name, self.kind, self.inputs)
        except LbacalError as error:
            log.warning("pulse not noted", error=str(error), detail=getattr(error, "detail", ""))

    def _run(self) -> None:
        self.beat()
        while not self._stop.wait(BEAT_S):
            try:
                self.beat()
            except Exception:
                # the process works on whether its pulse is noted or not
                log.exception("pulse not noted")
