from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from fastapi.testclient import TestClient

from lbacal.instants import parse_instant
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.spectra.spectra import Spectra
from service.errors import UnavailableError
from service.factory import Factory
from service.scheduler import look_again, look_for_due_work
from service.storage.jobs import LeaseLostError, Part
from service.storage.migration import upgrade
from service.storage.processes import WORKER
from service.usecases.status import Pulse
from service.wire.answer_models import JobAnswer
from tests.killed_worker import killing_one_of_two
from tests.service.conftest import add_spectra, like, night, served, tell_night, work

YEAR = {"since": "2014-01-01", "until": "2015-01-01"}


def refit(http: TestClient, **body: Any) -> Any:
    answer = http.post("/v1/refits", json={"scope": "antenna", **YEAR, "reason": "test", "promote": True, **body})
    assert answer.status_code == 202, answer.text
    return answer.json()["job"]


def test_a_refit_makes_the_versions_that_the_fit_alone_makes(
    station: Factory, http: TestClient, campaign: Spectra
) -> None:
    number = refit(http)
    assert http.get(f"/v1/jobs/{number}").json()["state"] == "queued"
    work(station)
    job = http.get(f"/v1/jobs/{number}").json()
    assert (job["state"], job["progress"], job["error"]) == ("done", 1.0, None)
    JobAnswer.model_validate(job)
    assert len(job["calibrations"]) == len(job["promoted"]) == 8
    window = campaign.select(campaign.time_unix < np.datetime64("2015-01-01", "s").astype(float))
    expected = {c.name: c for c in fit_calibration(window, station.simulation, "antenna").curves}
    answer = http.get("/v1/calibrations/effective", params={"at": "2014-07-01", "station": "CS002"}).json()
    assert len(answer["curves"]) == 8
    for curve in answer["curves"]:
        # times are stored to the microsecond; nothing else differs
        name = f"{curve['station']} antenna {curve['antenna']} {curve['dipole']}"
        assert curve["c"] == pytest.approx(expected[name].c, rel=1e-9)
        assert curve["c_sigma_stat"] == pytest.approx(expected[name].c_sigma_stat, rel=1e-6)


@pytest.mark.long
def test_the_same_refit_again_returns_the_same_versions_and_promotes_nothing(
    station: Factory, http: TestClient
) -> None:
    first, second = refit(http), refit(http)
    work(station)
    jobs = [http.get(f"/v1/jobs/{number}").json() for number in (first, second)]
    assert jobs[0]["calibrations"] == jobs[1]["calibrations"]
    assert (len(jobs[0]["promoted"]), jobs[1]["promoted"], jobs[1]["gated"]) == (8, [], {})


def test_station_and_array_refits_answer_where_no_antenna_version_does(station: Factory, http: TestClient) -> None:
    refit(http, scope="station")
    refit(http, scope="array")
    refit(http, station="CS002", antenna=1, dipole="X")
    work(station)
    answer = http.get("/v1/calibrations/effective", params={"at": "2014-07-01", "dipole": "X"}).json()
    by = {(c["station"], c["antenna"]): c["answered_by"] for c in answer["curves"]}
    assert (by[("CS002", 1)], by[("CS002", 2)], by[("CS003", 0)]) == ("antenna", "station", "array")


def test_without_promotion_a_refit_makes_candidates(station: Factory, http: TestClient) -> None:
    number = refit(http, promote=False)
    work(station)
    assert http.get(f"/v1/jobs/{number}").json()["promoted"] == []
    assert http.get("/v1/calibrations/effective?at=2014-07-01").status_code == 404


def test_the_gate_keeps_back_what_has_too_few_events_and_says_so(station: Factory, http: TestClient) -> None:
    number = refit(http, since="2014-01-01", until="2014-02-01")
    work(station)
    job = http.get(f"/v1/jobs/{number}").json()
    assert (job["state"], job["promoted"]) == ("done", [])
    assert "too_few_events" in next(iter(job["gated"].values()))
    version = http.get(f"/v1/calibrations/{job['calibrations'][0]}").json()
    assert "too_few_events" in version["gate"]


