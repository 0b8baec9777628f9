from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sqlalchemy import Engine, event

from lbacal.instants import read_clock
from lbacal_core.curves.covariance import Budget, BudgetTerm, parse_budget
from lbacal_core.curves.validity import Promotion, Scope
from service.errors import NotFoundError, UnavailableError
from service.factory import Factory
from service.storage.ledger import Neighbours
from tests.oracles import answer_path
from tests.service.conftest import new_version
from validation.running.ledger import write_promotions

PATHS = tuple(Scope("CS001", a, d) for a in (0, 1) for d in "XY")
SCOPES = (*PATHS, Scope("CS001"), Scope("CS002"), Scope())
NAMES = ("a", "b", "c")


@dataclass(frozen=True)
class Line:
    """One line of the ledger as the oracle sees it: plain tuples, no code of the ledger."""

    number: int
    scope: tuple[str | None, int | None, str | None]
    start: int
    end: int | None
    version: str | None
    at: int


def brute_force(lines: list[Line], path: Scope, instant: int, as_of: int | None) -> tuple[int, str] | None:
    """Read the whole ledger from its start, overwriting: what stands at the end answers, narrowest first."""
    standing: dict[tuple[str | None, int | None, str | None], Line] = {}
    for line in sorted(lines, key=lambda line: (line.at, line.number)):
        is_known = as_of is None or line.at <= as_of
        if is_known and line.start <= instant and (line.end is None or instant < line.end):
            standing[line.scope] = line
    for scope in ((path.station, path.antenna, path.dipole), (path.station, None, None), (None, None, None)):
        line = standing.get(scope)
        if line is not None and line.version is not None:
            return line.number, line.version
    return None


def brute_force_neighbours(
    lines: list[Line], path: Scope, instant: int, as_of: int | None
) -> tuple[tuple[int, int, str] | None, tuple[int, int, str] | None]:
    """Ask at every instant in turn, away from the gap: (end, number, version) before it, (start, ...) after it."""
    last = max((line.end or line.start for line in lines), default=0) + 1
    asked = {t: brute_force(lines, path, t, as_of) for t in range(min(instant, 0), max(instant, last) + 1)}
    before = next(((t + 1, *asked[t]) for t in sorted(asked, reverse=True) if t < instant and asked[t]), None)
    after = next(((t, *asked[t]) for t in sorted(asked) if t > instant and asked[t]), None)
    return before, after


def fill(factory: Factory, names: tuple[str, ...]) -> dict[str, str]:
    versions = {name: new_version(Scope(), name) for name in names}
    with factory.database.write() as stores:
        stores.versions.add(list(versions.values()))
    return {name: version.id for name, version in versions.items()}


@pytest.fixture
def version(factory: Factory) -> str:
    return fill(factory, ("a",))["a"]


def append(factory: Factory, scope: Scope, start: int, end: int | None, version: str | None, at: int) -> Line:
    with factory.database.write() as stores:
        made = stores.ledger.append([Promotion(0, scope, start, end, version, 0)], lambda: at)[0]
    return Line(made.number, (scope.station, scope.antenna, scope.dipole), start, end, version, made.at)


