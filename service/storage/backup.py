"""A copy of an SQLite database that others may write to meanwhile."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from sqlalchemy import make_url

from lbacal.files import written_beside
from lbacal_core.errors import BadInputError
from service.errors import UnavailableError


def copy_sqlite(url: str, output: Path) -> int:
    """Copy the database into a file, whole or not at all, and check the copy; returns its size in bytes."""
    address = make_url(url)
    if address.get_backend_name() != "sqlite":
        raise BadInputError("LBACAL_DATABASE_URL", "an SQLite file (use pg_dump)", "PostgreSQL")
    source = Path(address.database or "")
    if not source.is_file():
        raise UnavailableError("there is no database yet: run `lbacal db upgrade`", str(source))
    try:
        with written_beside(output) as beside:
            with closing(sqlite3.connect(source)) as there, closing(sqlite3.connect(beside)) as here:
                there.backup(here)
                # a copy in write-ahead mode would be read together with files beside it
                here.execute("PRAGMA journal_mode=DELETE")
                (found,) = here.execute("PRAGMA integrity_check").fetchone()
            if found != "ok":
                raise UnavailableError(f"the database is damaged: {found}")
            return beside.stat().st_size
    except sqlite3.Error as error:
        raise UnavailableError(f"the database could not be copied: {error}") from error
