"""The commands that ask a server, in words: against one of this process, and of answers that take long to make."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from lbacal.cli.analysis import print_investigation
from lbacal.cli.client import print_job, print_receipt
from lbacal.cli.ledger import _print_adoption, _print_jobs, print_act, print_model, print_state
from lbacal.cli.main import add_commands, app
from lbacal_core.curves.validity import Scope
from lbacal_core.errors import BadInputError
from lbacal_core.spectra.spectra import write_spectra
from service.cli import database
from service.factory import Factory
from service.storage.alarms import News
from service.storage.ledger import Tag
from service.storage.migration import find_revision
from service.storage.models import Investigation
from service.storage.versions import Version
from tests.service.conftest import add_spectra, bearer, flat_spectra, instant, listening

SAID = """
$ promote PATH --from 2014-01-01 --to open --reason "new cables" --dry-run
changes of what paths are served: 1 (dry run: nothing was written)
  CS001 antenna 0 X, 2014-01-01T00:00:00Z to open: nothing -> PATH
$ promote PATH --from 2014-01-01 --to open --reason "new cables"
promotion 1: CS001 antenna 0 X has version PATH from 2014-01-01T00:00:00Z to open
changes of what paths are served: 1
  CS001 antenna 0 X, 2014-01-01T00:00:00Z to open: nothing -> PATH
$ promote STATION --reason "new cables"
promotion 2: CS001 has version STATION from 2014-01-01T00:00:00Z to 2015-01-01T00:00:00Z
changes of what paths are served: 5
  CS001 antenna 0 Y, 2014-01-01T00:00:00Z to 2015-01-01T00:00:00Z: nothing -> STATION
  CS001 antenna 1 X, 2014-01-01T00:00:00Z to 2015-01-01T00:00:00Z: nothing -> STATION
  CS001 antenna 1 Y, 2014-01-01T00:00:00Z to 2015-01-01T00:00:00Z: nothing -> STATION
  CS001 antenna 2 X, 2014-01-01T00:00:00Z to 2015-01-01T00:00:00Z: nothing -> STATION
  CS001 antenna 2 Y, 2014-01-01T00:00:00Z to 2015-01-01T00:00:00Z: nothing -> STATION
$ effective --station CS001 --antenna 0 --dipole X --at 2014-05-01 --why
CS001 antenna 0 X: version PATH
  answered by antenna, promoted for 2014-01-01T00:00:00Z to further notice
  why: made 2019-12-31T00:00:00Z by test (test), in effect since 2020-01-01T00:00:00Z by key 1 (new cables); \
no change in force bounds its epoch
  frequency_mhz             c  c_sigma_stat  c_sigma_sys   (V per ADC unit)  flag
             30           1.2          0.01      unknown                      ok
             45           2.4          0.01      unknown                      ok
             60           3.6          0.01      unknown                      ok
             80           4.8          0.01      unknown                      ok
$ effective --station CS001 --antenna 0 --dipole X --at 2014-05-01 --format csv --output C.csv
wrote C.csv as csv
$ withdraw --station CS001 --antenna 0 --dipole X --from 2014-06-01 --to open --reason "wrong cables" --dry-run
changes of what paths are served: 2 (dry run: nothing was written)
  CS001 antenna 0 X, 2015-01-01T00:00:00Z to open: PATH -> nothing
  CS001 antenna 0 X, 2014-06-01T00:00:00Z to 2015-01-01T00:00:00Z: PATH -> STATION, C by up to 8.33 %
$ withdraw --station CS001 --antenna 0 --dipole X --from 2014-06-01 --to open --reason "wrong cables"
promotion 3: CS001 antenna 0 X has nothing from 2014-06-01T00:00:00Z to open
changes of what paths are served: 2
  CS001 antenna 0 X, 2015-01-01T00:00:00Z to open: PATH -> nothing
  CS001 antenna 0 X, 2014-06-01T00:00:00Z to 2015-01-01T00:00:00Z: PATH -> STATION, C by up to 8.33 %
