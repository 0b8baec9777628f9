"""What is asked of a small ledger reads as little of one that years of nights have made large."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import Engine, event
from sqlalchemy.pool import Pool

from lbacal.instants import DAY_US, parse_instant
from lbacal_core.curves.validity import Promotion, Scope
from service.factory import Factory
from service.storage.versions import Version
from tests.service.conftest import new_version
from validation.running.ledger import write_promotions

PATHS = [Scope(station, antenna, dipole) for station in ("CS001", "CS002") for antenna in range(3) for dipole in "XY"]
PATH = {"station": "CS001", "antenna": 0, "dipole": "X"}
YEAR = {"valid_from": parse_instant("", "2014-01-01"), "valid_to": parse_instant("", "2015-01-01")}
NIGHTS = 1000
INTERVALS = 8000


class Reading:
    """Statements sent, and rows that the drivers fetched."""

    def __init__(self) -> None:
        self.statements = 0
        self.rows = 0


@contextmanager
def reading() -> Iterator[Reading]:
    """Count what is read from the database."""
    found = Reading()

    def count(row: Sequence[Any]) -> tuple[Any, ...]:
        found.rows += 1
        return tuple(row)

    def begin(connection: Any, _record: Any, _proxy: Any) -> None:
        is_sqlite = "sqlite3" in type(connection).__module__
        connection.row_factory = (lambda _, row: count(row)) if is_sqlite else (lambda _: count)

    def end(connection: Any, _record: Any) -> None:
        connection.row_factory = None if "sqlite3" in type(connection).__module__ else lambda _: tuple

    def send(*_: Any) -> None:
        found.statements += 1

    hooks: list[tuple[Any, str, Callable[..., None]]] = [
        (Pool, "checkout", begin), (Pool, "checkin", end), (Engine, "before_cursor_execute", send)
    ]  # fmt: skip
    for hook in hooks:
        event.listen(*hook)
    try:
        yield found
    finally:
        for hook in hooks:
            event.remove(*hook)


def grow(factory: Factory, versions: dict[Scope, list[Version]]) -> None:
    """20,000 promotions: of each path the same year once a night, of one path other intervals besides."""
    first = PATHS[0]
    rows = [(path, *YEAR.values(), versions[path][night % 2].id) for night in range(NIGHTS) for path in PATHS]
    for k in range(INTERVALS):
        since = YEAR["valid_from"] + (k % 4000) * DAY_US // 20
        rows.append((first, since, since + DAY_US * (1 + k % 7), versions[first][k % 2].id))
    made = [
        Promotion(0, path, since, until, name, k, "test", "night") for k, (path, since, until, name) in enumerate(rows)
    ]
    write_promotions(factory, made)


def ask_everything(client: TestClient, new: Version) -> dict[str, Reading]:
    """What each kind of request reads."""
    get = {
        "gap": ({"at": "2030-06-01", **PATH}, 404),
        "gap of all": ({"at": "2030-06-01"}, 404),
        "gap in the past": ({"at": "1990-06-01", "as_of": "2019-01-01"}, 404),
        "held": ({"at": "2030-06-01", "gap": "hold"}, 200),
        "in effect": ({"at": "2014-06-01"}, 200),
    }
    found = {}
    for name, (params, status) in get.items():
        with reading() as found[name]:
            assert client.get("/v1/calibrations/effective", params=params).status_code == status
    for name, url in {"version": f"/v1/calibrations/{new.id}", "page of a version": f"/calibrations/{new.id}"}.items():
        with reading() as found[name]:
            assert client.get(url).status_code == 200
    for scope in ("station", "path"):
        stated = PATH if scope == "path" else {"station": "CS001"}
        body = {"calibration": None, **stated, "valid_from": "2016-01-01", "valid_to": "2017-01-01", "reason": "x"}
        for params in ({"dry_run": "true"}, {}):
            with reading() as found[f"promotion, {scope} {params}"]:
                assert client.post("/v1/promotions", json=body, params=params).is_success
    return found


@pytest.fixture
def versions(factory: Factory) -> dict[Scope, list[Version]]:
    made = {path: [new_version(path, f"{path.key} {k}", 1.0 + k / 100) for k in range(2)] for path in PATHS}
    with factory.database.write() as stores:
        stores.versions.add([version for of_path in made.values() for version in of_path])
        stores.ledger.append(
            [Promotion(0, path, *YEAR.values(), of_path[0].id, 0) for path, of_path in made.items()], lambda: 1
        )
    return made


def test_a_gap_a_version_and_a_promotion_read_no_more_after_20_000_promotions(
    factory: Factory, client: TestClient, versions: dict[Scope, list[Version]]
) -> None:
    """A question in a gap, without a key, read every promotion of all paths: 13 s and 0.5 GB after four years."""
    new = versions[PATHS[0]][0]
    first, again = ask_everything(client, new), ask_everything(client, new)
    grow(factory, versions)
    first_of_many, again_of_many = ask_everything(client, new), ask_everything(client, new)
    assert again["gap"].rows > 0
    # a question is answered from memory the second time: what is compared was asked as often since the last change
    for small, large in ((first, first_of_many), (again, again_of_many)):
        for name, found in large.items():
            before = small[name]
            shown = 100 if name == "page of a version" else 0
            assert found.rows <= before.rows + shown + 5, name
            assert found.statements <= before.statements + 2, name


@pytest.mark.long
def test_the_changes_of_a_promotion_over_a_year_of_nights_read_each_interval_once(
    factory: Factory, client: TestClient, versions: dict[Scope, list[Version]]
) -> None:
    grow(factory, versions)
    other = {"station": "CS002", "antenna": 2, "dipole": "Y"}
    body = {"calibration": None, **other, "valid_from": "2014-01-01", "reason": "x"}
    with reading() as found:
        (change,) = client.post("/v1/promotions", json=body).json()["changes"]
    assert (change["from"], change["to"]) == ("2014-01-01T00:00:00Z", "2015-01-01T00:00:00Z")
    assert found.rows < 20
    assert found.statements < 20


def test_what_a_promotion_changes_is_worked_out_before_anybody_has_to_wait(
    factory: Factory, client: TestClient, versions: dict[Scope, list[Version]]
) -> None:
    """16 s of work were done with SQLite's write lock, or the lock of all promoters."""
    body = {"calibration": versions[PATHS[0]][1].id, "valid_from": "2014-01-01", "reason": "x"}
    sent: list[str] = []

    def note(_connection: Any, _cursor: Any, statement: str, *_: Any) -> None:
        sent.append(" ".join(statement.split()))

    event.listen(factory.database.engine, "before_cursor_execute", note)
    assert client.post("/v1/promotions", json=body).status_code == 201
    event.remove(factory.database.engine, "before_cursor_execute", note)
    assert any("INSERT INTO promotion" in statement for statement in sent)
    assert not [statement for statement in sent if "curves" in statement or "GROUP BY" in statement]


