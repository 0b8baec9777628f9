"""The schema's version: bring it up to date, or report that it is not.

Alembic is slow to load: only who changes or compares a schema loads it.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sqlalchemy import func, inspect, make_url, select, text

from lbacal.files import written_beside
from lbacal_core.errors import BadInputError
from service.errors import ConflictError, UnavailableError
from service.schema.tables import known_revisions, metadata, require_known, require_newest
from service.storage.database import NO_FILE, REVISION, Database, explaining_failures

if TYPE_CHECKING:
    from alembic.config import Config


def make_config(database: Database) -> Config:
    """Alembic's configuration, without a file."""
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(files("migrations")))
    config.attributes["engine"] = database.engine
    return config


def upgrade(database: Database) -> None:
    """Bring the schema to what this code needs, in a new file where an SQLite database has none."""
    database.make_file()
    found = find_revision(database)
    if found == known_revisions()[-1]:
        return
    require_known(found)
    from alembic import command

    config = make_config(database)
    config.attributes["may_make"] = True
    with explaining_failures():
        command.upgrade(config, "head")


def require_current(database: Database) -> None:
    """Refuse a schema that is not the one this code needs, and name the cure."""
    require_newest(find_revision(database))


def require_complete(database: Database) -> None:
    """Refuse a schema of the right number whose tables are not those that this code states."""
    from alembic.autogenerate import compare_metadata
    from alembic.runtime.migration import MigrationContext

    with database.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True, "target_metadata": metadata})
        found = [_name_difference(one) for one in compare_metadata(context, metadata)]
    if found:
        raise UnavailableError(f"the database differs from its schema in {len(found)} places: {'; '.join(found[:3])}")


def _name_difference(difference: Any) -> str:
    """What Alembic would do about a difference, and to what."""
    what, *of = difference[0] if isinstance(difference, list) else difference
    named = [one for one in of if hasattr(one, "name")]
    names = [one if isinstance(one, str) else one.name for one in (*named, *of) if isinstance(one, str) or one in named]
    return f"{what.replace('_', ' ')} {'.'.join(dict.fromkeys(map(str, names)))}"


def find_revision(database: Database) -> str | None:
    """The revision of the schema; None where there is none."""
    with database.connect() as connection:
        if not inspect(connection).has_table("alembic_version"):
            return None
        return connection.execute(REVISION).scalar()


# A copy of an SQLite database that others may write to meanwhile.


def copy_sqlite(url: str, output: Path) -> int:
    """Copy the database into a file, whole or not at all, and check the copy; returns its size in bytes.

    The schema may be an old one: an upgrade begins with a backup. An empty database replaces no backup.
    """
    address = make_url(url)
    if address.get_backend_name() != "sqlite":
        raise BadInputError("LBACAL_DATABASE_URL", "an SQLite file (use pg_dump)", "PostgreSQL")
    source = Path(address.database or "")
    if not source.is_file():
        raise UnavailableError(NO_FILE, str(source.absolute()))
    try:
        with written_beside(output) as beside:
            with closing(sqlite3.connect(source)) as there, closing(sqlite3.connect(beside)) as here:
                here.execute("PRAGMA journal_mode=OFF")  # a journal would stay where the disk is full
                there.backup(here)
                # a copy in write-ahead mode would be read together with files beside it
                here.execute("PRAGMA journal_mode=DELETE")
                (found,) = here.execute("PRAGMA integrity_check").fetchone()
                tables = [name for (name,) in here.execute("SELECT name FROM sqlite_master")] if found == "ok" else []
            if found != "ok":
                raise UnavailableError(f"the database is damaged: {found}")
            if "alembic_version" not in tables:
                raise UnavailableError("the database is empty: correct LBACAL_DATABASE_URL", str(source.absolute()))
            return beside.stat().st_size
    except sqlite3.Error as error:
        raise UnavailableError(f"the database could not be copied: {error}") from error


# Growing from one kind of database to the other.

ROWS_AT_ONCE = 5000
LEFT_BEHIND = ("process",)
"""What lives on the database that is copied is not alive on the copy."""


def copy_database(source: Database, target: Database) -> int:
    """Copy every row into an empty database, of whichever kind, whole or not at all; how many.

    The source is seen at one instant, and has to have the schema of this version. The target is given it.
    """
    require_current(source)
    upgrade(target)
    copied, tables = 0, [table for table in metadata.sorted_tables if table.name not in LEFT_BEHIND]
    with explaining_failures(), source.connect() as here, target.engine.begin() as there:
        if there.dialect.name == "postgresql":
            there.execute(text("SET LOCAL statement_timeout = 0"))
        if any(there.execute(select(table).limit(1)).first() is not None for table in tables):
            raise ConflictError("the database to copy into is not empty")
        for table in tables:
            rows = here.execution_options(yield_per=ROWS_AT_ONCE).execute(select(table)).mappings()
            for some in rows.partitions():
                there.execute(table.insert(), [dict(row) for row in some])
                copied += len(some)
            number = table.autoincrement_column
            if number is not None and there.dialect.name == "postgresql":  # new rows are numbered after those copied
                sequence = func.pg_get_serial_sequence(table.name, number.name)
                newest = select(func.max(number)).scalar_subquery()
                there.execute(select(func.setval(sequence, func.coalesce(newest, 1), newest.is_not(None))))
    return copied