$ rollback 3 --reason "they were right"
promotion 4: CS001 antenna 0 X has version PATH from 2014-06-01T00:00:00Z to open
changes of what paths are served: 2
  CS001 antenna 0 X, 2015-01-01T00:00:00Z to open: nothing -> PATH
  CS001 antenna 0 X, 2014-06-01T00:00:00Z to 2015-01-01T00:00:00Z: STATION -> PATH, C by up to 9.09 %
$ tag
no tags
$ tag paper --reason "the paper"
paper: as of 2020-01-01T00:00:00Z, by key 1: the paper
$ tag
paper: as of 2020-01-01T00:00:00Z, by key 1: the paper
$ alarms --station CS002
no alarms (lasting)
$ alarms --station CS001
1 misfit (open, raised 2020-01-01): CS001 is wrong
$ alarms --acknowledge 1 --until 2021-01-01 --reason "the cable is ordered"
1 misfit (acknowledged, raised 2020-01-01): CS001 is wrong
  known until 2021-01-01, key 1: the cable is ordered
$ status
not ready: no worker has lived for a minute: start `lbacal worker`
parts of jobs: 0 queued, 0 running, 0 done, 0 failed, 0 cancelled
1 usable event, the newest of 2014-05-13T16:53:20Z; versions that wait for a human: 0
alarms: none open, 1 acknowledged; 1 new since yesterday
CS001, 2014-01-01 to 2015-01-01: explained (gain_step); investigation bbbbbbbbbbbb
  new: The gain stepped.
