from __future__ import annotations

import csv
import hashlib
import io
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from astropy.table import Table
from fastapi.testclient import TestClient
from sqlalchemy import Engine, event, update

from lbacal.calibration_files import read_calibrations
from lbacal.instants import format_instant
from lbacal.tables import rows_of
from lbacal_core.curves.galcal import find_problems
from lbacal_core.curves.validity import Scope
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.provenance import canonical_json
from service.app import make_app
from service.factory import Factory
from service.schema.tables import calibration
from service.storage.changes import RECORD, Change, Evidence
from service.storage.versions import Version
from service.usecases.calibrations import Calibrations
from tests.service.conftest import add_spectra, flat_spectra, instant, like, new_version, promote

Stored = dict[str, Version]
NUMBERS = ("c", "c_sigma_stat", "c_sigma_sys", "factor", "frequency_mhz")


def ask(client: TestClient, at: str = "2014-06-01", **params: Any) -> Any:
    return client.get("/v1/calibrations/effective", params={"at": at, **params})


PATH = {"station": "CS001", "antenna": 0, "dipole": "X"}


def test_a_path_asked_for_again_costs_four_statements_and_no_transaction(
    client: TestClient, stored: Stored, factory: Factory, monkeypatch: pytest.MonkeyPatch
) -> None:
    promote(client, stored["station"], "2014-01-01")
    client.headers.pop("Authorization")
    first = ask(client, **PATH)
    statements: list[str] = []

    def note(_connection: Any, _cursor: Any, statement: str, *_: Any) -> None:
        statements.append(statement)

    monkeypatch.setattr(type(factory.database), "read", None)
    event.listen(Engine, "before_cursor_execute", note)
    try:
        again = ask(client, **PATH)
    finally:
        event.remove(Engine, "before_cursor_execute", note)
    assert (again.status_code, again.content) == (200, first.content)
    assert len(statements) == 4, "who answers, which changes are known, what waits, and which spectra are left out"


def test_why_names_no_version_at_the_gate_that_is_older_than_what_answers(
    client: TestClient, stored: Stored, factory: Factory
) -> None:
    promote(client, stored["path"], "2014-01-01", "2014-06-01")
    for later, is_told in ((-1, False), (1, True)):
        name, made = f"gated {later}", stored["path"].made + later
        gated = replace(stored["path"], inputs={"name": name}, made=made, gate="a jump")
        with factory.database.write() as stores:
            stores.versions.add([gated])
        (curve,) = ask(client, "2014-03-01", **PATH).json()["curves"]
        assert ("waits for a person to promote it (a jump)" in curve["why"]) == is_told


def test_a_gap_and_what_is_held_over_it_name_the_version_that_waits(
    client: TestClient, stored: Stored, factory: Factory
) -> None:
    """Nothing was in effect in the year, and nothing said that six versions of it waited at the gate."""
    gated = replace(stored["path"], inputs={"name": "gated"}, made=stored["path"].made - 1, gate="a jump")
    with factory.database.write() as stores:
        stores.versions.add([gated])
    promote(client, stored["other"], "2013-01-01", "2014-01-01")
    said = f"version {gated.id[:12]} of CS001 antenna 0 X waits for a person to promote it (a jump)"
    with factory.database.write() as stores:  # the others of the window are made before it
        table = calibration.c
        stores.versions._connection.execute(update(calibration).where(table.id != gated.id).values(made_us=1))
    refused = ask(client, "2014-03-01", **PATH)
    assert (refused.status_code, said in refused.json()["detail"]) == (404, True)
    (held,) = ask(client, "2014-03-01", gap="hold", **PATH).json()["curves"]
    assert held["why"].endswith(said)
    promote(client, stored["array"], "2013-01-01")
    (wider,) = ask(client, "2014-03-01", **PATH).json()["curves"]
    assert (wider["answered_by"], set(wider["flag"])) == ("array", {"uncertain"})
    assert wider["flag_reason"].startswith(said), "every channel was ok"


@pytest.mark.parametrize(
    ("status", "coverage", "is_told"),
    [("not_identifiable", 0.7, True), ("not_identifiable", 0.1, False), ("too_few_events", 0.7, False)],
)
def test_a_path_that_hears_no_sky_was_served_the_mean_of_its_station_as_ok(
    client: TestClient, stored: Stored, factory: Factory, status: str, coverage: float, is_told: bool
) -> None:
    blind = new_version(Scope("CS001", 0, "X"), "blind", status=status, made=stored["path"].made + 1, gate=status)
    with factory.database.write() as stores:
        stores.versions.add([replace(blind, curves=[replace(one, lst_coverage=coverage) for one in blind.curves])])
    promote(client, stored["station"], "2014-01-01", "2015-01-01")
    own, other = (ask(client, "2014-03-01", **PATH | {"antenna": a}).json()["curves"][0] for a in (0, 1))
    said = f"version {blind.id[:12]} of CS001 antenna 0 X cannot be promoted ({status})"
    assert (own["answered_by"], set(own["flag"])) == ("station", {"uncertain"})
    assert own["flag_reason"].startswith(said) == is_told
    assert said not in other["flag_reason"]
    rows = ask(client, "2014-03-01", format="csv", **PATH).text
    assert (said in rows) == is_told


