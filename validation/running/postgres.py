"""A PostgreSQL server of one's own, on a socket in a temporary folder, for tests and proofs."""

from __future__ import annotations

import os
import pwd
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psycopg

STARTS = 40
PLACES = ("/usr/lib/postgresql/*/bin", "/usr/local/pgsql/bin", "/opt/homebrew/opt/postgresql*/bin", "/usr/local/bin")


def find_binaries() -> Path | None:
    """The folder of the newest server binaries, if there are any."""
    found = shutil.which("initdb")
    candidates = [Path(found).resolve().parent] if found else []
    for place in PLACES:
        candidates += sorted(Path("/").glob(place.removeprefix("/")), reverse=True)
    return next((folder for folder in candidates if (folder / "pg_ctl").exists()), None)


@dataclass
class Server:
    """A PostgreSQL server of one's own."""

    folder: Path
    binaries: Path
    port: int | None = None
    """On loopback; None for a socket in the folder alone."""

    @property
    def url(self) -> str:
        """The address of the first database."""
        port = "" if self.port is None else f"&port={self.port}"
        return f"postgresql://lbacal@/postgres?host={self.folder}{port}"

    def start(self) -> None:
        """Start it; after a kill, as soon as what is left of it has gone."""
        # processes are killed in the tests, not the machine: fsync would only cost time
        options = f"-c unix_socket_directories='{self.folder}' -c fsync=off"
        options += " -c listen_addresses=''" if self.port is None else f" -c listen_addresses=127.0.0.1 -p {self.port}"
        command = ["pg_ctl", "-D", str(self._data), "-w", "-l", str(self.folder / "log")]
        for attempt in range(STARTS):
            try:
                self._run(*command, "-o", f"{options} -c max_connections=200", "start")
            except subprocess.CalledProcessError:
                if attempt == STARTS - 1:
                    raise
                time.sleep(0.5)
            else:
                return

    def kill(self) -> None:
        """Kill it as a power cut would (signal 9), and start it anew."""
        number = int((self._data / "postmaster.pid").read_text().split()[0])
        os.kill(number, signal.SIGKILL)
        self.start()

    def ask_for_passwords(self) -> None:
        """From now on, of whoever does not come by the socket."""
        (self._data / "pg_hba.conf").write_text("local all all trust\nhost all all 127.0.0.1/32 scram-sha-256\n")
        self._run("pg_ctl", "-D", str(self._data), "reload")

    def stop(self) -> None:
        """End it."""
        self._run("pg_ctl", "-D", str(self._data), "-w", "-m", "immediate", "stop")

    def make(self) -> None:
        """Make its folder."""
        user = _owner()
        if user is not None:
            os.chown(self.folder, user.pw_uid, user.pw_gid)
        self._run("initdb", "-D", str(self._data), "-U", "lbacal", "-A", "trust", "-E", "UTF8", "--no-sync")

    @property
    def _data(self) -> Path:
        return self.folder / "data"

    def _run(self, *command: str) -> None:
        user = _owner()
        as_user: dict[str, Any] = (
            {} if user is None else {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": []}
        )
        program = [str(self.binaries / command[0]), *command[1:]]
        subprocess.run(program, check=True, cwd=self.folder, stdout=subprocess.DEVNULL, **as_user)


@contextmanager
def run_server() -> Iterator[Server]:
    """A server of our own that ends with the block; FileNotFoundError where there are no binaries."""
    binaries = find_binaries()
    if binaries is None:
        raise FileNotFoundError("no PostgreSQL server binaries; set LBACAL_TEST_PG or install postgresql")
    with tempfile.TemporaryDirectory(prefix="lbacal-pg-") as name:
        server = Server(Path(name), binaries)
        server.make()
        server.start()
        try:
            yield server
        finally:
            server.stop()


@contextmanager
def run_postgres() -> Iterator[str]:
    """Yield the URL of a database: `LBACAL_TEST_PG` where set, else of a server of our own that ends with the block.

    Raises FileNotFoundError where neither is to be had.
    """
    given = os.environ.get("LBACAL_TEST_PG")
    if given:
        yield given
        return
    with run_server() as server:
        yield server.url


@contextmanager
def open_databases(kind: str, *names: str) -> Iterator[list[str]]:
    """The URLs of empty databases, of `sqlite` or `postgresql`, that are gone after the block."""
    if kind == "sqlite":
        with tempfile.TemporaryDirectory(prefix="lbacal-") as folder:
            yield [f"{folder}/{name}.sqlite" for name in names]
        return
    with run_postgres() as server, psycopg.connect(server, autocommit=True) as connection:
        own = [f"{name}_{os.getpid()}" for name in names]
        for name in own:
            connection.execute(f"CREATE DATABASE {name}")
        yield [server.replace("/postgres?", f"/{name}?", 1) for name in own]
        for name in own:
            connection.execute(f"DROP DATABASE {name} WITH (FORCE)")


def _owner() -> pwd.struct_passwd | None:
    """PostgreSQL refuses to run as root: then it runs as postgres or nobody."""
    if os.geteuid() != 0:
        return None
    names = {entry.pw_name: entry for entry in pwd.getpwall()}
    return names.get("postgres") or names["nobody"]