$ life CS001
2014-01-01 version STATION answers until 2015-01-01T00:00:00Z
2019-01-01 investigation aaaaaaaaaaaa: consistent
2019-02-01 investigation bbbbbbbbbbbb: explained
2020-01-01 alarm 1 (acknowledged): CS001 is wrong
versions: 1, epochs: 1
$ life --station CS001 --antenna 0 --dipole X
2014-01-01 version PATH answers until 2014-06-01T00:00:00Z
2014-06-01 version PATH answers until open
2019-01-01 investigation aaaaaaaaaaaa: consistent
2019-02-01 investigation bbbbbbbbbbbb: explained
2020-01-01 alarm 1 (acknowledged): CS001 is wrong
2020-01-01 CS001 antenna 0 X was withdrawn from 2014-06-01T00:00:00Z to open by key 1: wrong cables
versions: 3, epochs: 1
$ models
no models
$ jobs
no jobs
$ refit --scope station --station CS001 --since 2014-01-01 --until 2015-01-01 --reason "new map" --no-wait
job 1: refit station CS001 2014-01-01 to 2015-01-01, queued (0%), versions: 0, promoted: 0, no news: 0; new map
$ jobs
job 1: refit station CS001 2014-01-01 to 2015-01-01, queued (0%), versions: 0, promoted: 0, no news: 0; new map
$ jobs 1
job 1: refit station CS001 2014-01-01 to 2015-01-01, queued (0%), versions: 0, promoted: 0, no news: 0; new map
$ ingest S.h5
2 spectra sent: 0 stored, 2 there already
"""


def test_what_commands_print_is_what_the_server_did(
    factory: Factory, stored: dict[str, Version], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    spectra = flat_spectra(*(("e0", 1.4e9, "CS001", 0, dipole) for dipole in "XY"))
    write_spectra(spectra, tmp_path / "S.h5")
    add_spectra(factory, spectra)
    ids = {name.upper(): stored[name].id[:12] for name in ("path", "station")}
    begin, end = instant("2014-01-01"), instant("2015-01-01")
    step = {
        "cause": "gain_step",
        "sentence": "The gain stepped.",
        "significance_sigma": 9.0,
        "where": {"station": "CS001", "antennas": [0], "dipoles": ["X"]},
    }
    with factory.database.write() as stores:
        for name, findings, day in (("a", [], "2019-01-01"), ("b", [step], "2019-02-01")):
            report = {"verdict": "explained" if findings else "consistent", "findings": findings, "unexplained": None}
            stores.investigations.add(Investigation(name * 64, "CS001", begin, end, {}, report, instant(day), "x", "x"))
        stores.alarms.raise_alarm(News("misfit", Scope("CS001"), "", "CS001 is wrong"), factory.clock())
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LBACAL_API_KEY", bearer(factory, "admin")["Authorization"].removeprefix("Bearer "))
    with listening(factory) as url:
        monkeypatch.setenv("LBACAL_URL", url)
        for part in SAID.split("\n$ ")[1:]:
            command, _, expected = re.sub("PATH|STATION", lambda found: ids[found[0]], part).partition("\n")
            done = CliRunner().invoke(app, shlex.split(command))
            said = "\n".join(line for line in done.stdout.splitlines() if "[info " not in line)
            assert re.sub(r"\.\d{6}Z", "Z", said).rstrip() == expected.rstrip(), (command, done.exception)
            assert done.exit_code == (command == "status")


def test_the_commands_of_a_database_say_what_they_did(factory: Factory, monkeypatch: pytest.MonkeyPatch) -> None:
    add_commands()
    monkeypatch.setattr(database, "_factory", lambda: factory)

    def say(command: str) -> str:
        done = CliRunner().invoke(app, shlex.split(command))
        assert done.exit_code == 0, done.exception
        return done.stdout

    revision = find_revision(factory.database)
    assert say("db upgrade") == f"schema {revision}\n"
    assert say("db check") == f"schema {revision}, as needed\n"
    assert say("db repair-clock") == "0 instants were ahead of the database's clock\n"
    made = say("keys create --scope read --scope refits:run --name pipeline").splitlines()
    assert made[0] == "key 1 with scope read, refits:run; keep it now, it is not shown again:"
    assert say("keys list") == "1: pipeline: read, refits:run; made 2020-01-01T00:00:00.000001Z, expires never\n"
    assert say("keys revoke 1") == "key 1 is revoked\n"
    assert re.search(r"expires never, revoked 2020-01-01T00:00:00\.\d+Z\n$", say("keys list"))
    ahead = instant("2100-01-01")
    with factory.database.write() as stores:
        stores.tags.add(Tag("later", ahead, "key 1", "a clock ahead", ahead))
    moved = say("db repair-clock").splitlines()
    assert re.fullmatch(r"2100-01-01T\S+ -> 20\d\d-\S+Z", moved[0])
    assert moved[-1] == "1 instants were ahead of the database's clock"


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("promote --reason x", "either a version or --job, found neither"),
        ("promote 4711aa --job 3 --reason x", "either a version or --job, found both"),
        ("promote --job 3 --from 2014-01-01 --reason x", "--job: expected no --from or --to beside it"),
        ("tag a/b --reason x", "tag: expected letters, digits, '.', '_' and '-', found 'a/b'"),
        ("tag paper", "--reason: expected why the tag is made"),
        ("alarms --acknowledge 3", "--acknowledge with --reason"),
        ("alarms --until 2020-01-01", "--acknowledge with --reason"),
        ("changes decide 3 --reason x", "either --in-force or --dismiss, found neither"),
        ("changes enter 2014-05-01 --station A --reason x --size nan", "--size: expected a finite number, found nan"),
        ("changes enter 2014-05-01 --station A --reason x --size 1 --size-sigma inf", "--size-sigma: expected"),
        ("changes enter 2014-05-01 --station A --reason x --sigma-days inf", "--sigma-days: expected a finite number"),
        ("life CS001/0", "STATION or STATION/ANTENNA/DIPOLE"),
        ("life CS001/0/X --station CS001", "either a path or --station, --antenna and --dipole, found both"),
        ("life --station CS001 --antenna 0", "station, antenna and dipole, a station alone, or nothing"),
        ("effective --at 2014-05-01 --output C.ecsv", "--format: expected json, csv"),
        ("investigate --stored --since 2014-01-01 --until 2015-01-01", "--reason: expected a value beside --stored"),
        ("investigate --stored --station CS001 --station CS002", "--station: expected one beside --stored"),
        (
            "predict --station A --antenna 0 --dipole X --at 2014-05-01 --output P.h5 --with R.json",
            "--simulation beside",
        ),
    ],
)
def test_what_contradicts_itself_is_not_asked(command: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LBACAL_URL", "http://127.0.0.1:9")
    refused = CliRunner().invoke(app, command.split()).exception
    assert isinstance(refused, BadInputError)
    assert said in str(refused)


VERSION = "0123456789abcdef"
JOB = {
    "job": 7, "kind": "refit", "state": "failed", "progress": 0.5, "reason": "map", "error": "no room",
    "request": {"scope": "station", "station": "CS002", "since": "2014-01-01T00", "until": "2015-01-01T00"},
    "calibrations": [VERSION, "f" * 16, "a" * 16], "promoted": ["f" * 16], "examined": 1, "results": [],
    "gated": {"a" * 16: "is far off"},
}  # fmt: skip
PATH = {"station": "CS002", "antenna": 3, "dipole": "X"}
CHANGE = {**PATH, "from": "2014", "to": None, "before": None, "after": VERSION, "max_fraction": 0.125}
NEWS = {
    "station": "CS002", "since": "2014-01-01T00", "until": "2015-01-01T00", "verdict": "explained", "id": VERSION,
    "findings": ["gain_step"], "before": None, "new": [], "stronger": [], "gone": [],
}  # fmt: skip
STATE = {
    "ready": True, "problem": None, "parts": {"queued": 2, "done": 1}, "newest_event": "2014-05-01T00:00:00Z",
    "processes": [{"kind": "worker", "name": "w", "alive": a, "silent_s": 61.2 * (not a)} for a in (True, False)],
    "events": 5, "gated": 1, "alarms": {"line": "none"}, "not_refitted": ["CS002 waits"], "stopped_paying": ["a step"],
    "investigations": [NEWS, {**NEWS, "before": VERSION}, {**NEWS, "before": VERSION, "new": ["a"], "gone": ["b"]}],
    "stuck": ["job 3"],
    "failures": [
        {"job": 7, "kind": "refit", "request": {"scope": "array"}, "error": "no room", "again_after": after}
        for after in (None, "2020-01-02")
    ],
}  # fmt: skip
CAUSE = {
    "cause": "gain_step", "target": "antenna 3",
    "gains": [{"since": "2014-01-01T00", "until": "2015-01-01T00", "events": 40, "log_likelihood_gain": 7.25,
               "expected": 9.0, "expected_sigma": 4.0}],
}  # fmt: skip
MODEL = {
    "id": VERSION, "station": "CS002", "in_effect": True, "at": "2020-01-01", "by": "key 1", "reason": "snow",
    "act": "adopted", "changed": "a step", "causes": [CAUSE],
}  # fmt: skip
REPORT = {
    "verdict": "unexplained", "findings": [{"significance_sigma": 7.25, "sentence": "a step"}],
    "unexplained": {"description": "structure", "in_words": "power changes"},
}  # fmt: skip
PROMOTED = {**PATH, "promotion": 1, "calibration": None, "valid_from": "2014", "valid_to": None}
MANY = {"changes": [CHANGE] * 21, "left_out": {VERSION: "misfit"}, "promotions": [PROMOTED] * 22}
ADOPTION = {"model": VERSION, "cause": "a step", "promise": [-2.0, 1.0], "changes": []}
TOLD: list[tuple[Callable[[Any], object], dict[str, Any], str]] = [
    (print_receipt, {"received": 3, "stored": 2, "duplicates": 1}, "3 spectra sent: 2 stored, 1 there already"),
    (
        print_receipt, {"received": 3, "stored": 0, "duplicates": 3, "covariates": 1},
        "3 spectra sent: 0 stored, 3 there already, 1 covariate of events that were there known now",
    ),
    (
        lambda job: print_job(job, most=1), JOB,
        """job 7: refit station CS002 2014-01-01 to 2015-01-01, failed (50%), versions: 3, promoted: 1, no news: 1; map
  no room
  aaaaaaaaaaaa not promoted: is far off
  ffffffffffff promoted
  and 1 more""",
    ),
    (
        print_job, {**JOB, "state": "done", "progress": 1.0, "error": None, "promoted": [], "gated": {}},
        """job 7: refit station CS002 2014-01-01 to 2015-01-01, done (100%), versions: 3, promoted: 0, no news: 1; map
  not promoted: nobody asked for it; lbacal promote --job 7 does it""",
    ),
    (
        print_job,
        {**JOB, "state": "done", "error": None, "calibrations": [], "examined": 0, "promoted": [], "gated": {}},
        """job 7: refit station CS002 2014-01-01 to 2015-01-01, done (50%), versions: 0, promoted: 0, no news: 0; map
  no version was made: no spectra of this window and scope are stored""",
    ),
    (
        _print_jobs, {"jobs": [{**JOB, "kind": "drift", "error": None, "gated": {}}] * 2},
        """job 7: drift station CS002 2014-01-01 to 2015-01-01, failed (50%); map