@pytest.mark.long
def test_the_pages_show_what_is_in_effect_and_not_what_was_replaced_night_by_night(
    factory: Factory, client: TestClient
) -> None:
    """After a year of nights the page of a station was 11 MB: a row for each of 35,000 versions."""
    paths = [path for path in PATHS if path.station == "CS001"]
    pages = ["/stations/CS001", "/drift", "/v1/drift?station=CS001", "/v1/drift", "/"]
    rows = []
    for night in range(30):
        at, scopes = parse_instant("made", "2019-12-31") + night, (*paths, Scope("CS001"), Scope())
        made = [new_version(scope, f"{scope.key} {night}", made=at) for scope in scopes]
        waiting = [new_version(scope, f"{scope.key} waits {night}", made=at) for scope in paths]
        with factory.database.write() as stores:
            stores.versions.add([*made, *waiting])
            stores.ledger.append([Promotion(0, v.scope, *YEAR.values(), v.id, 0) for v in made], lambda: 1)
        for url in pages:
            with reading() as found:
                answer = client.get(url)
            assert answer.status_code == 200
            rows.append((url, found.rows))
            if url == pages[0]:
                shown = set(re.findall(r"/calibrations/([0-9a-f]{64})", answer.text))
                assert shown == {version.id for version in made if version.scope.station == "CS001"}
    # the newest ten versions and promotions are on the overview: it is full from the second night
    assert set(rows[5:10]) == set(rows[-5:])
