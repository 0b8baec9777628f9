"""A PostgreSQL server of one's own, on a socket in a temporary folder, for tests and proofs."""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

PLACES = ("/usr/lib/postgresql/*/bin", "/usr/local/pgsql/bin", "/opt/homebrew/opt/postgresql*/bin", "/usr/local/bin")


def find_binaries() -> Path | None:
    """The folder of the newest server binaries, if there are any."""
    found = shutil.which("initdb")
    candidates = [Path(found).resolve().parent] if found else []
    for place in PLACES:
        candidates += sorted(Path("/").glob(place.removeprefix("/")), reverse=True)
    return next((folder for folder in candidates if (folder / "pg_ctl").exists()), None)


@contextmanager
def run_postgres() -> Iterator[str]:
    """Yield the URL of a database: `LBACAL_TEST_PG` where set, else of a server of our own that ends with the block.

    Raises FileNotFoundError where neither is to be had.
    """
    given = os.environ.get("LBACAL_TEST_PG")
    if given:
        yield given
        return
    binaries = find_binaries()
    if binaries is None:
        raise FileNotFoundError("no PostgreSQL server binaries; set LBACAL_TEST_PG or install postgresql")
    with tempfile.TemporaryDirectory(prefix="lbacal-pg-") as name:
        folder, user = Path(name), _owner()
        if user is not None:
            os.chown(folder, user.pw_uid, user.pw_gid)
        as_user: dict[str, Any] = (
            {} if user is None else {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": []}
        )
        data = folder / "data"

        def run(*command: str) -> None:
            subprocess.run(
                [str(binaries / command[0]), *command[1:]], check=True, cwd=folder, stdout=subprocess.DEVNULL, **as_user
            )

        run("initdb", "-D", str(data), "-U", "lbacal", "-A", "trust", "-E", "UTF8", "--no-sync")
        # processes are killed in the tests, not the machine: fsync would only cost time
        options = f"-c listen_addresses='' -c unix_socket_directories='{folder}' -c fsync=off -c max_connections=200"
        run("pg_ctl", "-D", str(data), "-w", "-l", str(folder / "log"), "-o", options, "start")
        try:
            yield f"postgresql://lbacal@/postgres?host={folder}"
        finally:
            run("pg_ctl", "-D", str(data), "-w", "-m", "immediate", "stop")


def _owner() -> pwd.struct_passwd | None:
    """PostgreSQL refuses to run as root: then it runs as postgres or nobody."""
    if os.geteuid() != 0:
        return None
    names = {entry.pw_name: entry for entry in pwd.getpwall()}
    return names.get("postgres") or names["nobody"]