def test_why_names_the_step_that_a_person_dismissed(client: TestClient, stored: Stored) -> None:
    """The alarm and the life of the path named it, and what is served as the mean over it did not."""
    body = {"paths": [{"station": "CS001", "antenna": 0}], "at": {"value": "2014-07-01"}, "reason": "test"}
    assert client.post("/v1/changes", json=body).status_code == 201
    promote(client, stored["path"], "2014-01-01", "2015-01-01")
    promote(client, stored["station"], "2014-01-01", "2015-01-01")
    body = {"decision": "dismissed", "reason": "it was snow"}
    assert client.post("/v1/changes/1/decision", json=body).status_code == 201
    (own, other) = (ask(client, "2014-03-01", **PATH | {"antenna": a}).json()["curves"][0]["why"] for a in (0, 1))
    assert "; change 1 (step) of 2014-07-01 was dismissed 20" in own
    assert own.endswith("by key 1 (it was snow)")
    assert "dismissed" not in other


def test_a_version_that_a_person_put_over_a_change_is_told_as_that(
    client: TestClient, stored: Stored, factory: Factory
) -> None:
    """It was said to be the mean over a change that was not yet refitted."""
    body = {"paths": [{"station": "CS001", "antenna": 0}], "at": {"value": "2015-03-01"}, "reason": "test"}
    assert client.post("/v1/changes", json=body).status_code == 201
    promote(client, stored["path"], "2014-01-01")
    reasons = [ask(client, at, **PATH).json()["curves"][0]["flag_reason"] for at in ("2015-02-28", "2015-06-01")]
    said = "CS001 antenna 0 changed on 2015-03-01: key 1 put a version of before it into effect over it (test)"
    assert reasons == [None, said]
    assert all(one.is_refitted for one in factory.changes.list_all())


@pytest.mark.parametrize(("name", "start"), [("station", "2014-01-01"), ("path", "2016-01-01")])
def test_a_mean_over_a_change_of_its_path_and_a_pin_that_was_fitted_over_one_were_served_as_ok(
    client: TestClient, stored: Stored, factory: Factory, name: str, start: str
) -> None:
    times = (instant(f"2014-{month}-01") / 1e6 for month in ("03", "09"))
    add_spectra(factory, flat_spectra(*((f"e{at}", at, "CS001", 0, dipole) for at in times for dipole in "XY")))
    paths = [{"station": "CS001", "antenna": 0, "dipole": "X"}]
    body = {"paths": paths, "at": {"value": "2014-07-01"}, "reason": "test"}
    assert client.post("/v1/changes", json=body).status_code == 201
    promote(client, stored[name], start)
    (curve,) = ask(client, "2016-08-01", **PATH).json()["curves"]
    said = "CS001 antenna 0 changed on 2014-07-01 (change 1): C in effect was fitted to spectra of before and after"
    assert (set(curve["flag"]), curve["flag_reason"].split("; ")[0]) == ({"uncertain"}, said)
    if name == "station":
        (other,) = ask(client, "2016-08-01", **PATH | {"dipole": "Y"}).json()["curves"]
        assert said not in str(other["flag_reason"])


@pytest.mark.parametrize(("last", "is_told"), [("2014-06-30", False), ("2014-07-02", True)])
def test_c_of_before_a_change_was_said_to_be_of_both_sides_as_soon_as_later_spectra_came(
    client: TestClient, stored: Stored, factory: Factory, last: str, is_told: bool
) -> None:
    """Its window was the year, and its spectra ended before the change."""
    span = instant("2014-01-01") / 1e6, instant(last) / 1e6
    curves = [replace(one, span_unix=span) for one in stored["path"].curves]
    version = replace(stored["path"], curves=curves, inputs={"name": last}, made=stored["path"].made + 1)
    with factory.database.write() as stores:
        stores.versions.add([version])
    times = (instant(f"2014-{month}-01") / 1e6 for month in ("03", "09"))
    add_spectra(factory, flat_spectra(*((f"e{at}", at, "CS001", 0, "X") for at in times)))
    body = {"paths": [{"station": "CS001", "antenna": 0}], "at": {"value": "2014-07-01"}, "reason": "test"}
    assert client.post("/v1/changes", json=body).status_code == 201
    promote(client, version, "2014-01-01", "2014-07-01")
    (curve,) = ask(client, "2014-06-01", **PATH).json()["curves"]
    assert ("spectra of before and after" in str(curve["flag_reason"])) == is_told


def test_the_narrowest_scope_in_effect_answers_and_says_so(client: TestClient, stored: Stored) -> None:
    promote(client, stored["array"], "2013-01-01")
    promote(client, stored["station"], "2014-01-01", "2015-01-01")
    promote(client, stored["path"], "2014-03-01", "2014-04-01")
    found = [
        ask(client, at, **PATH).json()["curves"][0]["answered_by"]
        for at in ("2013-01-01", "2014-01-01", "2014-03-01", "2014-04-01", "2014-12-31T23:59:59.999999Z", "2015-01-01")
    ]
    assert found == ["array", "station", "antenna", "station", "station", "array"]
    curve = ask(client, "2014-03-05", **PATH).json()["curves"][0]
    assert curve["c"] == [1.2, 2.4, 1.2 * 3.0, 4.8]
    assert curve["calibration"] == stored["path"].id
    assert curve["valid"] == {"from": "2014-03-01T00:00:00Z", "to": "2014-04-01T00:00:00Z"}
    assert curve["held"] is False
    assert [step["scope"] for step in curve["trace"]] == ["antenna"]


