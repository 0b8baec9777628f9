from __future__ import annotations

import os
import re
import resource
import shutil
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from importlib.resources import files
from pathlib import Path
from typing import Any

import psycopg
import pytest
from alembic import command
from alembic.script import ScriptDirectory
from fastapi.testclient import TestClient
from sqlalchemy import inspect, select, text
from sqlalchemy.exc import SQLAlchemyError

from lbacal_core.errors import BadInputError
from lbacal_core.spectra.spectra import Spectra
from service.app import make_app
from service.config import Settings
from service.errors import ConflictError, UnavailableError
from service.factory import Factory
from service.scheduler import look_for_due_work
from service.schema.tables import known_revisions, metadata
from service.storage import database as module
from service.storage.changes import Change, Evidence
from service.storage.database import Database
from service.storage.migration import (
    copy_database,
    copy_sqlite,
    find_revision,
    make_config,
    require_complete,
    require_current,
    upgrade,
)
from service.storage.processes import WORKER, read_database_clock
from service.storage.versions import Version
from service.wire.bodies import RefitBody
from tests.service.conftest import add_spectra, flat_spectra, night, tell_night, work
from validation.running.postgres import open_databases


@contextmanager
def foreign_lock(url: str) -> Iterator[None]:
    """Somebody else's session that keeps writers waiting."""
    if url.startswith("postgresql"):
        with psycopg.connect(url) as connection:
            connection.execute("LOCK TABLE event IN EXCLUSIVE MODE")
            yield
        return
    with closing(sqlite3.connect(url, isolation_level=None)) as connection:
        connection.execute("BEGIN IMMEDIATE")
        yield


