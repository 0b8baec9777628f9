from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lbacal.instants import DAY_US, format_instant
from lbacal_core.curves.validity import Scope
from service.factory import Factory
from service.wire.bodies import PromotionBody


def test_a_promotion_whose_answer_cannot_be_written_is_not_made(factory: Factory, stored: Any) -> None:
    """The answer was written after the commit: 500, and promoted."""

    def fail(*_: Any) -> None:
        raise ValueError("Out of range float values are not JSON compliant")

    body = PromotionBody(calibration=stored["array"].id, valid_from="2014-01-01", reason="x")
    plan = factory.promotions.plan(body, "test")
    with pytest.raises(ValueError, match="Out of range"):
        factory.promotions.promote(plan, fail)
    with factory.database.read() as stores:
        assert stores.ledger.recent(10) == []
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