def test_a_mean_without_a_dipole_does_not_answer_for_it(client: TestClient, stored: Stored, factory: Factory) -> None:
    (curve,) = (one for one in stored["station"].curves if one.dipole == "X")
    only_x = replace(stored["station"], curves=(curve,), inputs={**stored["station"].inputs, "spectra": "of X alone"})
    with factory.database.write() as stores:
        stores.versions.add([only_x])
    promote(client, only_x, "2014-01-01")
    assert ask(client, **PATH).status_code == 200
    refused = ask(client, **PATH | {"dipole": "Y"})
    assert refused.status_code == 404
    assert refused.json()["detail"] == "CS001 antenna 0 Y: the mean that is in effect has no curve of this dipole"
    assert len(ask(client, station="CS001").json()["curves"]) == 3
    promote(client, stored["array"], "2014-01-01")
    (answer,) = ask(client, **PATH | {"dipole": "Y"}).json()["curves"]
    assert (answer["answered_by"], [one["scope"] for one in answer["trace"]]) == ("array", ["station", "array"])
    of_station = ask(client, station="CS001").json()["curves"]
    assert {(one["dipole"], one["answered_by"]) for one in of_station} == {("X", "station"), ("Y", "array")}


def test_a_station_has_all_its_paths_and_no_station_all_paths(client: TestClient, stored: Stored) -> None:
    promote(client, stored["array"], "2013-01-01")
    whole, station = ask(client).json()["curves"], ask(client, station="CS002").json()["curves"]
    assert [(c["station"], c["antenna"], c["dipole"]) for c in station] == [
        ("CS002", a, d) for a in range(3) for d in "XY"
    ]
    assert len(whole) == 12
    assert len(ask(client, dipole="Y").json()["curves"]) == 6


def test_rollback_is_promoting_the_old_version_again(client: TestClient, stored: Stored) -> None:
    first = promote(client, stored["path"], "2014-01-01")
    second = promote(client, stored["other"], "2014-01-01")
    promote(client, stored["path"], "2014-01-01")
    now = ask(client, **PATH).json()
    assert now["curves"][0]["calibration"] == stored["path"].id
    then = ask(client, as_of=second["at"], **PATH).json()
    assert (then["as_of"], then["curves"][0]["calibration"]) == (second["at"], stored["other"].id)
    assert ask(client, as_of=first["at"], **PATH).json()["curves"][0]["calibration"] == stored["path"].id
    assert ask(client, as_of="2019-01-01", **PATH).status_code == 404


def test_withdrawal_uncovers_the_wider_scope(client: TestClient, stored: Stored) -> None:
    promote(client, stored["array"], "2013-01-01")
    promote(client, stored["path"], "2014-01-01")
    promote(client, None, "2014-05-01", "2014-07-01", **PATH)
    curve = ask(client, **PATH).json()["curves"][0]
    assert curve["answered_by"] == "array"
    trace = [(step["scope"], step["calibration"]) for step in curve["trace"]]
    assert trace == [("antenna", None), ("array", stored["array"].id)]
    withdrawn = "; what CS001 antenna 0 X has from 2014-05-01T00:00:00Z to 2014-07-01T00:00:00Z was withdrawn 2020-"
    assert withdrawn in curve["why"], "the sentence told of the promotion of the array alone"
    assert curve["why"].endswith(" by key 1 (test)")
    promote(client, stored["path"], "2014-05-01", "2014-07-01")
    (line,) = client.get("/v1/paths/CS001/0/X/life").json()["withdrawals"]
    assert (line["valid_from"][:10], line["valid_to"][:10], line["reason"]) == ("2014-05-01", "2014-07-01", "test")
    assert client.get("/v1/paths/CS001/0/Y/life").json()["withdrawals"] == []
    assert "withdrawn by key 1 on 2020-01-01: test" in client.get("/paths/CS001/0/X").text


def test_a_gap_names_its_neighbours_and_can_be_held(client: TestClient, stored: Stored) -> None:
    promote(client, stored["path"], "2014-01-01", "2014-02-01")
    promote(client, stored["other"], "2014-07-01", "2014-08-01")
    answer = ask(client, "2014-06-20", **PATH)
    assert answer.status_code == 404
    detail = answer.json()["detail"]
    assert f"{stored['path'].id} was until 2014-02-01T00:00:00Z" in detail
    assert f"{stored['other'].id} is from 2014-07-01T00:00:00Z" in detail
    held = [
        ask(client, at, gap="hold", **PATH).json()["curves"][0]
        for at in ("2014-02-02", "2014-06-20", "2030-01-01", "1990-01-01")
    ]
    assert [c["calibration"] for c in held] == [stored[n].id for n in ("path", "other", "other", "path")]
    assert all(c["held"] for c in held)
    assert "gap=hold of GET /v1/calibrations/effective answers with the nearest" in detail
    nothing = {"at": "2014-06-20", "station": "CS002"}
    for asked, end in ((nothing, ""), ({**nothing, "as_of": "2010-01-01"}, ", as known at 2010-01-01T00:00:00Z")):
        told = ask(client, **asked).json()["detail"]
        assert told.endswith(f"none was or will be at another time{end}"), "no more than was known then"
    for wrong, sentence in (("77", "expected an antenna of CS001 (0 to 2), found 77"), ("-1", "digits, 0 or more")):
        assert sentence in ask(client, "2014-06-20", station="CS001", antenna=wrong).json()["detail"]
    assert "%2B" in client.get("/v1/calibrations/effective?at=2014-06-20T00:00:00+02:00").json()["detail"]


