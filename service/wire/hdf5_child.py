"""The process that reads HDF5 files of strangers: `python -m service.wire.hdf5_child FD`, started by `hdf5_body`.

It has everything loaded and forks for every file: a file costs milliseconds, and what it does to the library ends with
its process. Such a process may take a gigabyte, live for 20 seconds, and open nothing, neither another file nor a
connection. It answers with arrays as NumPy writes them, or with the sentence about what is wrong.
"""

from __future__ import annotations

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
from lbacal_core.spectra import read_columns

ADDRESS_SPACE = 1 << 30
DEADLINE_S = 20
LARGEST_COLUMN = 64 << 20
"""Bytes of one column in memory: 8 million values, as many as a JSON body may hold."""
GOOD, REFUSED = b"+", b"-"


def serve(control: socket.socket) -> None:
    """Fork for every connection that arrives, until the server has gone."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the kernel buries them
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the server, with whom this process ends
    for example in (b"", write_example("e"), write_example(b"e")):  # what loads at its first use loads now
        read_file(example)
    while True:
        _, descriptors, _, _ = socket.recv_fds(control, 1, 1)
        if not descriptors:
            return
        if os.fork() == 0:
            try:
                control.close()
                confine()
                answer_one(socket.socket(fileno=descriptors[0]))
            finally:
                os._exit(0)
        os.close(descriptors[0])


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
    """What a file holds, as the server reads it."""
    try:
        columns = read_columns(content, "body", LARGEST_COLUMN)
    except LbacalError as error:
        return REFUSED + json.dumps([error.status, str(error)]).encode()
    columns |= {f"env/{name}": values for name, values in columns.pop("environment").items()}
    answer = io.BytesIO()
    answer.write(GOOD + json.dumps(list(columns)).encode() + b"\n")
    for values in columns.values():
        np.save(answer, values, allow_pickle=False)
    return answer.getvalue()


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


if __name__ == "__main__":
    with socket.socket(fileno=int(sys.argv[1])) as server:
        serve(server)
