from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.curves.covariance import Budget, BudgetTerm, parse_budget
from service.errors import NotFoundError
from service.factory import Factory

TERM = BudgetTerm("sky", "a paper", {"X": np.full((1, 3), 0.1)})
BUDGET = Budget(np.array([30.0, 55.0, 80.0]), (TERM,))


def test_a_budget_is_stored_once_and_returns_as_it_was(factory: Factory) -> None:
    for _ in range(2):
        with factory.database.write() as stores:
            stores.budgets.add({BUDGET.digest: BUDGET})
    with factory.database.read() as stores:
        assert parse_budget(stores.budgets.get(BUDGET.digest)).digest == BUDGET.digest
        assert list(stores.budgets.get_many([BUDGET.digest, "0" * 64])) == [BUDGET.digest]


def test_an_unknown_budget_is_refused(factory: Factory) -> None:
    with factory.database.read() as stores, pytest.raises(NotFoundError, match="no budget"):
        stores.budgets.get("0" * 64)
