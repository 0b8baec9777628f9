"""What the commands of the ledger send."""

from __future__ import annotations

import json
from typing import Any, Self

import pytest

from lbacal.cli import ledger
from tests.lbacal.cli.conftest import Lbacal


@pytest.mark.parametrize(
    ("command", "path"),
    [
        (("rollback", "7"), "/v1/promotions/7/rollback"),
        (("withdraw", "--scope", "array", "--from", "2014-01-01", "--to", "open"), "/v1/promotions"),
    ],
)
def test_a_dry_run_is_asked_for_and_nothing_else_is_one(
    lbacal: Lbacal, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...], path: str
) -> None:
    """A rollback with --dry-run once rolled back, and said that nothing was written."""
    sent: list[tuple[str, str, Any]] = []

    class Server:
        def __enter__(self) -> Self:
            return self

        def __exit__(self, *_: object) -> None:
            return None

        def send(self, method: str, at: str, _body: object, dry_run: bool | None = None) -> dict[str, Any]:
            sent.append((method, at, dry_run))
            return {"changes": []}

    monkeypatch.setattr(ledger, "Client", Server)
    assert "(dry run: nothing was written)" in lbacal(*command, "--reason", "x", "--dry-run")[1]
    assert "dry run" not in lbacal(*command, "--reason", "x")[1]
    assert json.loads(lbacal(*command, "--reason", "x", "--json")[1]) == {"changes": []}
    assert sent == [("POST", path, True), ("POST", path, None), ("POST", path, None)]
