from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lbacal.instants import DAY_US, format_instant, read_clock
from lbacal_core.curves.validity import Promotion, Scope
from service.errors import ConflictError, UnavailableError
from service.factory import Factory
from service.storage.versions import Version
from service.wire.bodies import PromotionBody, TagBody


def test_a_promotion_whose_answer_cannot_be_written_is_not_made(factory: Factory, stored: Any) -> None:
    """The answer was written after the commit: 500, and promoted."""

    def fail(*_: Any) -> None:
        raise ValueError("Out of range float values are not JSON compliant")

    body = PromotionBody(calibration=stored["array"].id, valid_from="2014-01-01", reason="x")
    plan = factory.promotions.plan(body, "test")
    with pytest.raises(ValueError, match="Out of range"):
        factory.promotions.promote(plan, fail)
    with factory.database.read() as stores:
        assert stores.ledger.newest_number() == 0
    assert factory.promotions.promote(plan, lambda made, _: made[0].calibration) == stored["array"].id


def test_changes_that_somebody_elses_promotion_made_untrue_are_worked_out_again(factory: Factory, stored: Any) -> None:
    first = PromotionBody(calibration=stored["path"].id, valid_from="2014-01-01", reason="first")
    second = PromotionBody(calibration=stored["other"].id, valid_from="2014-01-01", reason="second")
    plans = [factory.promotions.plan(body, "test") for body in (first, second)]
    assert [change.before for plan in plans for change in plan.changes] == [None, None]
    made = [factory.promotions.promote(plan, lambda _, changes: changes) for plan in plans]
    assert [change.before for changes in made for change in changes] == [None, stored["path"].id]


def test_what_a_promotion_changes_agrees_with_asking_at_each_instant(factory: Factory, stored: Any) -> None:
    """Only promotions that overlap it are read, of each interval the newest."""
    rng = np.random.default_rng(7)
    path = Scope("CS001", 0, "X")
    ids = {path: [stored["path"].id, stored["other"].id], Scope("CS001"): [stored["station"].id]}
    ids[Scope()] = [stored["array"].id]

    def ask() -> list[str | None]:
        with factory.database.read() as stores:
            said = [stores.ledger.answers([path], k * DAY_US, None)[path] for k in range(40)]
        return [one[-1].calibration if one else None for one in said]

    for _ in range(40):
        scope = list(ids)[rng.integers(3)]
        start, end = sorted(rng.choice(40, 2, replace=False).tolist())
        body = PromotionBody(
            calibration=None if rng.random() < 0.3 else str(rng.choice(ids[scope])),
            scope="array" if scope == Scope() else None,
            station=scope.station, antenna=scope.antenna, dipole=scope.dipole,
            valid_from=format_instant(start * DAY_US),
            valid_to=None if rng.random() < 0.2 else format_instant(end * DAY_US),
            reason="test",
        )  # fmt: skip
        before = ask()
        changes = factory.promotions.promote(factory.promotions.plan(body, "test"), lambda _, changes: changes)
        after = ask()
        said = {k: (c.before, c.after) for c in changes if c.path == path
                for k in range(40) if c.start <= k * DAY_US and (c.end is None or k * DAY_US < c.end)}  # fmt: skip
        assert said == {k: (a, b) for k, (a, b) in enumerate(zip(before, after, strict=True)) if a != b}


Stored = dict[str, Version]
PATH = Scope("CS001", 0, "X")
AT = 1_400_000_000_000_000


def promote(factory: Factory, version: Version | None, scope: Scope = PATH) -> Promotion:
    wanted = Promotion(0, scope, AT - 1, None, None if version is None else version.id, 0, "test", "test")
    with factory.database.write() as stores:
        return stores.ledger.append([wanted], factory.clock)[0]


def freeze(factory: Factory, name: str, as_of: str | None = None, reason: str = "test") -> Any:
    return factory.tags.put(name, TagBody(as_of=as_of, reason=reason), "test")


def answer(factory: Factory, tag: str) -> str | None:
    known = factory.tags.read_knowledge(None, tag)
    with factory.database.read() as stores:
        said = stores.ledger.answers([PATH], AT, known.as_of)[PATH]
    return said[-1].calibration if said else None


