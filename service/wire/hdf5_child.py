"""The processes that read HDF5 files of strangers: `python -m service.wire.hdf5_child FD`, started by `hdf5_body`.

The first has everything loaded and keeps a few forks ready, each for one file: a file costs milliseconds, and what it
does to the library ends with its process. With its file, such a process may take a gigabyte, live for 20 seconds, and
open nothing, neither another file nor a connection. It answers with a line that
describes arrays and their bytes, or with the sentence
about what is wrong.
"""

from __future__ import annotations

import gc
import io
import json
import os
import resource
import signal
import socket
import sys
from typing import Any

import numpy as np

from lbacal_core.errors import LbacalError
from lbacal_core.spectra.spectra import read_columns

ADDRESS_SPACE = 1 << 30
DEADLINE_S = 20
LARGEST_COLUMN = 64 << 20
"""Bytes of one column in memory: 8 million values, as many as a JSON body may hold."""
AT_ONCE = 4
"""Files read at the same time; each may take the address space of one."""
GOOD, REFUSED = b"+", b"-"
SERVER_GONE = 3


def serve(control: socket.socket) -> None:
    """Keep processes ready for the files that arrive, until the server has gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the server, with whom these processes end
    warm_up()
    gc.freeze()  # a collection in a fork would copy every object that it shares
    for _ in range(AT_ONCE):
        fork_reader(control)
    while os.waitstatus_to_exitcode(os.wait()[1]) != SERVER_GONE:
        fork_reader(control)


def fork_reader(control: socket.socket) -> None:
    """Start a process that waits for one file."""
    if os.fork() > 0:
        return
    try:
        _, descriptors, _, _ = socket.recv_fds(control, 1, 1)
        if not descriptors:
            os._exit(SERVER_GONE)
        control.close()
        confine()
        answer_one(socket.socket(fileno=descriptors[0]))
    finally:
        os._exit(0)


def warm_up() -> None:
    """Read examples, because what loads at its first use cannot be loaded when nothing can be opened."""
    for example in EXAMPLES:
        read_file(example)


def confine(deadline_s: int = DEADLINE_S) -> None:
    """Give up what a reader of a file does not need; at the deadline the kernel ends the process."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(deadline_s)
    for limit, value in (
        (resource.RLIMIT_AS, ADDRESS_SPACE),
        (resource.RLIMIT_CPU, deadline_s),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, 0),
    ):
        resource.setrlimit(limit, (value, value))


def answer_one(connection: socket.socket) -> None:
    """Read a file from a connection, and write what it holds or what is wrong with it."""
    with connection, connection.makefile("rb") as stream:
        content = stream.read(int.from_bytes(stream.read(8), "little"))
        resource.setrlimit(resource.RLIMIT_NOFILE, (0, 0))
        connection.sendall(read_file(content))


def read_file(content: bytes) -> bytes:
    """Read a file as the server does."""
    try:
        columns = read_columns(content, "body", LARGEST_COLUMN)
    except LbacalError as error:
        return REFUSED + json.dumps([error.status, str(error)]).encode()
    columns |= {f"env/{name}": values for name, values in columns.pop("environment").items()}
    # numbers before texts, and from a multiple of eight bytes on: each column lies where its type wants it
    arrays = {name: np.asarray(values) for name, values in columns.items()}
    ordered = sorted(arrays.items(), key=lambda column: column[1].dtype.kind == "U")
    described = json.dumps([(name, values.dtype.str, values.shape) for name, values in ordered])
    head = GOOD + described.encode()
    return head + b" " * (-(len(head) + 1) % 8) + b"\n" + b"".join(values.tobytes() for _, values in ordered)


def write_example(name: str | bytes) -> bytes:
    """A spectra file with one of everything; its texts are of any length, or of one and ASCII."""
    import h5py

    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        file.attrs["format"] = "lbacal-spectra-1"
        columns: dict[str, Any] = {
            "frequency_mhz": [50.0], "power": [[1.0]], "event_id": [name], "time_unix": [1.4e9], "station": [name],
            "antenna": [0], "dipole": [name], "blocks": [1], "env/temperature_c": [1.0],
        }  # fmt: skip
        for column, values in columns.items():
            file.create_dataset(column, data=values, compression="gzip", shuffle=True)
    return content.getvalue()


EXAMPLES = (b"", write_example("e"), write_example(b"e"))


if __name__ == "__main__":
    with socket.socket(fileno=int(sys.argv[1])) as server:
        serve(server)