job 7: drift station CS002 2014-01-01 to 2015-01-01, failed (50%); map""",
    ),
    (
        lambda done: print_act(done, dry_run=True), MANY,
        "\n".join([
            *["promotion 1: CS002 antenna 3 X has nothing from 2014 to open"] * 20,
            "and 2 more promotions",
            "0123456789ab is left out: misfit",
            "changes of what paths are served: 21 (dry run: nothing was written)",
            *["  CS002 antenna 3 X, 2014 to open: nothing -> 0123456789ab, C by up to 12.50 %"] * 20,
            "  and 1 more",
        ]),
    ),
    (
        _print_adoption, ADOPTION,
        """model 0123456789ab would be adopted: a step
promised on as many events again: log-likelihood -2.0 ± 1.0; so small a finding is not expected to pay
changes of what paths are served: 0 (dry run: nothing was written)""",
    ),
    (
        print_model, MODEL,
        """model 0123456789ab of CS002, in effect, 2020-01-01 by key 1: snow
  adopted: a step
  gain_step in antenna 3, 40 new events of 2014-01-01 to 2015-01-01: log-likelihood +7.2, expected 9.0 ± 4.0""",
    ),
    (
        print_state, STATE,
        """ready
worker w lives, seen 0 s ago
worker w is silent, seen 61 s ago
parts of jobs: 2 queued, 1 done
5 usable events, the newest of 2014-05-01T00:00:00Z; versions that wait for a human: 1
alarms: none
CS002, 2014-01-01 to 2015-01-01: explained (gain_step); investigation 0123456789ab
CS002, 2014-01-01 to 2015-01-01: explained (gain_step), as before; investigation 0123456789ab
CS002, 2014-01-01 to 2015-01-01: explained (gain_step); investigation 0123456789ab
  new: a
  no longer: b
CS002 waits
no longer pays: a step
stuck: job 3
failed: job 7 (refit array): no room
failed: job 7 (refit array): no room; again after 2020-01-02""",
    ),
    (
        print_investigation, {**NEWS, "report": REPORT},
        """CS002, 2014-01-01 to 2015-01-01: unexplained; investigation 0123456789ab
  #0 7.2 sigma: a step
  structure
  in words: power changes""",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("tell", "answer", "said"), TOLD)
def test_an_answer_is_told_in_words(
    tell: Callable[[Any], object], answer: dict[str, Any], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    tell(answer)
    assert capsys.readouterr().out.rstrip() == said
