"""Spectra files in request bodies, read by processes that may die of them (`hdf5_child`)."""

from __future__ import annotations

import json
import math
import os
import re
import socket
import subprocess
import sys
import threading
import weakref
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lbacal_core.errors import LbacalError
from lbacal_core.spectra.spectra import Spectra
from service.errors import MalformedBodyError, UnavailableError
from service.wire.hdf5_child import AT_ONCE, DEADLINE_S, GOOD, REFUSED

MOST_BYTES = 1 << 29
_KEPT = ("PATH", "PYTHONPATH", "LANG", "LC_ALL")
_COLUMN = re.compile(r"<(f8|i8|U[0-9]{1,9})")
"""Types of columns: floats, integers, texts."""
_BROKEN = (ValueError, TypeError, MemoryError, OSError)


class RefusedFileError(LbacalError, code="bad_input"):
    """A file that does not follow its format, in the words of the process that read it."""

    def __init__(self, status: int, sentence: str) -> None:
        super().__init__(sentence)
        self.status = 422 if status == 422 else 400


@dataclass
class FileReader:
    """Reads spectra files of strangers, each in a process of its own; their parent is started with the first file."""

    _turns: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(AT_ONCE))
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _control: socket.socket | None = None
    _parent: subprocess.Popen[bytes] | None = None

    def read(self, content: bytes) -> Spectra:
        """Read the bytes of a spectra file."""
        try:
            with self._turns, self._connect() as connection:
                columns = _parse_answer(_exchange(connection, content))
        except _BROKEN as error:
            if self._has_ended():
                raise UnavailableError("the process that reads files has ended and is started again") from error
            raise MalformedBodyError(
                f"the body is no spectra file: reading it took {DEADLINE_S} s or 1 GB, or broke the HDF5 library"
            ) from error
        return Spectra(**columns, origin="body")

    def _connect(self) -> socket.socket:
        """A connection to a process that waits for a file."""
        ours, theirs = socket.socketpair()
        with theirs, self._lock:
            if self._control is None or self._parent is None or self._parent.poll() is not None:
                self._start()
            if self._control is not None:
                socket.send_fds(self._control, [b"f"], [theirs.fileno()])
        ours.settimeout(DEADLINE_S + 5.0)
        return ours

    def _start(self) -> None:
        self._control, theirs = socket.socketpair()
        # one thread, because it forks; and no secret of ours in its environment
        environment = {name: os.environ[name] for name in _KEPT if name in os.environ} | {"OPENBLAS_NUM_THREADS": "1"}
        command = [sys.executable, "-P", "-m", "service.wire.hdf5_child", str(theirs.fileno())]
        with theirs:
            self._parent = subprocess.Popen(  # noqa: S603 - our own module
                command, pass_fds=[theirs.fileno()], env=environment, stdin=subprocess.DEVNULL
            )
        weakref.finalize(self, _stop, self._control, self._parent, os.getpid())

    def _has_ended(self) -> bool:
        try:
            return self._parent is None or self._parent.wait(timeout=0.1) is not None
        except subprocess.TimeoutExpired:
            return False


def _stop(control: socket.socket, process: subprocess.Popen[bytes], owner: int) -> None:
    """End the processes; a fork of their owner does not, and they end though it holds the connection, too."""
    if os.getpid() == owner:
        with suppress(OSError):
            control.shutdown(socket.SHUT_RDWR)
        control.close()
        process.wait()


def _exchange(connection: socket.socket, content: bytes) -> bytes:
    """Send a file and receive the answer; nothing where the process dies."""
    answer = bytearray()
    connection.sendall(len(content).to_bytes(8, "little") + content)
    while (chunk := connection.recv(1 << 20)) and len(answer) < MOST_BYTES:
        answer += chunk
    return bytes(answer)


def _parse_answer(answer: bytes) -> dict[str, Any]:
    """The fields of `Spectra`; the process is not trusted, so that nothing is unpickled."""
    if answer[:1] == REFUSED:
        raise RefusedFileError(*json.loads(answer[1:]))
    if answer[:1] != GOOD:
        raise ValueError("no answer")
    columns: dict[str, Any] = {}
    start = answer.index(b"\n") + 1
    for name, letters, shape in json.loads(answer[1:start]):
        if not _COLUMN.fullmatch(letters):
            raise ValueError("neither numbers nor texts")
        columns[name] = np.frombuffer(answer, np.dtype(letters), math.prod(shape), start).reshape(shape)
        start += columns[name].nbytes
    environment = {name[4:]: columns.pop(name) for name in list(columns) if name.startswith("env/")}
    return {**columns, "resistance_ohm": float(columns["resistance_ohm"]), "environment": environment}