def test_c_held_over_a_change_was_served_without_a_word_of_it_though_a_version_of_its_own_side_was_there(
    client: TestClient, stored: Stored
) -> None:
    at = {"value": "2016-02-01", "sigma_days": 0.1}
    size = {"value": 0.3, "sigma": 0.01}
    body = {"paths": [{"station": "CS001", "antenna": 0, "dipole": "X"}], "at": at, "size": size, "reason": "test"}
    assert client.post("/v1/changes", json=body).status_code == 201
    promote(client, stored["array"], "2014-01-01", "2016-01-01")

    def hold(at: str, **path: Any) -> tuple[str, str]:
        (curve,) = ask(client, at, gap="hold", **PATH | path).json()["curves"]
        return curve["calibration"], curve["flag_reason"]

    held = "held: nothing is in effect, the nearest in time answers"
    said = "CS001 antenna 0 changed on 2016-02-01 by +30.00 ± 1.00 % (change 1): C held is that of before"
    assert hold("2016-03-01")[1].split("; ")[:2] == [held, said]
    for at, path in (("2016-01-31", {}), ("2016-03-01", {"dipole": "Y"}), ("2016-03-01", {"antenna": 1})):
        assert said not in hold(at, **path)[1]
    promote(client, stored["other"], "2016-09-01", "2016-10-01")
    assert hold("2016-03-01") == (stored["other"].id, held), "the nearest in time is of before"
    assert hold("2016-01-31")[0] == stored["array"].id


def test_c_held_followed_a_ramp_without_limit(client: TestClient, stored: Stored, factory: Factory) -> None:
    ramp = Change("CS001", ((0, "X"),), "ramp", instant("2013-01-01"), 0, 0.05, 0.001)
    with factory.database.write() as stores:
        stores.changes.note(ramp, Evidence("drift", "", 9.0, 0))
    promote(client, stored["path"], "2014-01-01", "2015-01-01")
    last, *held = (
        ask(client, at, gap="hold", **PATH).json()["curves"][0]["factor"]
        for at in ("2014-12-31T23:59", "2015-01-01", "2020-01-01", "2040-01-01")
    )
    assert held == [last] * 3


def test_what_waits_was_no_more_told_once_the_window_was_over(
    client: TestClient, stored: Stored, factory: Factory
) -> None:
    gated = replace(stored["path"], inputs={"name": "gated"}, made=stored["path"].made + 1, gate="a jump")
    with factory.database.write() as stores:
        stores.versions.add([gated])
    promote(client, stored["station"], "2014-01-01", format_instant(gated.until))
    said = f"version {gated.id[:12]} of CS001 antenna 0 X waits for a person to promote it (a jump)"
    for at in (gated.until - 1, gated.until):
        (curve,) = ask(client, format_instant(at), gap="hold", **PATH).json()["curves"]
        assert said in curve["flag_reason"]


def test_a_station_that_the_instrument_has_no_more_is_known_to_who_reads(
    client: TestClient, stored: Stored, factory: Factory, instrument: Instrument, tmp_path: Path
) -> None:
    """After a station was renamed in the instrument file, a tag refused its old name, and a sync left it out."""
    promote(client, stored["path"], "2014-01-01")
    add_spectra(factory, flat_spectra(("e", instant("2014-03-01") / 1e6, "CS001", 0, "X")))
    assert client.put("/v1/tags/paper", json={"reason": "test"}).status_code == 201
    asked = [
        ("/v1/calibrations/effective", {"at": "2014-06-01", "tag": "paper", **PATH}),
        ("/v1/calibrations", {"station": "CS001"}), ("/v1/stations/CS001/life", {}), ("/stations/CS001", {}),
    ]  # fmt: skip
    before = client.get(asked[0][0], params=asked[0][1]).content
    content = instrument.as_dict()
    for one in content["antennas"]:
        one["station"] = one["station"].replace("CS001", "CS101")
    (tmp_path / "renamed.json").write_text(json.dumps(content))
    with like(factory, instrument=str(tmp_path / "renamed.json")) as other:
        renamed = TestClient(make_app(other))
        answers = [renamed.get(route, params=params) for route, params in asked]
        assert ([one.status_code for one in answers], answers[0].content) == ([200] * 4, before)
        edges = renamed.get("/v1/calibrations/edges", params={"as_of": format_instant(factory.clock())}).json()
        assert {"CS001", "CS101"} <= {one["station"] for one in edges["stations"]}
        assert renamed.get("/v1/calibrations", params={"station": "CS009"}).status_code == 422


def test_paths_with_nothing_in_effect_are_named_as_missing(client: TestClient, stored: Stored) -> None:
    promote(client, stored["path"], "2014-01-01")
    content = ask(client, station="CS001").json()
    assert len(content["curves"]) == 1
    assert len(content["missing"]) == 5


@pytest.mark.parametrize(
    "params",
    [
        {"at": "2014"}, {"at": "20140501"}, {"at": "56778"}, {"at": ""}, {}, {"at": "2014-06-01", "mjd": "56778"},
        {"mjd": "2014-06-01"}, {"at": "2014-06-01", "as_of": "2030-01-01"}, {"at": "2014-06-01", "as_of": "2014"},
        {"at": "2014-06-01", "antenna": 0}, {"at": "2014-06-01", "station": "CS009"},
        {"at": "2014-06-01", "station": "CS001", "antenna": 77},
        {"at": "2014-06-01", "station": "CS001", "antenna": "x"},
        {"at": "2014-06-01", "dipole": "Z"}, {"at": "2014-06-01", "format": "xml"}, {"at": "2014-06-01", "gap": "fill"},
        {"at": "2014-06-01", "sation": "CS001"}, {"at": ["2014-06-01", "2014-06-02"]},
        {"at": "2014-06-01", "station": "CS001", "format": "nuradio"},
    ],
)  # fmt: skip
def test_a_bad_question_is_refused(client: TestClient, stored: Stored, params: dict[str, Any]) -> None:
    promote(client, stored["array"], "2013-01-01")
    answer = client.get("/v1/calibrations/effective", params=params)
    assert answer.status_code == 422, answer.text
    assert answer.headers["content-type"] == "application/problem+json"


