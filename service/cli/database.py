"""`lbacal db` and `lbacal keys`: for whoever keeps the database."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lbacal.cli.outputs import Json, require_outputs, show, show_each
from lbacal.instants import format_instant, format_optional

if TYPE_CHECKING:
    from service.factory import Factory

db = typer.Typer(help="The database's schema. Example: lbacal db upgrade", no_args_is_help=True)
keys = typer.Typer(help="API keys. Example: lbacal keys create --scope spectra:write", no_args_is_help=True)


@db.command()
def upgrade() -> None:
    """Bring the schema to what this version needs.

    Example: LBACAL_DATABASE_URL=postgresql://lbacal@db/lbacal lbacal db upgrade
    """
    from service.cli.opening import wait_for_database
    from service.storage import migration

    factory = _factory()
    database = factory.database
    wait_for_database(database, factory.settings.wait_s)
    migration.upgrade(database)
    print(f"schema {migration.find_revision(database)}")


@db.command()
def check() -> None:
    """Exit 0 if the database answers and has the schema this version needs, table by table, else 1.

    Example: lbacal db check
    """
    from service.storage import migration

    database = _factory().database
    migration.require_current(database)
    migration.require_complete(database)
    print(f"schema {migration.find_revision(database)}, as needed")


@db.command()
def backup(output: Annotated[Path, typer.Argument(help="File to write.")]) -> None:
    """Copy an SQLite database into a file, while the service runs; for PostgreSQL there is pg_dump.

    Example: lbacal db backup backup.sqlite
    """
    from service.storage.migration import copy_sqlite

    settings = _factory().settings
    require_outputs({"OUTPUT": output}, {"LBACAL_DATABASE_URL": settings.database_url if settings.is_sqlite else None})
    size = copy_sqlite(settings.sqlalchemy_url, output)
    print(f"wrote {output}: {size:,} bytes, checked")


@db.command()
def copy(
    target: Annotated[str, typer.Argument(help="Database to fill: a file, or postgresql://user@host/name.")],
) -> None:
    """Copy everything into an empty database, from SQLite to PostgreSQL or back; stop the service first.

    Example: lbacal db copy postgresql://lbacal@127.0.0.1/lbacal
    """
    from service.config import Settings
    from service.storage.database import Database
    from service.storage.migration import copy_database

    copied = copy_database(_factory().database, Database(Settings(database_url=target).sqlalchemy_url))
    print(f"{copied:,} rows copied: set LBACAL_DATABASE_URL to the copy")


@db.command()
def repair_clock() -> None:
    """Move promotions, tags and models that a server's clock ahead wrote to now, by the database's clock, in order.

    Example: lbacal db repair-clock

    Until the instant of the last of them nothing can be promoted. Every line that was moved is printed.
    """
    with _factory().database.write() as stores:
        moved = stores.ledger.repair_clock()
    for was, at in moved.items():
        print(f"{format_instant(was)} -> {format_instant(at)}")
    print(f"{len(moved)} instants were ahead of the database's clock")


@keys.command()
def create(
    scope: Annotated[list[str], typer.Option(help="read, spectra:write, refits:run, calibrations:promote or admin.")],
    expires: Annotated[float | None, typer.Option(help="Days until the key ends; without it, never.")] = None,
    name: Annotated[str | None, typer.Option(help="Who or what uses it; stands beside what is done with it.")] = None,
    as_json: Json = False,
) -> None:
    """Make a key and print it, alone on the last line; it cannot be shown again.

    Example: lbacal keys create --scope spectra:write --expires 365 --name "pipeline of CS002"
    """
    number, text = _factory().keys.create(tuple(scope), expires, name)
    told = f"key {number} with scope {', '.join(scope)}; keep it now, it is not shown again:\n{text}"
    show({"number": number, "scopes": scope, "text": text}, lambda _: print(told), as_json=as_json)


@keys.command(name="list")
def list_keys(as_json: Json = False) -> None:
    """List keys, without their texts.

    Example: lbacal keys list
    """
    found = [
        vars(key) | {name: format_optional(getattr(key, name)) for name in ("created", "expires", "revoked")}
        for key in _factory().database.look(lambda stores: stores.keys.all())
    ]
    show_each(found, _print_key, "no keys", as_json=as_json)


def _print_key(key: dict[str, Any]) -> None:
    revoked = f", revoked {key['revoked']}" if key["revoked"] else ""
    named = f" {key['name']}:" if key["name"] else ""
    ends = f"expires {key['expires'] or 'never'}{revoked}"
    print(f"{key['number']}:{named} {', '.join(key['scopes'])}; made {key['created']}, {ends}")


@keys.command()
def revoke(number: Annotated[int, typer.Argument(metavar="ID", help="Number of the key.")]) -> None:
    """Close a key for good.

    Example: lbacal keys revoke 3
    """
    _factory().keys.revoke(number)
    print(f"key {number} is revoked")


def _factory() -> Factory:
    from service.config import read_settings
    from service.factory import Factory

    return Factory(read_settings())
