"""The page on backups is followed word by word, on both databases."""

from __future__ import annotations

import os
import re
import shutil
import sqlite3
import subprocess
import sys
import threading
from contextlib import closing
from pathlib import Path

import pytest

from lbacal_core.errors import BadInputError
from service.errors import UnavailableError
from service.factory import Factory
from service.storage.database import Database
from service.storage.migration import copy_sqlite
from service.storage.versions import Version

TABLES = ("event", "spectrum", "calibration", "promotion", "api_key")


def block(repository: Path, title: str) -> str:
    """The commands below a heading of the page."""
    page = (repository / "docs/how-to/keep-the-service.md").read_text()
    found = re.search(rf"^### {re.escape(title)}\n.*?^```\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    assert found is not None, title
    return found[1]


def rows_of(url: str) -> dict[str, list[tuple[object, ...]]]:
    """Everything that is kept, by table."""
    database = Database(url)
    try:
        with database.engine.connect() as connection:
            revision = connection.exec_driver_sql("SELECT version_num FROM alembic_version").scalar_one()
            found = {"revision": [(revision,)]}
            for table in TABLES:
                key = "id" if table != "spectrum" else "power"
                found[table] = sorted(tuple(row) for row in connection.exec_driver_sql(f"SELECT {key} FROM {table}"))  # noqa: S608
            return found
    finally:
        database.close()


@pytest.mark.long
def test_the_page_on_backups_is_followed_word_by_word(
    factory: Factory, stored: dict[str, Version], repository: Path, tmp_path: Path
) -> None:
    settings = factory.settings
    kind = "SQLite" if settings.is_sqlite else "PostgreSQL"
    if kind == "PostgreSQL" and not all(map(shutil.which, ("psql", "pg_dump", "pg_restore"))):
        pytest.skip("needs the programs of PostgreSQL's client")
    (tmp_path / "lbacal").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m lbacal "$@"\n')
    (tmp_path / "lbacal").chmod(0o755)
    environment = os.environ | {
        "LBACAL_DATABASE_URL": settings.database_url.replace("+psycopg", ""), "LBACAL_INSTRUMENT": settings.instrument,
        "PATH": f"{tmp_path}:{os.environ['PATH']}", "PYTHONPATH": str(repository),
    }  # fmt: skip

    def follow(title: str) -> None:
        script = "set -e\n" + block(repository, f"{title} ({kind})")
        done = subprocess.run(
            ["bash", "-c", script], env=environment, cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr

    factory.keys.create(("read",))
    factory.database.close()
    first = rows_of(settings.sqlalchemy_url)
    assert (first["revision"], len(first["calibration"]), len(first["api_key"])) == ([("0021",)], len(stored), 1)
    follow("Upgrade")
    upgraded = rows_of(settings.sqlalchemy_url)
    assert upgraded == first
    follow("Back up")
    again = Factory(settings)
    again.keys.create(("admin",))
    again.database.close()
    assert len(rows_of(settings.sqlalchemy_url)["api_key"]) == 2
    follow("Restore")
    assert rows_of(settings.sqlalchemy_url) == upgraded
    follow("Roll back")
    assert rows_of(settings.sqlalchemy_url) == first


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
def test_a_backup_while_somebody_writes_is_whole(factory: Factory, tmp_path: Path) -> None:
    is_over = threading.Event()

    def write() -> None:
        while not is_over.is_set():
            factory.keys.create(("read",))

    writer = threading.Thread(target=write)
    writer.start()
    try:
        for k in range(5):
            before = len(factory.keys.list())
            assert copy_sqlite(factory.settings.sqlalchemy_url, tmp_path / f"{k}.sqlite") > 0
            with closing(sqlite3.connect(tmp_path / f"{k}.sqlite")) as copied:
                assert copied.execute("SELECT count(*) FROM api_key").fetchone()[0] >= before
    finally:
        is_over.set()
        writer.join()
    assert sorted(path.suffix for path in tmp_path.glob("?.sqlite*")) == [".sqlite"] * 5, "nothing stands beside a copy"


def test_a_copy_of_nothing_or_of_another_database_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnavailableError, match="run `lbacal db upgrade`"):
        copy_sqlite(f"sqlite:///{tmp_path}/none.sqlite", tmp_path / "x")
    with pytest.raises(BadInputError, match="pg_dump"):
        copy_sqlite("postgresql+psycopg://me@here/x", tmp_path / "x")
    (tmp_path / "half.sqlite").write_bytes(b"no database " * 1000)
    with pytest.raises(UnavailableError, match="could not be copied"):
        copy_sqlite(f"sqlite:///{tmp_path}/half.sqlite", tmp_path / "x")
    assert not (tmp_path / "x").exists()