def test_the_date_may_be_given_as_mjd(client: TestClient, stored: Stored) -> None:
    promote(client, stored["array"], "2013-01-01")
    answer = client.get("/v1/calibrations/effective", params={"mjd": "56809.5"})
    assert answer.json()["at"] == "2014-06-01T12:00:00Z"


def test_the_same_question_has_the_same_bytes_and_a_settled_one_never_expires(
    client: TestClient, stored: Stored, clock: Any
) -> None:
    at = promote(client, stored["array"], "2013-01-01")["at"]
    fresh = ask(client, as_of=at)
    clock.now += 61_000_000
    settled = ask(client, as_of=at)
    assert settled.content == fresh.content
    assert "immutable" not in fresh.headers["cache-control"]
    assert "immutable" in settled.headers["cache-control"]
    assert "immutable" not in ask(client).headers["cache-control"]
    etag = {"If-None-Match": settled.headers["etag"]}
    again = client.get("/v1/calibrations/effective", params={"at": "2014-06-01", "as_of": at}, headers=etag)
    assert (again.status_code, again.content) == (304, b"")


@pytest.mark.long
def test_what_is_remembered_of_all_paths_is_what_a_fresh_server_says(
    client: TestClient, stored: Stored, factory: Factory
) -> None:
    """In every stretch, whatever was promoted, withdrawn or found to have changed since."""
    step = {"station": "CS001", "at": {"value": "2014-03-01", "sigma_days": 1}, "reason": "test"}
    ramp = {**step, "kind": "ramp", "size": {"value": 0.1, "sigma": 0.02}}
    acts: list[Callable[[], Any]] = [
        lambda: promote(client, stored["station"], "2014-01-01", "2015-01-01"),
        lambda: promote(client, stored["path"], "2014-05-01", "2014-06-01"),
        lambda: client.post("/v1/changes", json=step).raise_for_status(),
        lambda: client.post("/v1/changes", json=ramp).raise_for_status(),
        lambda: promote(client, stored["array"], "2013-01-01"),
        lambda: promote(client, None, "2014-02-01", "2014-08-01", station="CS001"),
        lambda: client.post("/v1/promotions/2/rollback", json={"reason": "test"}).raise_for_status(),
        lambda: client.post(
            "/v1/changes/2/decision", json={"decision": "dismissed", "reason": "test"}
        ).raise_for_status(),
    ]
    client.headers["accept-encoding"] = "identity"  # whose length is told
    instants = ["2014-01-01", "2014-02-15", "2014-02-16", "2014-03-02", "2014-05-02", "2014-12-31T23:59:59.999999"]
    for act in acts:
        act()
        for at in [*instants, *instants]:
            with like(factory) as fresh, TestClient(make_app(fresh), headers=client.headers) as other:
                first = ask(other, at)
            found = ask(client, at)
            assert (found.status_code, found.content) == (200, first.content)
            assert found.headers["etag"] == first.headers["etag"]
            assert int(found.headers["content-length"]) == len(found.content)
            held = client.get(found.request.url, headers={"If-None-Match": found.headers["etag"]})
            assert (held.status_code, held.content) == (304, b"")