def execute(database: Database, statement: str) -> None:
    with database.write() as stores:
        stores._connection.execute(text(statement))


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Waits of fractions of a second."""
    monkeypatch.setattr(module, "BUSY_S", 0.2)
    monkeypatch.setattr(module, "POOL_S", 1)
    monkeypatch.setitem(module.PATIENCE, "lock_timeout", "200ms")


@pytest.mark.usefixtures("impatient")
def test_a_foreign_lock_makes_writers_unavailable_and_keeps_no_reader_waiting(database_url: str) -> None:
    database = Database(Settings(database_url=database_url).sqlalchemy_url)
    refused: list[UnavailableError] = []

    def write() -> None:
        with pytest.raises(UnavailableError) as caught:
            execute(database, "UPDATE event SET flag = 'x'")
        refused.append(caught.value)

    with foreign_lock(database_url):
        writers = [threading.Thread(target=write) for _ in range(25)]
        for writer in writers:
            writer.start()
        for _ in range(20):
            with database.read() as stores:
                assert stores.keys.all() == []
        for writer in writers:
            writer.join()
    assert len(refused) == 25, "each is told, none fails in another way or waits for ever"
    assert all(error.is_passing for error in refused)
    execute(database, "UPDATE event SET flag = 'x'")
    database.close()


@pytest.mark.usefixtures("impatient")
def test_a_lock_answers_503_to_who_writes_and_200_to_who_reads(factory: Factory, database_url: str) -> None:
    _, key = factory.keys.create(("admin",))
    execute(factory.database, "INSERT INTO event (event_id, time_us) VALUES ('e', 0)")
    with TestClient(make_app(factory)) as client:
        client.headers["Authorization"] = f"Bearer {key}"
        ask = {"url": "/v1/events/e/flag", "json": {"flag": "x", "reason": "test"}}
        with foreign_lock(database_url), ThreadPoolExecutor(45) as pool:
            writing = [pool.submit(client.post, **ask) for _ in range(45)]
            assert [client.get(url).status_code for url in ("/healthz", "/v1/jobs")] == [200, 200]
            answers = [written.result() for written in writing]
        assert {(answer.status_code, answer.headers["retry-after"]) for answer in answers} == {(503, "5")}
        assert client.post(**ask).status_code == 200


def test_a_transaction_inside_another_is_a_part_of_it(factory: Factory) -> None:
    database = factory.database

    def write_both() -> None:
        with database.write() as outer:
            outer.keys.add("outer", ("read",), created=0, expires=None)
            with database.write() as inner:
                inner.keys.add("inner", ("read",), created=0, expires=None)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_both()
    with database.read() as stores:
        assert stores.keys.all() == []


def test_a_reader_sees_the_database_at_one_instant(factory: Factory) -> None:
    with factory.database.read() as stores:
        assert stores.keys.all() == []
        factory.keys.create(("read",))
        assert stores.keys.all() == []


def test_the_clock_of_a_database_is_the_time_of_the_day(factory: Factory) -> None:
    before = time.time()
    with factory.database.read() as stores:
        now = 1e-6 * read_database_clock(stores._connection)
    assert before - 60.0 < now < time.time() + 60.0


def test_a_reader_cannot_write(factory: Factory, database_url: str) -> None:
    if not database_url.startswith("postgresql"):
        pytest.skip("SQLite does not know reading transactions")
    with pytest.raises(UnavailableError, match="takes no writes"), factory.database.read() as stores:
        stores.keys.add("x", ("read",), created=0, expires=None)


@pytest.mark.parametrize("database_url", ["postgresql"], indirect=True)  # SQLite has no connection that could die
def test_a_question_asked_on_a_connection_that_died_is_asked_once_more(factory: Factory, database_url: str) -> None:
    assert factory.database.ask(lambda stores: stores.keys.all()) == []
    with psycopg.connect(database_url, autocommit=True) as connection:
        others = "FROM pg_stat_activity WHERE datname = current_database() AND pid <> pg_backend_pid()"
        connection.execute(f"SELECT pg_terminate_backend(pid) {others}")
    assert factory.database.ask(lambda stores: stores.keys.all()) == []


def test_a_question_of_one_statement_begins_no_transaction_and_cannot_write(
    factory: Factory, database_url: str
) -> None:
    if database_url.startswith("postgresql"):
        now = text("SELECT now() = statement_timestamp()")
        asked = [factory.database.ask(lambda s: s._connection.execute(now).scalar_one()) for _ in range(2)]
        assert asked == [True, True]
        with pytest.raises(UnavailableError, match="takes no writes"):
            factory.database.ask(lambda stores: stores.keys.add("x", ("read",), created=0, expires=None))
    else:
        assert not factory.database.ask(lambda s: s._connection.connection.driver_connection.in_transaction)


def test_an_error_of_the_program_is_not_an_absent_database(factory: Factory) -> None:
    with pytest.raises(SQLAlchemyError, match=r"SELECT 1 \+"):
        execute(factory.database, "SELECT 1 +")


def test_a_value_that_no_column_holds_was_a_failure_of_the_program(factory: Factory) -> None:
    if factory.settings.is_sqlite:
        pytest.skip("SQLite takes any text")
    with pytest.raises(BadInputError, match=r"request: expected values that the database can hold, found .*NUL"):
        factory.changes.list_all("CS\x00")
    with (
        pytest.raises(
            BadInputError, match=r"request: expected values that the database can hold, found .*out of range"
        ),
        factory.database.read() as stores,
    ):
        stores._connection.exec_driver_sql("SELECT 2147483647::integer + 1")


def test_a_dropped_table_is_another_schema(factory: Factory) -> None:
    execute(factory.database, "DROP TABLE drift_year")
    with pytest.raises(UnavailableError, match="differs from its schema in 1 places: add table drift_year"):
        require_complete(factory.database)
    with pytest.raises(UnavailableError, match="lbacal db upgrade"):
        execute(factory.database, "DELETE FROM drift_year")


def test_a_database_that_takes_no_writes_is_unavailable(factory: Factory, database_url: str) -> None:
    if database_url.startswith("postgresql"):
        name = psycopg.conninfo.conninfo_to_dict(database_url)["dbname"]
        with psycopg.connect(database_url, autocommit=True) as connection:
            connection.execute(f"ALTER DATABASE {name} SET default_transaction_read_only = on")
        factory.database.close()
    else:
        with factory.database.write() as stores:
            stores._connection.exec_driver_sql("PRAGMA query_only = ON")
    with pytest.raises(UnavailableError, match="the database"):
        factory.keys.create(("read",))


def test_a_full_disk_is_named(factory: Factory, database_url: str) -> None:
    if database_url.startswith("postgresql"):
        pytest.skip("needs a disk of its own")
    with factory.database.write() as stores:
        pages = stores._connection.exec_driver_sql("PRAGMA page_count").scalar_one()
        stores._connection.exec_driver_sql(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(UnavailableError, match="the disk of the database is full"):
        execute(factory.database, "CREATE TABLE filler AS SELECT randomblob(1000000) AS x")


def test_a_removed_sqlite_file_takes_no_more_writes(tmp_path: Path, sqlite_template: Path) -> None:
    path = tmp_path / "lbacal.sqlite"
    path.write_bytes(sqlite_template.read_bytes())
    factory = Factory(Settings(database_url=str(path)))
    factory.keys.create(("read",))
    path.unlink()
    with pytest.raises(UnavailableError, match="removed or replaced") as caught:
        factory.keys.create(("read",))
    assert str(path) not in str(caught.value)
    assert str(path) in caught.value.detail
    factory.database.close()


def test_an_absent_server_is_told_without_its_name(tmp_path: Path) -> None:
    database = Database(Settings(database_url=f"postgresql://someone@/secret?host={tmp_path}").sqlalchemy_url)
    with pytest.raises(UnavailableError) as caught, database.read():
        pass
    assert str(caught.value) == "the database does not answer"
    assert str(tmp_path) in caught.value.detail
    assert caught.value.is_passing
    database.close()


def test_a_password_may_hold_any_character(postgres: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with psycopg.connect(postgres, autocommit=True) as connection:
        rules = Path(connection.execute("SHOW hba_file").fetchone()[0])
        if not os.access(rules, os.W_OK):
            pytest.skip("needs a server whose rules of access can be changed")
        rules.write_text(f"local all secret scram-sha-256\n{rules.read_text()}")
        connection.execute("CREATE ROLE secret LOGIN PASSWORD 'p@s:s/w%'")
        connection.execute("SELECT pg_reload_conf()")
    plain = postgres.replace("//lbacal@", "//secret@")
    written = postgres.replace("//lbacal@", "//secret:p%40s%3As%2Fw%25@")
    for url, password in ((plain, "p@s:s/w%"), (written, "")):
        monkeypatch.setenv("PGPASSWORD", password)
        database = Database(Settings(database_url=url).sqlalchemy_url)
        database.ping()
        database.close()
    refused = Database(Settings(database_url=plain).sqlalchemy_url)
    monkeypatch.setenv("PGPASSWORD", "wrong")
    with pytest.raises(UnavailableError, match="does not answer"):
        refused.ping()
    refused.close()


def test_the_migrations_make_the_schema_that_the_code_states(factory: Factory) -> None:
    command.check(make_config(factory.database))
    found = inspect(factory.database.engine)  # Alembic compares no keys
    for table in metadata.sorted_tables:
        key = found.get_pk_constraint(table.name)["constrained_columns"]
        assert key == [column.name for column in table.primary_key], table.name


@pytest.mark.long
def test_an_upgrade_can_be_run_again(factory: Factory) -> None:
    upgrade(factory.database)
    require_current(factory.database)


OLD_CUTS = (
    "CREATE TABLE window_cut (id INT, station TEXT, antenna INT,date_us INT,sigma_us INT,made_us INT,lifted_us INT)",
    'CREATE TABLE cut_decision (id INTEGER, cut INTEGER, act TEXT, at_us BIGINT, "by" TEXT, reason TEXT)',
    "INSERT INTO window_cut VALUES (1, 'CS002', 2, 10, 5, 30, NULL), (2, 'CS002', 3, 20, 5, 30, 40)",
    "INSERT INTO cut_decision VALUES (1, 1, 'restored', 31, 'me', 'x'), (2, 1, 'lifted', 32, 'me', 'snow')",
)


LATER = (
    "DROP INDEX ix_alarm_station_id",
    "DROP INDEX ix_spectrum_far",
    "ALTER TABLE spectrum DROP COLUMN far",
    "ALTER TABLE receipt DROP COLUMN warnings",
    "ALTER TABLE promotion DROP COLUMN undoes_us",
)


def test_a_database_of_revision_0021_loses_caches_and_no_fact(factory: Factory, stored: dict[str, Version]) -> None:
    execute(factory.database, "DROP TABLE sums")
    for name in ("kept_fit", "drift_source", "event_modes", "monthly_ratio"):
        execute(factory.database, f"CREATE TABLE {name} (x INTEGER)")
    for name in ("event_station", "session", "change_decision", "change_evidence", "change"):
        execute(factory.database, f"DROP TABLE {name}")
    for statement in ("DROP INDEX ix_job_work", "ALTER TABLE job DROP COLUMN called_for", *LATER, *OLD_CUTS):
        execute(factory.database, statement)
    execute(factory.database, "UPDATE alembic_version SET version_num = '0021'")
    upgrade(factory.database)
    require_current(factory.database)
    require_complete(factory.database)
    with factory.database.read() as stores:
        assert stores.versions.get_many(one.id for one in stored.values()).keys() == {one.id for one in stored.values()}
        kept = [
            (one.number, one.change.antennas, one.change.date, one.decision, one.ended) for one in stores.changes.kept()
        ]
    assert kept == [(1, [2], 10, "dismissed", None), (2, [3], 20, "in_force", 40)]
    with factory.database.write() as stores:
        found = Change("CS002", ((4, None),), "step", 10**15, 5)
        assert stores.changes.note(found, Evidence("drift", "", 9.0, 50)).number > 2


def test_an_old_schema_is_refused_with_the_cure(factory: Factory, client: TestClient) -> None:
    with factory.database.write() as stores:
        stores.processes.see("worker", WORKER, None)
    assert client.get("/readyz").status_code == 200
    execute(factory.database, "UPDATE alembic_version SET version_num = '0021'")
    with pytest.raises(UnavailableError, match="run `lbacal db upgrade`"):
        require_current(factory.database)
    answer = client.get("/readyz", headers={"Authorization": ""})
    assert (answer.status_code, answer.headers["retry-after"]) == (503, "5")


LATER_REVISION = """
from alembic import op

