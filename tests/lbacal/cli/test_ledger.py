"""What the commands of the ledger send."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, Self

import pytest

from lbacal.cli import client, ledger
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


def test_an_adoption_and_an_ingestion_answer_as_json(lbacal: Lbacal, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a script needs of them stood in sentences alone."""
    job = {"job": 3, "kind": "refit", "state": "done", "progress": 1.0}

    class Server:
        def __enter__(self) -> Self:
            return self

        def __exit__(self, *_: object) -> None:
            return None

        def send(self, _method: str, at: str, _body: object, dry_run: bool | None = None) -> dict[str, Any]:
            return {"model": f"{at}?dry_run={dry_run}", "jobs": [] if dry_run else [3]}

        def wait_for(self, number: int, on_change: Callable[[Any], object]) -> dict[str, Any]:
            on_change(job | {"state": "running", "progress": 0.5})
            return job | {"job": number}

        def ingest(self, _spectra: object, on_event: Callable[[int, int], object]) -> dict[str, int]:
            on_event(7, 7)
            return {"received": 7, "stored": 7, "duplicates": 0}

    monkeypatch.setattr(ledger, "Client", Server)
    monkeypatch.setattr(client, "Client", Server)
    for command, path in (("adopt", "/v1/investigations/7/adoption"), ("abandon", "/v1/models/7/withdrawal")):
        code, out, _ = lbacal(command, "7", "--reason", "x", "--json")
        assert (code, json.loads(out)) == (0, {"model": f"{path}?dry_run=None", "jobs": [job]})
    tried = json.loads(lbacal("adopt", "7", "--reason", "x", "--json", "--dry-run")[1])
    assert tried == {"model": "/v1/investigations/7/adoption?dry_run=True", "jobs": []}
    code, out, err = lbacal("ingest", "s.h5", "--json")
    assert (code, json.loads(out)["stored"], err) == (0, 7, "7 of 7 events\n")
