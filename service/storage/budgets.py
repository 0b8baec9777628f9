"""Budgets of systematic errors: what the curves of a fit share, stored once under its hash."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

from sqlalchemy import Connection, select
from sqlalchemy.dialects.postgresql import insert as postgresql_insert
from sqlalchemy.dialects.sqlite import insert as sqlite_insert

from lbacal_core.curves.covariance import Budget
from lbacal_core.provenance import canonical_json
from service.errors import NotFoundError
from service.schema.tables import budget

MANY_KEYS = 500


class BudgetStore:
    """Budgets by their hash."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._insert: Any = sqlite_insert if connection.dialect.name == "sqlite" else postgresql_insert

    def add(self, budgets: Mapping[str, Budget]) -> None:
        """Store budgets; one that is stored already stays as it is."""
        rows = [{"sha256": name, "content": canonical_json(one.as_dict())} for name, one in sorted(budgets.items())]
        if rows:
            self._connection.execute(self._insert(budget).on_conflict_do_nothing(), rows)

    def get(self, digest: str) -> dict[str, Any]:
        """One budget as JSON values."""
        found = self.get_many([digest])
        if not found:
            raise NotFoundError(f"no budget {digest!r}; a curve names its own in covariance.systematic.budget")
        return found[digest]

    def get_many(self, digests: Iterable[str]) -> dict[str, dict[str, Any]]:
        """Budgets by their hash as JSON values; unknown ones are left out."""
        return {name: json.loads(text) for name, text in self.get_texts(digests).items()}

    def get_texts(self, digests: Iterable[str]) -> dict[str, str]:
        """The same as they are stored, as canonical JSON."""
        wanted = sorted(set(digests))
        found: dict[str, str] = {}
        for start in range(0, len(wanted), MANY_KEYS):
            is_wanted = budget.c.sha256.in_(wanted[start : start + MANY_KEYS])
            rows = self._connection.execute(select(budget).where(is_wanted).order_by(budget.c.sha256))
            found |= {row.sha256: row.content for row in rows}
        return found