def test_a_promotion_by_a_clock_that_is_behind_is_still_later_than_a_tag(
    factory: Factory, stored: Stored, clock: Any
) -> None:
    promote(factory, stored["path"])
    tag, _ = freeze(factory, "paper")
    clock.now -= 30_000_000
    assert promote(factory, stored["other"]).at > tag.as_of
    assert answer(factory, "paper") == stored["path"].id


def test_a_tag_of_a_ledger_ahead_of_the_clock_sees_its_newest_promotion(
    factory: Factory, stored: Stored, clock: Any
) -> None:
    promote(factory, stored["path"])
    clock.now -= 30_000_000
    freeze(factory, "paper")
    assert answer(factory, "paper") == stored["path"].id


def test_a_tag_by_a_clock_ahead_stopped_all_promotions_until_that_day(factory: Factory, clock: Any) -> None:
    clock.now = read_clock() + 5 * 31_536_000_000_000
    with pytest.raises(UnavailableError, match="ahead of the database's: nothing is promoted or tagged"):
        freeze(factory, "paper")
    with factory.database.read() as stores:
        assert stores.tags.find("paper") is None


def test_the_same_tag_again_is_the_same_and_another_content_a_conflict(factory: Factory, stored: Stored) -> None:
    first = promote(factory, stored["path"])
    promote(factory, stored["other"])
    then = format_instant(first.at)
    tag, _ = freeze(factory, "v1", then)
    assert answer(factory, "v1") == stored["path"].id
    assert freeze(factory, "v1", then) == (tag, False)
    assert freeze(factory, "v1") == (tag, False), "a request that is repeated names no instant again"
    for as_of, reason in ((format_instant(first.at + 1), "test"), (then, "another reason")):
        with pytest.raises(ConflictError, match="v1 exists with another content"):
            freeze(factory, "v1", as_of, reason)


def test_tags_and_promotions_at_once_never_change_what_was_frozen(factory: Factory, stored: Stored) -> None:
    versions = [stored["path"], stored["other"]]
    seen: dict[str, str | None] = {}
    is_over = threading.Event()

    def promote_on() -> None:
        k = 0
        while not is_over.wait(0.002):
            promote(factory, versions[k % 2])
            k += 1

    def freeze_many(worker: int) -> None:
        for k in range(8):
            name = f"t{worker}-{k}"
            freeze(factory, name)
            seen[name] = answer(factory, name)

    with ThreadPoolExecutor(4) as pool:
        promoters = [pool.submit(promote_on) for _ in range(2)]
        for done in [pool.submit(freeze_many, worker) for worker in range(2)]:
            done.result()
        is_over.set()
        for done in promoters:
            done.result()
    assert {name: answer(factory, name) for name in seen} == seen
    assert [tag.name for tag in factory.database.look(lambda stores: stores.tags.after("", 100))] == sorted(seen)
    assert [tag.name for tag in factory.database.look(lambda stores: stores.tags.after("t0-3", 2))] == ["t0-4", "t0-5"]


@given(st.lists(st.tuples(st.sampled_from(["tag", "path", "other", "withdraw"]), st.integers(-40, 40)), max_size=12))
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_tags_are_what_brute_force_remembers(
    factory: Factory, stored: Stored, clock: Any, deeds: list[tuple[str, int]]
) -> None:
    """The oracle writes down at each tag what stood last; clocks go forward and back by seconds."""
    with factory.database.engine.begin() as connection:
        for table in ("standing", "promotion", "tag"):
            connection.exec_driver_sql(f"DELETE FROM {table}")  # noqa: S608 - those above
    standing: str | None = None
    remembered: dict[str, str | None] = {}
    for k, (deed, seconds) in enumerate(deeds):
        behind = max(-seconds, 0) * 1_000_000
        clock.now += max(seconds, 0) * 1_000_000 - behind
        if deed == "tag":
            freeze(factory, f"t{k}")
            remembered[f"t{k}"] = standing
        else:
            standing = promote(factory, stored.get(deed)).calibration
        clock.now += behind
    assert {name: answer(factory, name) for name in remembered} == remembered