promotions = st.tuples(
    st.sampled_from(SCOPES), st.integers(0, 9), st.one_of(st.none(), st.integers(1, 9)),
    st.sampled_from([None, *NAMES]), st.integers(1000, 1010),
)  # fmt: skip
Wanted = list[tuple[Scope, int, int | None, str | None, int]]
examples = partial(settings, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def start_again(factory: Factory) -> dict[str, str]:
    """The versions that promotions name, of a ledger that is empty."""
    with factory.database.engine.begin() as connection:
        for table in ("edge", "standing", "promotion"):
            connection.exec_driver_sql(f"DELETE FROM {table}")  # noqa: S608 - those above
    return fill(factory, NAMES)


def append_all(factory: Factory, wanted: Wanted) -> list[Line]:
    """A ledger of these promotions alone."""
    ids = start_again(factory)
    return [
        append(factory, scope, start, None if length is None else start + length, ids.get(str(name)), at)
        for scope, start, length, name, at in wanted
    ]


@given(st.lists(promotions, max_size=15))
@examples(max_examples=25)
def test_the_edges_known_at_any_time_are_those_of_the_whole_ledger(factory: Factory, wanted: Wanted) -> None:
    lines = append_all(factory, wanted)
    for as_of in {line.at + d for line in lines for d in (-1, 0)}:
        ends: dict[str | None, set[int]] = {}
        for line in lines:
            if line.at <= as_of:
                ends.setdefault(line.scope[0], set()).update({line.start} | ({line.end} - {None}))
        with factory.database.read() as stores:
            assert stores.ledger.edges(as_of) == ends


@pytest.mark.long
@given(st.lists(promotions, max_size=15), st.integers(-2, 20), st.one_of(st.none(), st.integers(999, 1008)))
@examples(max_examples=150)
def test_the_neighbours_of_a_gap_are_those_of_brute_force(
    factory: Factory, wanted: Wanted, instant: int, as_of: int | None
) -> None:
    ids = start_again(factory)
    made = [
        Promotion(k + 1, scope, start, None if length is None else start + length, ids.get(str(name)), 1000 + k // 2)
        for k, (scope, start, length, name, _) in enumerate(wanted)
    ]
    if made:
        write_promotions(factory, made)
    lines = [Line(p.number, (p.scope.station, p.scope.antenna, p.scope.dipole), p.valid_from, p.valid_to,
                  p.calibration, p.at) for p in made]  # fmt: skip
    silent = [path for path in PATHS if brute_force(lines, path, instant, as_of) is None]
    by_scope = [scope for scope in SCOPES if not any(_answers_alone(lines, scope, instant, as_of))]
    with factory.database.read() as stores:
        of_paths = stores.ledger.neighbours({path: path.widening for path in silent}, instant, as_of)
        of_scopes = stores.ledger.neighbours({scope: (scope,) for scope in by_scope}, instant, as_of)
    for path, found in of_paths.items():
        assert _plain(found) == brute_force_neighbours(lines, path, instant, as_of)
    for scope, found in of_scopes.items():
        alone = [line for line in lines if line.scope == (scope.station, scope.antenna, scope.dipole)]
        assert _plain(found) == brute_force_neighbours(alone, scope, instant, as_of)


def _answers_alone(lines: list[Line], scope: Scope, instant: int, as_of: int | None) -> tuple[int | str, ...]:
    alone = [line for line in lines if line.scope == (scope.station, scope.antenna, scope.dipole)]
    return brute_force(alone, scope, instant, as_of) or ()


def _plain(found: Neighbours) -> tuple[tuple[int, int, str | None] | None, ...]:
    return tuple(one and (one.instant, one.promotion.number, one.promotion.calibration) for one in found)


def test_a_long_ledger_answers_as_brute_force_does(factory: Factory) -> None:
    rng = np.random.default_rng(20140501)
    ids = list(fill(factory, NAMES).values())
    lines = []
    for _ in range(40):
        wanted = []
        for _ in range(25):
            start = int(rng.integers(0, 1000))
            end = None if rng.random() < 0.1 else start + int(rng.integers(1, 400))
            version = None if rng.random() < 0.15 else ids[rng.integers(len(ids))]
            wanted.append(Promotion(0, SCOPES[rng.integers(len(SCOPES))], start, end, version, 0))
        with factory.database.write() as stores:
            for made in stores.ledger.append(wanted, lambda: int(rng.integers(1000, 3000))):
                scope = (made.scope.station, made.scope.antenna, made.scope.dipole)
                lines.append(Line(made.number, scope, made.valid_from, made.valid_to, made.calibration, made.at))
    for _ in range(100):
        line = lines[rng.integers(len(lines))]
        instant = int(rng.choice([line.start, line.start - 1, line.end or 5000, (line.end or 5000) - 1]))
        as_of = None if rng.random() < 0.2 else line.at + int(rng.integers(-1, 2))
        with factory.database.read() as stores:
            answers = stores.ledger.answers(PATHS, instant, as_of)
        for path, said in answers.items():
            found = (said[-1].number, said[-1].calibration) if said and said[-1].calibration else None
            assert found == brute_force(lines, path, instant, as_of)


def test_a_promotion_is_later_than_every_one_before_even_if_the_clock_goes_back(factory: Factory, version: str) -> None:
    first = append(factory, Scope(), 0, None, version, 5000)
    second = append(factory, Scope(), 0, None, None, 4000)
    assert (first.at, second.at) == (5000, 5001)


def test_promotions_at_once_are_ordered_and_never_share_an_instant(factory: Factory, version: str) -> None:
    with ThreadPoolExecutor(4) as pool:
        lines = list(pool.map(lambda k: append(factory, Scope(), 0, k + 1, version, 1000), range(24)))
    assert len({line.at for line in lines}) == 24
    assert [line.number for line in sorted(lines, key=lambda line: line.at)] == sorted(line.number for line in lines)


def test_the_promotions_of_one_act_share_their_instant(factory: Factory, version: str) -> None:
    with factory.database.write() as stores:
        made = stores.ledger.append([Promotion(0, path, 0, None, version, 0) for path in PATHS], lambda: 1000)
    assert {promotion.at for promotion in made} == {1000}
    assert [promotion.scope for promotion in made] == list(PATHS)


def test_a_promotion_of_an_unknown_version_is_refused(factory: Factory) -> None:
    with pytest.raises(Exception, match=r"(?i)foreign key"):
        append(factory, Scope(), 0, None, "nothing", 1000)


def test_a_promotion_that_was_paused_before_its_commit_is_not_made(factory: Factory, version: str) -> None:
    clock = iter([1_000_000_000, 1_075_000_000])  # 75 s pass between the clock and the commit
    with pytest.raises(UnavailableError, match="took too long"), factory.database.write() as stores:
        stores.ledger.append([Promotion(0, Scope(), 0, None, version, 0)], lambda: next(clock))
    with factory.database.read() as stores:
        assert stores.ledger.newest_number() == 0


def test_a_promoter_that_hangs_loses_its_transaction(factory: Factory, version: str) -> None:
    if factory.settings.is_sqlite:
        pytest.skip("SQLite ends no transaction by itself")
    with factory.database.write() as stores:
        stores.ledger.append([Promotion(0, Scope(), 0, None, version, 0)], lambda: 0)
        shown = stores._connection.exec_driver_sql("SHOW idle_in_transaction_session_timeout").scalar_one()
    assert shown == "5s"


def test_one_promotion_by_a_clock_that_is_years_ahead_is_told_to_the_next_and_not_followed(
    factory: Factory, version: str
) -> None:
    now, second = 1_000_000_000, 1_000_000
    append(factory, Scope(), 0, None, version, now + 59 * second)
    assert append(factory, Scope(), 0, None, None, now).at == now + 59 * second + 1, "clocks differ a little"
    append(factory, Scope(), 0, None, version, now + 1000 * second)
    with pytest.raises(UnavailableError, match="1000 s ahead of this server's clock"):
        append(factory, Scope(), 0, None, None, now)


def test_a_clock_ahead_wrote_promotions_that_stopped_all_others_until_their_instant(factory: Factory) -> None:
    """It is refused on arrival, and a ledger that has such lines is repaired: in order, and no answer changes."""
    version, other = fill(factory, ("a", "b")).values()
    now, year = read_clock(), 31_536_000_000_000
    append(factory, Scope(), 0, None, version, now - 10)
    with pytest.raises(UnavailableError, match=r"this server's clock is 15768000.* s ahead of the database's"):
        append(factory, Scope(), 0, None, other, now + 5 * year)
    wrong = append(factory, Scope(), 0, 100, other, now)
    with factory.database.engine.begin() as connection:  # as it was written before it was refused
        for table, column in (("promotion", "at_us"), ("edge", "known_us")):
            connection.exec_driver_sql(
                f"UPDATE {table} SET {column} = {now + 5 * year} WHERE {column} = {wrong.at}"  # noqa: S608 - numbers
            )
        connection.exec_driver_sql(
            f"INSERT INTO tag (name, as_of_us, \"by\", reason, at_us) VALUES ('t', {now + 6 * year}, 'x', 'x', 1)"  # noqa: S608
        )
    with pytest.raises(UnavailableError, match=r"ahead of this server's clock, .*: run `lbacal db repair-clock`"):
        append(factory, Scope(), 0, None, None, now)
    with factory.database.read() as stores:
        before = stores.ledger.decisive([Scope()], 50, None)[Scope()].calibration
    with factory.database.write() as stores:
        moved = stores.ledger.repair_clock()
        assert stores.ledger.repair_clock() == {}
        tag = stores.tags.find("t")
    assert list(moved) == [now + 5 * year, now + 6 * year]
    assert list(moved.values()) == sorted(moved.values())
    assert tag is not None
    assert tag.as_of == moved[now + 6 * year] <= read_clock() + 2
    later = append(factory, Scope(), 0, 100, None, read_clock())
    assert later.at > tag.as_of
    with factory.database.read() as stores:
        for as_of in (tag.as_of, moved[now + 5 * year]):
            assert stores.ledger.decisive([Scope()], 50, as_of)[Scope()].calibration == before == other
        assert stores.ledger.decisive([Scope()], 50, moved[now + 5 * year] - 1)[Scope()].calibration == version
        assert stores.ledger.edges(moved[now + 5 * year])[None] >= {0, 100}


@given(st.lists(promotions, max_size=15), st.integers(0, 20), st.integers(1, 12))
@examples(max_examples=60)
def test_what_stands_decides_as_the_whole_ledger_does(
    factory: Factory, wanted: Wanted, since: int, length: int
) -> None:
    """The oracle asks the whole ledger at every instant of the interval; some intervals nobody closed."""
    lines = append_all(factory, wanted)
    with factory.database.read() as stores:
        stands = stores.ledger.standing(SCOPES, since, since + length)
        all_before = stores.ledger.standing(SCOPES, since, since + length, before=10**9)
    assert stands == all_before
    for instant in range(since, since + length):
        for path in PATHS:
            found = answer_path(stands, path, instant)
            expected = brute_force(lines, path, instant, None)
            assert (found and (found.number, found.calibration)) == expected


TERM = BudgetTerm("sky", "a paper", {"X": np.full((1, 3), 0.1)})
BUDGET = Budget(np.array([30.0, 55.0, 80.0]), (TERM,))


def test_a_budget_is_stored_once_and_returns_as_it_was(factory: Factory) -> None:
    for _ in range(2):
        with factory.database.write() as stores:
            stores.budgets.add({BUDGET.digest: BUDGET})
    with factory.database.read() as stores:
        assert parse_budget(stores.budgets.get(BUDGET.digest)).digest == BUDGET.digest
        assert list(stores.budgets.get_texts([BUDGET.digest, "0" * 64])) == [BUDGET.digest]


def test_an_unknown_budget_is_refused(factory: Factory) -> None:
    with factory.database.read() as stores, pytest.raises(NotFoundError, match="no budget"):
        stores.budgets.get("0" * 64)


@pytest.mark.parametrize("scopes", [None, [Scope("CS001", 0, "X")], SCOPES])
def test_what_waits_is_found_without_a_look_at_every_version(factory: Factory, scopes: list[Scope] | None) -> None:
    """Ten years of versions, none kept back, made each answer for a station, and the status, eight times as slow."""
    with factory.database.write() as stores:
        stores.versions.add([new_version(scope, f"{number}") for number in range(300) for scope in SCOPES])
    with factory.database.engine.begin() as connection:
        connection.exec_driver_sql("ANALYZE")
    asked: list[tuple[str, Any]] = []

    def keep(_connection: object, _cursor: object, statement: str, bound: Any, *_: object) -> None:
        asked.append((statement, bound))

    event.listen(Engine, "before_cursor_execute", keep)
    assert factory.database.ask(lambda stores: stores.versions.waiting(scopes, 1_400_000_000_000_000)) == []
    event.remove(Engine, "before_cursor_execute", keep)
    statement, bound = next(one for one in asked if "gate IS NOT NULL" in one[0])
    with factory.database.engine.connect() as connection:
        explain = "EXPLAIN QUERY PLAN" if factory.settings.is_sqlite else "EXPLAIN"
        plan = [str(row) for row in connection.exec_driver_sql(f"{explain} {statement}", bound)]
    assert any("ix_calibration_gated" in line for line in plan), plan