def test_all_paths_asked_for_again_at_an_instant_are_not_put_together_again(
    client: TestClient, stored: Stored, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beyond 5,000 paths an answer took 13 times as long as its bytes from memory."""
    promote(client, stored["array"], "2013-01-01", "2015-01-01")
    first = ask(client, "2014-06-01").json()
    monkeypatch.setattr(Calibrations, "in_effect", None)
    assert ask(client, "2014-06-01").json() == first
    monkeypatch.undo()
    promote(client, stored["station"], "2013-01-01", "2015-01-01")
    assert ask(client, "2014-06-01").json()["curves"] != first["curves"]


def read_columns(kind: str, body: bytes) -> dict[str, list[Any]]:
    """The columns of an answer in a format that is not JSON; None where there is no value."""
    if kind == "csv":
        rows = [
            {name: value or None for name, value in row.items()} for row in csv.DictReader(io.StringIO(body.decode()))
        ]
        return {
            name: [float(row[name]) if name in NUMBERS and row[name] else row[name] for row in rows] for name in rows[0]
        }
    if kind == "hdf5":
        with h5py.File(io.BytesIO(body)) as root:
            assert root.attrs["format"] == "lbacal-effective-1"
            assert {name: root[name].attrs["unit"] for name in ("c", "factor")} == {"c": "V", "factor": ""}
            found = {n: root[n].asstr()[:] if h5py.check_string_dtype(root[n].dtype) else root[n][:] for n in root}
    else:
        table = Table.read(
            body.decode() if kind == "ecsv" else io.BytesIO(body), format={"ecsv": "ascii.ecsv"}.get(kind, kind)
        )
        assert (str(table["c"].unit), str(table["frequency_mhz"].unit)) == ("V", "MHz")
        found = {
            name: np.ma.filled(table[name], "" if table[name].dtype.kind in "SU" else np.nan) for name in table.colnames
        }
    columns = {name: np.char.decode(v) if v.dtype.kind == "S" else v for name, v in found.items()}
    return {
        name: [None if v in ("", -1) or (isinstance(v, float) and math.isnan(v)) else v for v in values.tolist()]
        for name, values in columns.items()
    }


@pytest.mark.parametrize("ending", ["json", "ecsv", "fits", "hdf5"])
def test_what_is_served_is_a_calibration_file_that_follows_its_format(
    client: TestClient, stored: Stored, tmp_path: Path, ending: str
) -> None:
    promote(client, stored["array"], "2014-01-01")
    path = tmp_path / f"c.{ending}"
    path.write_bytes(ask(client, station="CS001", format=ending).content)
    content = read_calibrations(path)
    assert find_problems(content) == []
    assert len(content["curves"]) == 6
    assert content["at"] == "2014-06-01T00:00:00Z"


@pytest.mark.parametrize("kind", ["csv", "ecsv", "fits", "hdf5"])
@pytest.mark.parametrize("scope", [{"station": "CS001"}, {"scope": "array"}])
def test_all_formats_carry_all_fields_of_the_rows(
    client: TestClient, stored: Stored, kind: str, scope: dict[str, str]
) -> None:
    promote(client, stored["array"], "2014-01-01")
    promote(client, stored["path"], "2014-01-01", "2015-01-01")
    told = client.get("/v1/calibrations/effective", params={"at": "2014-06-01", "format": kind, **scope})
    assert told.status_code == 200, told.text
    again = ask(client, format=kind, **scope)
    assert (told.content, told.headers["etag"]) == (again.content, again.headers["etag"])
    expected = rows_of(ask(client, **scope).json())
    columns = read_columns(kind, told.content)
    assert list(columns) == sorted(expected[0]) if kind == "hdf5" else list(expected[0])
    for name, values in columns.items():
        said = [str(value) if name == "antenna" and value is not None else value for value in values]
        wanted = [str(row[name]) if name == "antenna" and row[name] is not None else row[name] for row in expected]
        assert said == wanted, name


def test_a_route_with_one_media_type_is_406_for_whoever_takes_another(client: TestClient, stored: Stored) -> None:
    body = {"calibration": stored["path"].id, "valid_from": "2014-01-01", "reason": "test"}
    for method, path, more in (("GET", "/v1/jobs", {}), ("POST", "/v1/promotions", {"json": body}), ("GET", "/", {})):
        answer = client.request(method, path, headers={"Accept": "application/pdf"}, **more)
        assert (answer.status_code, answer.json()["type"]) == (406, "urn:lbacal:not_acceptable")
    assert client.get("/v1/calibrations/effective", params={"at": "2014-06-01"}).status_code == 404, "nothing was done"


def test_the_header_accept_chooses_a_format_and_nuradio_has_one_curve(client: TestClient, stored: Stored) -> None:
    promote(client, stored["station"], "2014-01-01", "2015-01-01")
    asked = {"at": "2014-06-01", "station": "CS001"}
    accepted = client.get("/v1/calibrations/effective", params=asked, headers={"Accept": "text/csv"})
    assert accepted.headers["content-type"].startswith("text/csv")
    values = np.loadtxt(io.StringIO(ask(client, format="nuradio", **PATH).text))
    assert values.shape == (101,)
    assert (values[29], values[30], values[45], values[80], values[81]) == (0.0, 1.1, 2.2, 4.4, 0.0)


def test_versions_are_listed_and_verified_by_their_hashes(client: TestClient, stored: Stored) -> None:
    first = client.get("/v1/calibrations", params={"limit": 3}).json()
    rest = client.get("/v1/calibrations", params={"limit": 3, "cursor": first["next"]}).json()
    assert {v["id"] for v in first["calibrations"] + rest["calibrations"]} == {v.id for v in stored.values()}
    answer = client.get(f"/v1/calibrations/{stored['path'].id}")
    content = answer.json()
    assert hashlib.sha256(canonical_json(content["inputs"]).encode()).hexdigest() == content["id"]
    assert hashlib.sha256(canonical_json(content["curves"]).encode()).hexdigest() == content["payload_sha256"]
    assert "immutable" in answer.headers["cache-control"]
    assert client.get("/v1/calibrations/none").status_code == 404
    of_path = client.get("/v1/calibrations", params=PATH).json()["calibrations"]
    assert {v["id"] for v in of_path} == {stored[n].id for n in ("path", "other", "failed")}
    assert len(client.get("/v1/calibrations", params={"status": "too_few_events"}).json()["calibrations"]) == 1


def test_two_versions_differ_by_a_fraction_of_c(client: TestClient, stored: Stored) -> None:
    content = client.get(f"/v1/calibrations/{stored['path'].id}/diff/{stored['other'].id}").json()
    assert content["curves"][0]["fraction"] == pytest.approx([1.3 / 1.2 - 1.0] * 4)
    assert content["curves"][0]["max_sigma"] == pytest.approx(0.4 / np.hypot(0.01, 0.01))
    assert content["inputs"] == {"name": {"first": "path", "second": "other"}}


def test_a_dry_run_tells_the_changes_and_writes_nothing(client: TestClient, stored: Stored) -> None:
    promote(client, stored["station"], "2014-01-01", "2015-01-01")
    body = {"calibration": stored["path"].id, "valid_from": "2014-07-01", "valid_to": "2015-07-01", "reason": "x"}
    tried = client.post("/v1/promotions?dry_run=true", json=body)
    assert tried.status_code == 200
    changes = tried.json()["changes"]
    assert [(c["from"], c["to"], c["before"], c["after"]) for c in changes] == [
        ("2014-07-01T00:00:00Z", "2015-01-01T00:00:00Z", stored["station"].id, stored["path"].id),
        ("2015-01-01T00:00:00Z", "2015-07-01T00:00:00Z", None, stored["path"].id),
    ]
    assert changes[0]["max_fraction"] == pytest.approx(1.2 / 1.1 - 1.0)
    assert changes[1]["max_fraction"] is None
    assert ask(client, "2014-08-01", **PATH).json()["curves"][0]["answered_by"] == "station"
    done = client.post("/v1/promotions", json=body).json()
    assert done["changes"] == changes


def test_withdrawing_where_nothing_was_changes_nothing(client: TestClient) -> None:
    assert promote(client, None, "2014-01-01", scope="array")["changes"] == []


@pytest.mark.parametrize(
    ("change", "status"),
    [
        ({"calibration": "0" * 64}, 404), ({"valid_to": "2014-01-01"}, 422), ({"valid_from": "2014"}, 422),
        ({"reason": ""}, 422), ({"station": "CS002"}, 422), ({"antenna": 0}, 422),
        ({"calibration": None, "scope": "array", "antenna": 0, "dipole": "X"}, 422),
        ({"calibration": None, "scope": "array", "station": "CS009"}, 422),
        ({"calibration": None, "scope": "array", "station": "CS001", "antenna": 99, "dipole": "X"}, 422),
        ({"valid_form": "2014-01-01"}, 422),
    ],
)  # fmt: skip
def test_a_bad_promotion_is_refused(client: TestClient, stored: Stored, change: dict[str, Any], status: int) -> None:
    body = {"calibration": stored["array"].id, "valid_from": "2014-01-01", "valid_to": None, "reason": "x", **change}
    answer = client.post("/v1/promotions", json=body)
    assert answer.status_code == status, answer.text
    assert ask(client).status_code == 404


def test_a_version_that_did_not_converge_cannot_be_promoted(client: TestClient, stored: Stored) -> None:
    body = {"calibration": stored["failed"].id, "valid_from": "2014-01-01", "reason": "x"}
    assert client.post("/v1/promotions", json=body).status_code == 409


def test_a_promotion_whose_answer_was_lost_is_not_made_twice(client: TestClient, stored: dict[str, Version]) -> None:
    body = {"calibration": stored["array"].id, "valid_from": "2014-01-01", "reason": "test"}
    ask = {"url": "/v1/promotions", "json": body, "headers": {"Idempotency-Key": "mine"}}
    first, second = client.post(**ask), client.post(**ask)
    assert (first.status_code, second.status_code) == (201, 201)
    assert first.content == second.content
    changed = {**body, "reason": "other"}
    assert client.post(**{**ask, "json": changed}).status_code == 409
    assert client.post("/v1/promotions", json=body).json()["promotion"] != first.json()["promotion"]


def test_short_ids_are_taken_where_one_version_has_them(client: TestClient, stored: Stored, factory: Factory) -> None:
    """Pages and commands print ten to twelve digits; the interface wanted 64."""
    first, second = stored["path"], stored["other"]
    for digits in (6, 10, 12, 63):
        found = client.get(f"/v1/calibrations/{first.id[:digits]}")
        assert (found.status_code, found.json()["id"]) == (200, first.id)
        assert "immutable" not in found.headers["cache-control"]
        assert client.get(f"/calibrations/{first.id[:digits]}").status_code == 200
    assert "immutable" in client.get(f"/v1/calibrations/{first.id}").headers["cache-control"]
    told = client.get(f"/v1/calibrations/{first.id[:8]}/diff/{second.id[:8]}").json()
    assert (told["first"], told["second"]) == (first.id, second.id)
    body = {"calibration": first.id[:10], "valid_from": "2014-01-01", "reason": "test"}
    assert client.post("/v1/promotions", json=body).json()["calibration"] == first.id
    wrongs = (first.id[:5], first.id[:10].upper(), first.id[:9] + "%25", "_" * 10, first.id[:63] + "g", first.id + "0")
    for wrong in wrongs:
        assert client.get(f"/v1/calibrations/{wrong}").status_code == 404, wrong
    detail = client.get(f"/v1/calibrations/{first.id[:5]}").json()["detail"]
    assert detail == f"'{first.id[:5]}' names no version: 6 or more digits of its id do"
    alike = [new_version(Scope("CS001", 0, "X"), f"name {k}") for k in (6597, 6634)]
    assert alike[0].id[:6] == alike[1].id[:6], "two names whose hashes begin alike"
    with factory.database.write() as stores:
        stores.versions.add(alike)
    refused = client.get(f"/v1/calibrations/{alike[0].id[:6]}")
    assert (refused.status_code, "more digits of the id of one version" in refused.json()["detail"]) == (422, True)


def test_an_answer_has_its_epoch_and_says_why(client: TestClient, stored: Stored) -> None:
    promote(client, stored["array"], "2013-01-01")
    promote(client, stored["path"], "2014-01-01", "2015-01-01", reason="better")
    (curve,) = ask(client, **PATH).json()["curves"]
    assert curve["epoch"] == {"from": None, "to": None, "because": None}
    assert curve["why"].startswith("made 2019-12-31T00:00:00Z by test (test), in effect since ")
    assert curve["why"].endswith("(better); no change in force bounds its epoch")
    assert len({one["why"] for one in ask(client).json()["curves"]}) == 2
    (reference,) = ask(client, scope="array", dipole="X").json()["curves"]
    assert reference["epoch"] == curve["epoch"]


@pytest.mark.parametrize(("size", "is_told"), [(None, True), (-0.3, True), (0.001, False)])
def test_near_a_date_that_is_not_known_well_c_is_uncertain_where_the_change_is_more_than_its_error(
    client: TestClient, stored: Stored, factory: Factory, size: float | None, *, is_told: bool
) -> None:
    """Between two campaigns C of before a step of 30 % was served as right, until the middle of the months between."""
    promote(client, stored["path"], "2014-01-01", "2015-01-01")
    paths = [{"station": "CS001", "antenna": 0, "dipole": "X"}]
    body = {"paths": paths, "kind": "step", "at": {"value": "2015-01-01", "sigma_days": 50.0}, "reason": "test"}
    if size is not None:
        body |= {"size": {"value": size, "sigma": 0.0001}}
    assert client.post("/v1/changes", json=body).status_code == 201
    said = "CS001 antenna 0 changed on 2015-01-01 ± 50.0 days (change 1): C may still be that of the other side"
    told = [str(ask(client, at, **PATH).json()["curves"][0]["flag_reason"]) for at in DAYS_ABOUT]
    assert [said in one for one in told] == [False, is_told, is_told]
    edges = client.get("/v1/calibrations/edges", params={"as_of": format_instant(factory.clock())}).json()["stations"]
    (own,) = (one["edges"] for one in edges if one["station"] == "CS001")
    assert {"2014-09-23T00:00:00.000001Z", "2015-04-11T00:00:00Z"} <= set(own)


DAYS_ABOUT = "2014-09-22", "2014-09-24", "2014-12-31"


def test_changes_in_force_bound_the_epoch_of_their_antenna_and_are_edges(
    client: TestClient, stored: Stored, factory: Factory
) -> None:
    promote(client, stored["array"], "2013-01-01")
    before = client.get("/v1/calibrations/edges", params={"as_of": (as_of := format_instant(factory.clock()))}).json()
    numbers = []
    for date in ("2014-03-01", "2014-09-01"):
        body = {"paths": [{"station": "CS001", "antenna": 0}], "kind": "step", "at": {"value": date, "sigma_days": 1.0}}
        answer = client.post("/v1/changes", json={**body, "reason": "an amplifier"})
        assert answer.status_code == 201, answer.text
        numbers.append(answer.json()["id"])
    first, second = numbers
    march, september = "2014-03-01T00:00:00Z", "2014-09-01T00:00:00Z"
    for at, epoch in (
        ("2014-02-28", {"from": None, "to": march, "because": None}),
        ("2014-03-01", {"from": march, "to": september, "because": first}),
        ("2014-10-01", {"from": september, "to": None, "because": second}),
    ):
        assert [curve["epoch"] for curve in ask(client, at, **PATH).json()["curves"]] == [epoch]
        (other,) = ask(client, at, **PATH | {"antenna": 1}).json()["curves"]
        assert other["epoch"] == {"from": None, "to": None, "because": None}
        (pinned,) = ask(client, at, as_of=as_of, **PATH).json()["curves"]
        assert pinned["epoch"]["because"] is None, "as it was known then"
    (curve,) = ask(client, **PATH).json()["curves"]
    begins, ends = (f"change {n} of 2014-{month}-01 ± 1.0 days" for n, month in ((first, "03"), (second, "09")))
    assert f"{begins} begins its epoch and {ends} ends it" in curve["why"], "C is served up to a date with an error"
    edges = client.get("/v1/calibrations/edges", params={"as_of": format_instant(factory.clock())}).json()["stations"]
    of_station = {one["station"]: one["edges"] for one in edges}
    assert {march, september} <= set(of_station["CS001"])
    assert not {march, september} & set(of_station["CS002"])
    assert before == client.get("/v1/calibrations/edges", params={"as_of": as_of}).json()
    assert client.get("/v1/paths/CS001/0/X/life").json()["epochs"][1]["because"] == first


def test_a_change_on_record_bounds_the_epoch_in_every_answer(
    client: TestClient, stored: Stored, factory: Factory
) -> None:
    """It bounded epochs of the life alone where the version was made before it was on record: C has no such epoch."""
    promote(client, stored["path"], "2014-01-01", "2015-01-01")
    change = Change("CS001", ((0, None),), "step", instant("2014-06-01"), 0)
    with factory.database.write() as stores:
        number = stores.changes.note(change, Evidence(RECORD, "", None, factory.clock())).number
    epochs = client.get("/v1/paths/CS001/0/X/life").json()["epochs"]
    assert [one["because"] for one in epochs] == [None, number]
    for at, epoch, does in (("2014-05-31", epochs[0], "ends"), ("2014-06-01", epochs[1], "begins")):
        (curve,) = ask(client, at, **PATH).json()["curves"]
        assert (curve["epoch"], curve["flag_reason"]) == (epoch, None)
        assert f"change {number} of 2014-06-01 {does} its epoch" in curve["why"]
        assert f"change {number} of 2014-06-01 {does} its epoch" in client.get(f"/paths/CS001/0/X?at={at}").text
    edges = client.get("/v1/calibrations/edges", params={"as_of": format_instant(factory.clock())}).json()["stations"]
    assert ["2014-06-01T00:00:00Z" in one["edges"] for one in edges if one["station"]] == [True, False]