revision, down_revision, branch_labels, depends_on = "9998", "{newest}", None, None


def upgrade():
    op.execute("CREATE TABLE counted AS SELECT count(*) AS spectra FROM spectrum")
"""


def test_an_upgrade_under_load_waits_for_who_writes_and_stops_who_comes_after(factory: Factory, tmp_path: Path) -> None:
    """A process that nobody had stopped wrote on as if nothing had happened, into tables of which it knew nothing."""
    scripts = Path(shutil.copytree(str(files("migrations")), tmp_path / "migrations"))
    (scripts / "versions" / "9998_later.py").write_text(LATER_REVISION.format(newest=known_revisions()[-1]))
    other = Database(factory.database.url)
    config = make_config(other)
    config.set_main_option("script_location", str(scripts))
    acknowledged, refused, is_writing = [0], list[str](), threading.Event()

    def write() -> None:
        while not refused:
            rows = [
                (f"{acknowledged[0]}-{k}", 1.4e9 + 60.0 * (9 * acknowledged[0] + k), "CS001", 0, "X") for k in range(9)
            ]
            try:
                with factory.database.write() as stores:
                    stores.spectra.add(flat_spectra(*rows))
                    time.sleep(0.01)  # the lock is taken while somebody writes
            except UnavailableError as error:
                refused.append(str(error))
            else:
                acknowledged[0] += 1
                is_writing.set()
                time.sleep(0.01)  # SQLite has no queue: who comes again at once may keep another waiting for 30 s

    writer = threading.Thread(target=write, daemon=True)
    writer.start()
    assert is_writing.wait(30)
    command.upgrade(config, "head")
    writer.join(30)
    assert len(refused) == 1
    assert "install the newer one" in refused[0]
    with other.engine.connect() as connection:
        counted = connection.exec_driver_sql("SELECT spectra FROM counted").scalar_one()
        stored = connection.exec_driver_sql("SELECT count(*) FROM spectrum").scalar_one()
    assert counted == stored == 9 * acknowledged[0]
    other.close()


@pytest.mark.parametrize(("revision", "cure"), [("0020", "start a new database"), ("9999", "install the newer one")])
def test_a_schema_that_this_version_does_not_know_is_refused(factory: Factory, revision: str, cure: str) -> None:
    with factory.database.engine.begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = :revision"), {"revision": revision})
    for ask in (upgrade, require_current):
        with pytest.raises(UnavailableError, match=cure):
            ask(factory.database)


def test_files_of_migrations_begin_with_their_revisions_and_make_one_row(tmp_path: Path) -> None:
    """Every process reads the newest from their names, without loading Alembic."""
    database = Database(f"sqlite:///{tmp_path / 'empty.sqlite'}")
    database.make_file()
    scripts = ScriptDirectory.from_config(make_config(database)).walk_revisions()
    assert list(known_revisions()) == [one.revision for one in scripts][::-1]
    assert find_revision(database) is None
    upgrade(database)
    assert find_revision(database) == known_revisions()[-1]
    database.close()


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
    assert (first["revision"], len(first["calibration"]), len(first["api_key"])) == ([("0033",)], len(stored), 1)
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


@pytest.mark.usefixtures("needs_postgres", "stored")
def test_a_database_is_copied_into_one_of_the_other_kind_where_the_service_goes_on(factory: Factory) -> None:
    add_spectra(factory, flat_spectra(("a", 1.4e9, "CS001", 0, "X"), ("b", 1.4e9 + 60, "CS001", 0, "X")))
    factory.refits.request(REFIT, "somebody")
    kind = "postgresql" if factory.settings.is_sqlite else "sqlite"
    with open_databases(kind, "copied") as (url,):
        copy = Factory(Settings(database_url=url, instrument=factory.settings.instrument), factory.clock)
        rows = copy_database(factory.database, copy.database)
        first, second = (read_all(one.database) for one in (factory, copy))
        assert second == first
        assert rows == sum(map(len, first.values()))
        assert [len(first[name]) for name in ("spectrum", "calibration", "job")] == [2, 5, 1]
        assert copy.refits.request(REFIT, "somebody") == 2, "numbers go on"
        add_spectra(copy, flat_spectra(("c", 1.4e9 + 120, "CS001", 1, "Y")))
        with pytest.raises(ConflictError, match="not empty"):
            copy_database(factory.database, copy.database)
        assert len(read_all(copy.database)["spectrum"]) == 3
        copy.database.close()


REFIT = RefitBody(scope="antenna", since="2014-01-01", until="2015-01-01", reason="test")


def read_all(database: Database) -> dict[str, list[tuple[Any, ...]]]:
    """Every row that is copied, by table."""
    with database.connect() as connection:
        return {
            table.name: sorted((tuple(row) for row in connection.execute(select(table))), key=repr)
            for table in metadata.sorted_tables
            if table.name != "process"
        }


@pytest.mark.long
def test_a_backup_in_the_middle_of_a_night_is_restored_on_an_empty_machine_where_the_night_ends(
    make_service: Callable[..., Factory], campaign: Spectra, tmp_path: Path
) -> None:
    few = campaign.select((campaign.antenna < 2) & (campaign.time_unix < YEAR_END))
    more = {"lease_s": 2.0, "nightly_investigations": True}
    first = make_service(few, **more)
    look_for_due_work(first)
    worker = threading.Thread(target=work, args=(first,))
    worker.start()
    while first.database.look(lambda stores: stores.jobs.count_by_state(0)).get("done", 0) == 0:
        time.sleep(0.01)
    with open_databases("sqlite" if first.settings.is_sqlite else "postgresql", "restored") as (url,):
        if first.settings.is_sqlite:
            copy_sqlite(first.settings.sqlalchemy_url, Path(url))
        else:
            dump = tmp_path / "backup.dump"
            run_client("pg_dump", "--format=custom", f"--file={dump}", first.settings.database_url)
            run_client("pg_restore", "--exit-on-error", "--no-owner", f"--dbname={url}", str(dump))
        worker.join()
        second = make_service(None, database_url=url, **more)
        require_complete(second.database)
        assert second.database.look(lambda stores: stores.jobs.count_open()) > 0, "the night was not over"
        time.sleep(2.0)  # whoever held a part there is dead
        night(second)
        whole, restored = tell_night(first), tell_night(second)
        assert {**restored, "attempts": 0} == {**whole, "attempts": 0}
        assert len(whole["versions"]) == len({name for name, _ in whole["versions"]}) > 4
        second.database.close()


YEAR_END = 1_420_070_400.0


def run_client(program: str, *arguments: str) -> None:
    """Run a program of PostgreSQL's client."""
    found = shutil.which(program)
    if found is None:
        pytest.skip("needs the programs of PostgreSQL's client")
    subprocess.run([found, *arguments], check=True)


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
            before = len(factory.database.look(lambda stores: stores.keys.all()))
            assert copy_sqlite(factory.settings.sqlalchemy_url, tmp_path / f"{k}.sqlite") > 0
            with closing(sqlite3.connect(tmp_path / f"{k}.sqlite")) as copied:
                assert copied.execute("SELECT count(*) FROM api_key").fetchone()[0] >= before
    finally:
        is_over.set()
        writer.join()
    assert sorted(path.suffix for path in tmp_path.glob("?.sqlite*")) == [".sqlite"] * 5, "nothing stands beside a copy"