def test_the_gate_keeps_back_a_jump(station: Factory, http: TestClient) -> None:
    refit(http)
    work(station)
    number = refit(http, since="2015-01-01", until="2016-01-01")
    with like(station, gate_change=0.045) as tight:
        work(tight)
    gated = http.get(f"/v1/jobs/{number}").json()["gated"]
    assert len(gated) == 1
    assert next(iter(gated.values())).startswith("CS002 antenna 2 Y: mean C differs by -")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"scope": "path"}, "scope"), ({"since": "2014"}, "since"), ({"until": "2014-01-01"}, "since"),
        ({"reason": ""}, "reason"), ({"scope": "array", "station": "CS002"}, ""), ({"station": "CS999"}, "CS002"),
        ({"antenna": 1}, ""), ({"scope": "station", "station": "CS002", "antenna": 1, "dipole": "X"}, ""),
        ({"promote": "yes"}, "promote"), ({"since": "2009-01-01", "until": "2019-01-01"}, "at most 732 days"),
    ],
)  # fmt: skip
def test_a_bad_refit_is_refused(http: TestClient, change: dict[str, Any], said: str) -> None:
    refused = http.post("/v1/refits", json={"scope": "antenna", **YEAR, "reason": "test", "promote": False, **change})
    assert (refused.status_code, said in refused.json()["detail"]) == (422, True), refused.text
    assert http.get("/v1/jobs").json()["jobs"] == []


def test_a_window_without_spectra_fails_with_one_sentence(station: Factory, http: TestClient) -> None:
    number = refit(http, since="2012-01-01", until="2013-01-01")
    work(station)
    job = http.get(f"/v1/jobs/{number}").json()
    assert job["state"] == "failed"
    assert job["error"] == "no usable spectra of CS002 between 2012-01-01T00:00:00Z and 2013-01-01T00:00:00Z"


def test_a_cancelled_job_is_not_done(station: Factory, http: TestClient) -> None:
    number = refit(http)
    assert http.post(f"/v1/jobs/{number}/cancel").json()["state"] == "cancelled"
    work(station)
    assert http.get(f"/v1/jobs/{number}").json()["calibrations"] == []
    assert http.get("/v1/calibrations").json()["calibrations"] == []
    assert http.get(f"/v1/jobs/{number}").json()["progress"] == 0.0, "nobody worked on it"
    assert http.post(f"/v1/jobs/{number}/cancel").status_code == 200


def claim(station: Factory, worker: str, lease_us: int) -> Part | None:
    with station.database.write() as stores:
        return stores.jobs.claim(worker, lease_us=lease_us, inputs=station.inputs.text)


def test_a_part_whose_worker_died_is_taken_over_and_the_dead_one_writes_nothing(
    station: Factory, http: TestClient
) -> None:
    number = refit(http)
    assert claim(station, "living", lease_us=3_600_000_000) is not None
    assert claim(station, "other", lease_us=1) is None
    number = refit(http, station="CS002")
    part = claim(station, "dead", lease_us=-1)
    assert part is not None
    work(station)
    assert http.get(f"/v1/jobs/{number}").json()["state"] == "done"
    with pytest.raises(LeaseLostError):
        station.refits.run(part, "dead")


