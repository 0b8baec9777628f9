from __future__ import annotations

from typing import Any

import pytest

from lbacal_core.validity import Scope
from service.factory import Factory
from service.wire.bodies import PromotionBody


def test_a_promotion_whose_answer_cannot_be_written_is_not_made(factory: Factory, stored: Any) -> None:
    """The answer was written after the commit: 500, and promoted."""

    def fail(*_: Any) -> None:
        raise ValueError("Out of range float values are not JSON compliant")

    body = PromotionBody(calibration=stored["array"].id, valid_from="2014-01-01", reason="x")
    with pytest.raises(ValueError, match="Out of range"):
        factory.promotions.promote(body, "test", fail)
    with factory.database.read() as stores:
        assert list(stores.ledger.of_scopes([Scope()])) == []
    assert factory.promotions.promote(body, "test", lambda made, _: made.calibration) == stored["array"].id
