from __future__ import annotations

import json
import os
import re
import shlex
import sys
from datetime import datetime
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
from astropy.time import Time

import lbacal
from lbacal.cli.main import main
from lbacal_core.spectra.spectra import read_spectra

YEAR = ("--from", "2003-01-01", "--to", "2004-01-01", "--reason", "test")


def test_ingest_can_be_run_again(service: Any) -> None:
    again = service.run("ingest", str(service.spectra))
    assert again.returncode == 0, again.stderr
    assert again.stdout == "1116 spectra sent: 0 stored, 1116 there already\n"
    assert "279 of 279 events" in again.stderr


def test_effective_prints_the_calibration_on_a_date(service: Any) -> None:
    said = service.run("effective", "--station", "CS002", "--antenna", "1", "--dipole", "X", "--at", "2014-05-01")
    assert said.returncode == 0, said.stderr
    assert said.stdout.startswith("CS002 antenna 1 X: version ")
    assert "answered by antenna, promoted for 2014-01-01T00:00:00Z to 2015-01-01T00:00:00Z" in said.stdout
    assert len(said.stdout.splitlines()) == 3 + 51


@pytest.mark.parametrize(
    ("arguments", "code", "sentence"),
    [
        (("effective", "--at", "2014"), 2, "at: expected an ISO 8601 date"),
        (("effective", "--at", "2004-01-01"), 1, "no calibration is in effect"),
        (("effective", "--at", "2014-05-01", "--antenna", "1"), 2, "antenna: expected a station beside it"),
        (("ingest", "nothing.h5"), 2, "nothing.h5: expected a spectra file"),
        (("refit", "--scope", "path", "--since", "2014-01-01", "--until", "2015-01-01", "--reason", "x"), 2, "scope"),
        (("jobs", "999"), 1, "no job 999"),
        (("keys", "create", "--scope", "write"), 2, "scope: expected one or more of read"),
        (("keys", "revoke", "999"), 1, "no key 999"),
        (("promote", "--reason", "x"), 2, "either a version or --job, found neither"),
        (("promote", "--job", "1", "--from", "2014-01-01", "--reason", "x"), 2, "no --from or --to beside it"),
        (("promote", "0" * 64, "--reason", "x"), 1, "no calibration"),
        (("withdraw", *YEAR), 2, '"scope": "array"'),
        (("rollback", "99999", "--reason", "x"), 1, "no promotion 99999"),
        (("tag", "v1"), 2, "--reason: expected why the tag is made"),
    ],
)
def test_a_failure_is_one_sentence_and_an_exit_code(
    service: Any,
    arguments: tuple[str, ...],
    code: int,
    sentence: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """In this process: to start one takes a second. Those of the next test are processes as a user has them."""
    for name, value in service.environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "argv", ["lbacal", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr()
    assert (ended.value.code, said.out) == (code, "")
    assert sentence in said.err
    assert len(said.err.splitlines()) == 1


def test_a_wrong_key_and_a_wrong_setting_are_named(service: Any) -> None:
    asked = ("refit", "--scope", "array", "--since", "2014-01-01", "--until", "2015-01-01", "--reason", "x")
    refused = service.run(*asked, LBACAL_API_KEY="no")
    assert (refused.returncode, refused.stdout) == (1, "")
    assert refused.stderr == "lbacal: the key is unknown, expired or revoked\n"
    wrong = service.run("worker", LBACAL_LEASE_S="soon")
    assert wrong.returncode == 2
    assert wrong.stderr.startswith("lbacal: LBACAL_LEASE_S: expected ")


def test_an_admin_refits_and_sees_the_job(service: Any) -> None:
    asked = service.run(
        "refit", "--scope", "station", "--since", "2014-03-01", "--until", "2015-03-01", "--reason", "half a year later"
    )
    assert asked.returncode == 0, asked.stderr
    line, why, version = asked.stdout.splitlines()
    assert "refit station 2014-03-01 to 2015-03-01, done (100%), versions: 1, promoted: 0, no news: 0; " in line
    assert line.endswith("half a year later")
    assert line in service.run("jobs").stdout
    made = re.fullmatch(r"  ([0-9a-f]{12}) made", version)
    assert made is not None, "what is put into effect next is named"
    assert why.startswith("  not promoted: nobody asked for it; lbacal promote --job ")
    tried = service.do("promote", made[1], "--reason", "looked at", "--dry-run")
    assert "dry run: nothing was written" in tried


def test_the_schema_is_checked(service: Any) -> None:
    assert re.fullmatch(r"schema [0-9]{4}, as needed\n", service.run("db", "check").stdout)


def test_status_shows_who_lives_and_what_was_done(service: Any) -> None:
    said = service.run("status")
    assert said.returncode == 0, said.stderr
    lines = said.stdout.splitlines()
    assert lines[0] == "ready"
    assert {line.split()[0] for line in lines[1:4]} == {"api", "scheduler", "worker"}
    assert any(line.startswith("parts of jobs: 0 queued, 0 running, ") for line in lines)
    absent = service.run("status", LBACAL_URL="http://127.0.0.1:9")
    assert (absent.returncode, len(absent.stderr.splitlines())) == (1, 1)


def test_keys_are_listed_without_their_text(service: Any) -> None:
    made = service.run(
        "keys", "create", "--scope", "read", "--scope", "refits:run", "--expires", "7"
    ).stdout.splitlines()
    number = made[0].split()[1]
    listed = service.run("keys", "list").stdout
    assert made[-1] not in listed
    assert f"{number}: read, refits:run; made " in listed
    assert service.run("keys", "revoke", number).stdout == f"key {number} is revoked\n"


@pytest.fixture
def client(service: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    for name in ("LBACAL_URL", "LBACAL_API_KEY"):
        monkeypatch.setitem(os.environ, name, service.environment[name])
    return service


def test_spectra_that_the_server_has_are_not_sent_again(client: Any) -> None:
    """Sending again took as long as sending: 27 and 32 s."""
    spectra = read_spectra(client.spectra)
    rows, events = len(spectra), np.unique(spectra.event_id).size
    asked: list[str] = []
    with lbacal.Client() as sender:
        sender._transport._http.event_hooks["request"].append(lambda request: asked.append(request.method))
        steps: list[tuple[int, int]] = []
        assert sender.ingest(spectra, lambda *step: steps.append(step)) == {
            "received": rows, "stored": 0, "duplicates": rows,
        }  # fmt: skip
    assert asked == ["GET"]
    assert steps == [(events, events)]


@pytest.mark.usefixtures("client")
@pytest.mark.parametrize("at", [Time("2014-05-01"), datetime(2014, 5, 1), "2014-05-01"])  # noqa: DTZ001 - naive is UTC
def test_the_client_answers_with_a_table_of_quantities(at: Any) -> None:
    table = lbacal.effective("CS002", antenna=1, dipole="X", at=at)
    assert table.meta["at"] == "2014-05-01T00:00:00Z"
    assert (len(table), str(table["c"].unit), str(table["frequency_mhz"].unit)) == (51, "V", "MHz")
    assert set(table["answered_by"]) == {"antenna"}
    # the twin takes its C from the published curve, around 2e-5 V per ADC unit
    assert 1e-6 < np.median(table["c"].value) < 1e-3


def test_the_client_sends_spectra_and_asks_for_fits(client: Any) -> None:
    spectra = read_spectra(client.spectra)
    some = spectra.select(np.isin(spectra.event_id, np.unique(spectra.event_id)[:3]))
    assert lbacal.ingest(some) == {"received": 12, "stored": 0, "duplicates": 12}
    job = lbacal.refit("antenna", "2014-01-01", "2015-01-01", reason="test", station="CS002", antenna=1, dipole="X")
    assert (job["state"], len(job["calibrations"])) == ("done", 1)
    assert job["calibrations"][0] in set(lbacal.effective("CS002", at="2014-05-01")["calibration"])


@pytest.mark.usefixtures("client")
def test_a_refusal_and_an_absent_server_are_exceptions_with_a_sentence() -> None:
    with pytest.raises(lbacal.RefusedError, match="ISO 8601") as refused:
        lbacal.effective("CS002", at="2014")
    assert (refused.value.status, refused.value.code) == (422, "bad_input")
    with (
        lbacal.Client("http://127.0.0.1:9", tries=2) as absent,
        pytest.raises(lbacal.UnreachableError, match="LBACAL_URL"),
    ):
        absent.get("/healthz")


def test_stored_spectra_are_investigated_and_the_status_says_what_the_night_found(service: Any, tmp_path: Path) -> None:
    window = ("--since", "2014-01-01", "--until", "2015-01-01")
    report = tmp_path / "R.json"
    asked = service.do("investigate", "--stored", *window, "--reason", "test", "--report", str(report))
    assert re.match(r"CS002, 2014-01-01 to 2015-01-01: \w+; investigation [0-9a-f]{12}\n", asked)
    assert f": {json.loads(report.read_text())['verdict']};" in asked
    said = service.run("status")
    assert re.search(r"^CS002, 2015-01-01 to 2016-01-01: \w+.*; investigation [0-9a-f]{12}$", said.stdout, re.MULTILINE)
    refused = service.run("investigate", "--stored", *window)
    assert (refused.returncode, "--reason" in refused.stderr) == (2, True)


PATH = ("--station", "CS002", "--antenna", "0", "--dipole", "Y")


def in_effect(service: Any, **params: Any) -> str:
    asked = {"station": "CS002", "antenna": 0, "dipole": "Y", "at": "2003-06-01", **params}
    answer = httpx2.get(f"{service.url}/v1/calibrations/effective", params=asked)
    return str(answer.json()["curves"][0]["calibration"])


def test_a_version_is_promoted_frozen_withdrawn_and_put_back(service: Any) -> None:
    name = in_effect(service, at="2014-06-01")
    tried = service.do("promote", name, *YEAR, "--dry-run")
    assert "changes of what paths are served: 1 (dry run: nothing was written)" in tried
    assert "CS002 antenna 0 Y, 2003-01-01T00:00:00Z to 2004-01-01T00:00:00Z: nothing -> " in tried
    made = service.do("promote", name, *YEAR)
    assert f"CS002 antenna 0 Y has version {name[:12]} from 2003-01-01T00:00:00Z to 2004-01-01T00:00:00Z" in made
    assert in_effect(service) == name
    assert service.do("tag", "old-years", "--reason", "test").startswith("old-years: as of 20")
    number = re.findall(r"promotion (\d+): CS002 antenna 0 Y has nothing", service.do("withdraw", *PATH, *YEAR))
    with pytest.raises(KeyError):
        in_effect(service)
    assert in_effect(service, tag="old-years") == name
    assert "(dry run: nothing was written)" in service.do("rollback", *number, "--reason", "x", "--dry-run")
    with pytest.raises(KeyError):
        in_effect(service)
    undone = service.do("rollback", *number, "--reason", "it was right")
    assert f"CS002 antenna 0 Y has version {name[:12]}" in undone
    assert in_effect(service) == name
    assert "old-years: as of " in service.do("tag")


def test_all_versions_of_a_job_are_promoted_by_its_number(service: Any) -> None:
    asked = service.do(
        "refit", "--scope", "station", "--since", "2014-02-01", "--until", "2015-02-01", "--reason", "test"
    )
    number = re.findall(r"^job (\d+): ", asked)
    assert "(dry run: nothing was written)" in service.do("promote", "--job", *number, "--reason", "x", "--dry-run")


COMMAND = re.compile(r"^lbacal (.*)$", re.MULTILINE)


def follow(service: Any, line: str, **names: str) -> str:
    """Run a command of the page with its placeholders filled in."""
    return str(service.do(*(names.get(word, word) for word in shlex.split(line))))


def curves_in_effect(service: Any) -> list[Any]:
    """What the paths of the station are told; nothing where the gate held every fit back."""
    asked = {"station": "CS002", "at": "2014-06-01", "gap": "hold"}
    answer = httpx2.get(f"{service.url}/v1/calibrations/effective", params=asked)
    return [curve["c"] for curve in answer.json().get("curves", [])]


def test_the_commands_of_the_page_close_the_loop(faulty: Any, repository: Path) -> None:
    page = (repository / "docs/how-to/adopt-a-cause.md").read_text().replace("2015-", "2014-").replace("2016-", "2015-")
    status, investigate, dry_run, adopt, models, abandon = COMMAND.findall(page)
    told = follow(faulty, status)
    assert "CS002, 2014-01-01 to 2015-01-01: explained (lst_offset" in told
    assert re.search(r"^alarms: .* misfits?\b", told, re.MULTILINE), "told in the night in which it was found"
    found = follow(faulty, investigate)
    (name,) = re.findall(r"investigation ([0-9a-f]{12})", found)
    assert re.search(r"^  #0 .* sigma: In station CS002, .*sidereal", found, re.MULTILINE)
    tried = follow(faulty, dry_run, INVESTIGATION=name)
    assert "would be adopted: In station CS002" in tried
    assert re.search(r"changes of what paths are served: \d+ \(dry run: nothing was written\)", tried)
    before = curves_in_effect(faulty)
    made = follow(faulty, adopt, INVESTIGATION=name)
    (model,) = re.findall(r"`lbacal abandon ([0-9a-f]{12})`", made)
    assert len(re.findall(r"^job \d+: refit .*, done \(100%\)", made, re.MULTILINE)) == 3
    assert len(curves_in_effect(faulty)) == 96
    listed = follow(faulty, models)
    assert f"model {model} of CS002, in effect" in listed
    gone = follow(faulty, abandon, MODEL=model)
    assert len(re.findall(r"^job \d+: refit .*, done \(100%\)", gone, re.MULTILINE)) == 3
    assert curves_in_effect(faulty) == before
    assert "withdrawn: In station CS002" in follow(faulty, models)
    missing = faulty.run("adopt", "0" * 12, "--reason", "x")
    assert (missing.returncode, "no investigation" in missing.stderr) == (1, True)