def test_a_worker_that_ends_when_idle_fails_where_the_database_went_away(
    station: Factory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It ended with 0, and the work was not done."""
    monkeypatch.setattr(station.database, "write", Mock(side_effect=UnavailableError("the disk is full")))
    with pytest.raises(UnavailableError, match="is full"):
        work(station)


def test_a_clock_that_is_ahead_holds_no_lease(station: Factory, http: TestClient, clock: Any) -> None:
    number = refit(http)
    clock.now += 86_400_000_000
    assert claim(station, "ahead", lease_us=-1) is not None
    clock.now -= 86_400_000_000
    work(station)
    assert http.get(f"/v1/jobs/{number}").json()["state"] == "done"


def test_a_part_that_kills_its_workers_is_given_up(station: Factory, http: TestClient) -> None:
    number = refit(http)
    for _ in range(11):
        claim(station, "dying", lease_us=-1)
    job = http.get(f"/v1/jobs/{number}").json()
    assert (job["state"], job["error"]) == ("failed", "given up: 10 workers died on it")


@pytest.mark.long
def test_a_worker_with_another_sky_than_the_schedulers_does_nothing_and_says_why(
    station: Factory, http: TestClient
) -> None:
    look_for_due_work(station)
    with like(station, sky_power=None) as wrong, Pulse(wrong.database, WORKER, wrong.inputs.text):
        work(wrong)
        said = http.get("/v1/status").json()["stuck"]
    assert http.get("/v1/calibrations").json()["calibrations"] == []
    assert {job["state"] for job in http.get("/v1/jobs").json()["jobs"]} == {"queued"}
    assert len(said) == 1
    assert said[0].startswith("6 parts wait for a worker with sky power ")
    work(station)
    assert len(http.get("/v1/calibrations/effective", params={"at": "2015-12-30"}).json()["curves"]) == 576


@pytest.mark.long
def test_work_that_nobody_began_is_given_up_when_the_scheduler_has_another_sky(
    station: Factory, http: TestClient
) -> None:
    look_for_due_work(station)
    with like(station, sky_power=None) as other:
        assert len(night(other)) == 6
    states = [job["state"] for job in http.get("/v1/jobs").json()["jobs"] if job["kind"] == "refit"]
    assert (states.count("failed"), states.count("done")) == (6, 9), "each year, and the first again beside the other"
    assert http.get("/v1/status").json()["failures"] == [], "later work with the same request made up for them"


def fail_all(station: Factory) -> None:
    while (part := claim(station, "unlucky", lease_us=3_600_000_000)) is not None:
        with station.database.write() as stores:
            stores.jobs.fail(part, "unlucky", "the mount is away", station.clock())


MINUTE_US = 60_000_000


@pytest.mark.long
def test_due_work_that_failed_is_tried_again_after_ever_longer_pauses(
    station: Factory, http: TestClient, clock: Any
) -> None:
    assert len(look_for_due_work(station)) == 6
    fail_all(station)
    assert (look_for_due_work(station), look_again(station)) == ([], []), "not at once"
    failures = http.get("/v1/status").json()["failures"]
    assert {failure["error"] for failure in failures} == {"the mount is away"}
    assert all(failure["again_after"] for failure in failures)
    assert "What failed and was not made up for" in http.get("/jobs").text
    clock.now += 11 * MINUTE_US
    assert len(look_again(station)) == 6
    assert look_for_due_work(station) == [], "a second scheduler enqueues the second try once, too"
    fail_all(station)
    clock.now += 11 * MINUTE_US
    assert look_again(station) == [], "the second pause is twice as long"
    clock.now += 10 * MINUTE_US
    assert len(look_again(station)) == 6
    work(station)
    assert look_for_due_work(station) == []
    assert http.get("/v1/status").json()["failures"] == []
    assert "the mount is away" in http.get("/jobs").text


@pytest.mark.long
def test_due_work_that_was_cancelled_is_done_a_day_later(
    make_service: Callable[..., Factory], campaign: Spectra, clock: Any
) -> None:
    year = make_service(campaign.select(campaign.time_unix < parse_instant("", "2015-01-01") / 1e6))
    number = look_for_due_work(year)[0]
    with served(year) as http:
        assert http.post(f"/v1/jobs/{number}/cancel").json()["error"] == "cancelled by key 1"
    work(year)
    assert look_for_due_work(year) == []
    clock.now += 24 * 60 * MINUTE_US + 1_000_000
    assert len(look_for_due_work(year)) == 1


def test_the_night_is_not_behind_what_was_asked_for_before(station: Factory, http: TestClient) -> None:
    asked = refit(http)
    due = look_for_due_work(station)
    parts = [claim(station, "worker", lease_us=3_600_000_000) for _ in range(7)]
    assert [part.job for part in parts if part] == [*due, asked]


def test_a_flood_of_refits_is_told_to_come_later(station: Factory, http: TestClient) -> None:
    body = {"scope": "antenna", **YEAR, "reason": "test", "promote": False}
    with like(station, max_open_parts=2) as small, served(small) as client:
        answers = [client.post("/v1/refits", json=body) for _ in range(4)]
    assert [answer.status_code for answer in answers] == [202, 202, 429, 429]
    assert answers[-1].headers["retry-after"] == "60"
    assert http.post("/v1/refits", json=body).status_code == 202, "the others' share is their own"


def test_a_refit_asked_for_twice_under_one_name_is_one_job(http: TestClient) -> None:
    body = {"scope": "antenna", **YEAR, "reason": "test", "promote": False}
    ask = {"url": "/v1/refits", "headers": {"Idempotency-Key": "mine"}}
    first, second = (http.post(**ask, json=body) for _ in range(2))
    assert (first.status_code, first.content) == (second.status_code, second.content)
    assert len(http.get("/v1/jobs").json()["jobs"]) == 1
    assert http.post(**ask, json={**body, "reason": "other"}).status_code == 409
    assert http.post("/v1/refits", json=body, headers={"Idempotency-Key": "other"}).json() != first.json()


@pytest.mark.long
def test_a_version_that_was_never_promoted_changes_no_drift(after_night: Factory, http: TestClient) -> None:
    before = http.get("/v1/drift", params={"station": "CS002"}).json()["months"]
    refit(http, since="2013-12-31", until="2015-12-31", promote=False)
    work(after_night)
    night(after_night)
    assert http.get("/v1/drift", params={"station": "CS002"}).json()["months"] == before


@pytest.mark.long
def test_the_night_finds_every_year_station_and_antenna_once(station: Factory, http: TestClient) -> None:
    assert len(look_for_due_work(station)) == 6, "two years, scopes array, station and antenna"
    assert look_for_due_work(station) == [], "a second look, or a second scheduler, finds nothing new"
    work(station)
    jobs = http.get("/v1/jobs").json()["jobs"]
    assert {job["state"] for job in jobs} == {"done"}
    assert sorted((job["kind"], job["request"].get("scope", "")) for job in jobs) == sorted(
        3 * [("refit", scope) for scope in ("antenna", "station", "array")] + 2 * [("drift", "")] + [("watch", "")]
    ), "each year, and the first again beside the other: that is no other reference of the drift"
    assert look_for_due_work(station) == []
    answer = http.get("/v1/calibrations/effective", params={"at": "2015-12-30"}).json()
    assert len(answer["curves"]) == 576
    assert sum(curve["answered_by"] == "antenna" for curve in answer["curves"]) == 8


@pytest.mark.long
def test_late_spectra_a_flag_and_another_sky_make_a_window_due_again(
    after_night: Factory, http: TestClient, campaign: Spectra
) -> None:
    name = http.get("/v1/events?limit=1").json()["events"][0]["event_id"]
    http.post(f"/v1/events/{name}/flag", json={"flag": "bad", "reason": "test"})
    assert len(look_for_due_work(after_night)) == 4, "one year: array, station, antenna, and its drift"
    late = campaign.select(campaign.event_id == campaign.event_id[0])
    last = late.time_unix + 86_400.0 * 400
    moved = Spectra(
        late.frequency_mhz, late.power, np.array([f"late{e}" for e in late.event_id]), last, late.station, late.antenna,
        late.dipole, late.blocks,
    )  # fmt: skip
    add_spectra(after_night, moved)
    assert len(look_for_due_work(after_night)) == 4
    with like(after_night, instrument="lofar-superterp", sky_power=None) as other:
        assert len(look_for_due_work(other)) == 8, "two years: array, station, antenna, drift"


@pytest.mark.long
def test_a_night_on_dask_is_the_same_though_one_of_its_workers_is_killed(
    make_service: Callable[..., Factory], campaign: Spectra, tmp_path: Path
) -> None:
    few = campaign.select((campaign.antenna < 2) & (campaign.time_unix < parse_instant("", "2015-01-01") / 1e6))
    told = []
    for url in (None, str(tmp_path / "here.sqlite")):
        more = dict[str, Any]() if url is None else {"database_url": url}
        factory = make_service(None, nightly_investigations=True, **more)
        upgrade(factory.database)
        add_spectra(factory, few)
        if url is None:
            with killing_one_of_two(tmp_path, "service.usecases.refits.measure_payoff") as factory.engine:
                jobs = night(factory)
        else:
            jobs = night(factory)
        assert {(job.state, *job.errors) for job in jobs} == {("done",)}
        told.append(tell_night(factory))
    of_dask, here = told
    assert of_dask == here
    assert of_dask["attempts"] == [1] * 6
