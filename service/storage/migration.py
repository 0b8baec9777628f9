"""The schema's version: bring it up to date, or say that it is not."""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory

from lbacal_core.instrument import Instrument
from service.errors import UnavailableError
from service.storage.database import Database


def make_config(database: Database) -> Config:
    """Alembic's configuration, without a file."""
    config = Config()
    config.set_main_option("script_location", str(files("migrations")))
    config.attributes["engine"] = database.engine
    return config


def upgrade(database: Database, instrument: Callable[[], Instrument] | None = None) -> None:
    """Bring the schema to what this code needs.

    `instrument` gives the one whose versions are stored: those of the first release name its hash only.
    """
    config = make_config(database)
    config.attributes["instrument"] = instrument
    command.upgrade(config, "head")


def require_current(database: Database) -> None:
    """Refuse a schema that is not the one this code needs, and name the cure."""
    needed = ScriptDirectory.from_config(make_config(database)).get_current_head()
    found = find_revision(database)
    if found != needed:
        raise UnavailableError(
            f"the database schema is {found or 'empty'}, {needed} is needed: run `lbacal db upgrade`"
        )


def find_revision(database: Database) -> str | None:
    """The revision of the schema; None where there is none."""
    with database.connect() as connection:
        return MigrationContext.configure(connection).get_current_revision()
