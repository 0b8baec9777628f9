from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from validation.image import PASSWORD, Composed, Images

LAST = "LBACAL_MAX_RATE"


class NoImages(Images):
    """Images whose commands do nothing, and end with 0."""

    def run(self, *arguments: str) -> str:
        return json.dumps({"OCIv1": {"config": {"Entrypoint": ["lbacal"]}}}) if arguments[0] == "inspect" else "one"

    def command(self, *arguments: str) -> list[str]:
        with (self.folder / "asked").open("a") as asked:
            asked.write("\n".join(arguments) + "\n\n")
        return ["/bin/true"]


@pytest.fixture
def composed(repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Composed:
    services = yaml.safe_load((repository / "docker-compose.yml").read_text())["services"]
    settings = {"POSTGRES_PASSWORD": PASSWORD, "FILES": "/own", LAST: "7", "PGPORT": "5433"}
    monkeypatch.setattr(Composed, "is_healthy", lambda *_: True)
    return Composed(NoImages(tmp_path), services, settings, 8001)


def test_services_start_in_the_order_and_with_the_environment_of_the_compose_file(composed: Composed) -> None:
    composed.up()
    assert composed.done[:3] == ["db: service_healthy", "migrate-0 started", "migrate: service_completed_successfully"]
    assert sorted(composed.processes) == ["api-0", "migrate-0", "scheduler-0", "worker-0", "worker-1"]
    assert composed.down() == dict.fromkeys(composed.processes, 0)
    asked: list[list[str]] = [one.splitlines() for one in (composed.images.folder / "asked").read_text().split("\n\n")]
    (api,) = (one for one in asked if "api-0" in one)
    assert api[-7:] == ["lbacal", "serve", "--host", "0.0.0.0", "--port", "8001", "--api-only"]  # noqa: S104
    given = [one for one in api if one.startswith(("--env", "--volume"))]
    assert given == [
        "--env=LBACAL_DATABASE_URL=postgresql://lbacal@db/lbacal", f"--env=PGPASSWORD={PASSWORD}", f"--env={LAST}=7",
        "--env=PGPORT=5433", "--volume=/own:/files:ro", f"--volume={composed.numbers}:/numbers",
    ]  # fmt: skip


def test_a_service_whose_command_fails_is_said(composed: Composed, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> list[str]:
        return ["/bin/sh", "-c", "echo no schema >&2; exit 3"]

    monkeypatch.setattr(NoImages, "command", fail)
    with pytest.raises(RuntimeError, match="migrate: no schema"):
        composed.up()