def test_a_copy_to_a_full_disk_left_its_journal_behind(sqlite_template: Path, tmp_path: Path) -> None:
    (tmp_path / "copy").mkdir()
    whole = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (sqlite_template.stat().st_size // 2, whole[1]))
    try:
        with pytest.raises(UnavailableError, match="could not be copied"):
            copy_sqlite(f"sqlite:///{sqlite_template}", tmp_path / "copy" / "x.sqlite")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, whole)
    assert list((tmp_path / "copy").iterdir()) == []


def test_a_copy_of_nothing_or_of_another_database_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnavailableError, match="run `lbacal db upgrade`"):
        copy_sqlite(f"sqlite:///{tmp_path}/none.sqlite", tmp_path / "x")
    with pytest.raises(BadInputError, match="pg_dump"):
        copy_sqlite("postgresql+psycopg://me@here/x", tmp_path / "x")
    (tmp_path / "half.sqlite").write_bytes(b"no database " * 1000)
    with pytest.raises(UnavailableError, match="could not be copied"):
        copy_sqlite(f"sqlite:///{tmp_path}/half.sqlite", tmp_path / "x")
    (tmp_path / "empty.sqlite").touch()
    with pytest.raises(UnavailableError, match="the database is empty: correct LBACAL_DATABASE_URL"):
        copy_sqlite(f"sqlite:///{tmp_path}/empty.sqlite", tmp_path / "x")
    assert not (tmp_path / "x").exists()


def test_an_empty_database_replaces_no_backup(sqlite_template: Path, tmp_path: Path) -> None:
    for _ in range(2):  # every night into the same file
        assert copy_sqlite(f"sqlite:///{sqlite_template}", tmp_path / "x") > 0
    before = (tmp_path / "x").read_bytes()
    (tmp_path / "typo.sqlite").touch()
    with pytest.raises(UnavailableError, match="is empty"):
        copy_sqlite(f"sqlite:///{tmp_path}/typo.sqlite", tmp_path / "x")
    assert (tmp_path / "x").read_bytes() == before


def test_only_an_upgrade_makes_a_file(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path / 'typo' / 'x.sqlite'}")
    questions: tuple[Callable[[], Any], ...] = (
        lambda: database.write().__enter__(),
        lambda: database.look(lambda stores: stores.keys.all()),
        lambda: require_current(database),
    )
    for ask in questions:
        with pytest.raises(UnavailableError, match="no database there: correct LBACAL_DATABASE_URL, or run") as told:
            ask()
        assert told.value.detail == str(tmp_path / "typo" / "x.sqlite")
    assert list(tmp_path.iterdir()) == []
    upgrade(database)
    require_current(database)
    database.close()
