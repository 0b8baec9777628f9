"""The commands that change what is in effect, in a year that no other test looks at."""

from __future__ import annotations

import re
from typing import Any

import httpx2
import pytest

PATH = ("--station", "CS002", "--antenna", "0", "--dipole", "Y")
YEAR = ("--from", "2003-01-01", "--to", "2004-01-01", "--reason", "test")


def run(service: Any, *arguments: str) -> str:
    said = service.run(*arguments)
    assert said.returncode == 0, said.stderr
    return str(said.stdout)


def in_effect(service: Any, **params: Any) -> str:
    asked = {"station": "CS002", "antenna": 0, "dipole": "Y", "at": "2003-06-01", **params}
    answer = httpx2.get(f"{service.url}/v1/calibrations/effective", params=asked)
    return str(answer.json()["curves"][0]["calibration"])


def test_a_version_is_promoted_frozen_withdrawn_and_put_back(service: Any) -> None:
    name = in_effect(service, at="2014-06-01")
    tried = run(service, "promote", name, *YEAR, "--dry-run")
    assert "changes of what paths are told: 1 (dry run: nothing was written)" in tried
    assert "CS002 antenna 0 Y, 2003-01-01T00:00:00Z to 2004-01-01T00:00:00Z: nothing -> " in tried
    made = run(service, "promote", name, *YEAR)
    assert f"CS002 antenna 0 Y has version {name[:12]} from 2003-01-01T00:00:00Z to 2004-01-01T00:00:00Z" in made
    assert in_effect(service) == name
    assert run(service, "tag", "old-years", "--reason", "test").startswith("old-years: as of 20")
    number = re.findall(r"promotion (\d+): CS002 antenna 0 Y has nothing", run(service, "withdraw", *PATH, *YEAR))
    with pytest.raises(KeyError):
        in_effect(service)
    assert in_effect(service, tag="old-years") == name
    assert "(dry run: nothing was written)" in run(service, "rollback", *number, "--reason", "x", "--dry-run")
    with pytest.raises(KeyError):
        in_effect(service)
    undone = run(service, "rollback", *number, "--reason", "it was right")
    assert f"CS002 antenna 0 Y has version {name[:12]}" in undone
    assert in_effect(service) == name
    assert "old-years: as of " in run(service, "tag")


def test_all_versions_of_a_job_are_promoted_by_its_number(service: Any) -> None:
    asked = run(
        service, "refit", "--scope", "station", "--since", "2014-02-01", "--until", "2015-02-01", "--reason", "test"
    )
    number = re.findall(r"^job (\d+): ", asked)
    assert "(dry run: nothing was written)" in run(service, "promote", "--job", *number, "--reason", "x", "--dry-run")


@pytest.mark.parametrize(
    ("arguments", "code", "sentence"),
    [
        (("promote", "--reason", "x"), 2, "either a version or --job, found neither"),
        (("promote", "--job", "1", "--from", "2014-01-01", "--reason", "x"), 2, "no --from or --to beside it"),
        (("promote", "0" * 64, "--reason", "x"), 1, "no calibration"),
        (("withdraw", *YEAR), 2, '"scope": "array"'),
        (("rollback", "99999", "--reason", "x"), 1, "no promotion 99999"),
        (("tag", "v1"), 2, "--reason: expected why the tag is made"),
    ],
)
def test_a_failure_is_one_sentence(service: Any, arguments: tuple[str, ...], code: int, sentence: str) -> None:
    said = service.run(*arguments)
    assert (said.returncode, said.stdout) == (code, "")
    assert sentence in said.stderr
    assert len(said.stderr.splitlines()) == 1
