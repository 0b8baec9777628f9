"""What drift finds in one antenna cuts its windows: a gain step and a swapped cable, which nobody entered anywhere."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from lbacal.instants import DAY_US, format_instant, parse_instant
from lbacal_core.causes.model import AdoptedCause, Model
from lbacal_core.curves.validity import Scope, timeline
from lbacal_core.drift.events import EventModes
from lbacal_core.drift.follow import History, follow
from lbacal_core.drift.report import describe_followed
from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.sky.table import read_sky_power, write_sky_power
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.hardware import GainStep
from lbacal_twin.settings import TwinSettings
from service.app import make_app
from service.factory import Factory
from service.handlers.drift import describe_change
from service.scheduler import look_for_due_work
from service.storage.alarms import AlarmsAsked
from service.storage.changes import Change, Evidence, OwnSize
from service.storage.jobs import Job, Order, Part
from service.storage.models import ADOPTED, ModelChange
from service.storage.sums import Sums
from service.storage.versions import Version
from service.usecases.drift import start_of_year
from service.usecases.drift_measurement import find_references, write_events
from service.usecases.due import DueWork
from service.usecases.fits import Wanted
from service.usecases.gate import tell_size
from service.usecases.models import Adoption
from service.usecases.watch import KIND as WATCH
from service.usecases.watch import (
    _find_left_out,
    _find_recorded,
    _list_measured,
    assemble_history,
    read_changes,
    settle_changes,
    tell_news,
)
from service.usecases.windows import share_misfits
from service.wire.bodies import InvestigationBody, ReasonBody
from tests.service.conftest import get_job, like, night, refit, served, take_another_model, work

BEGIN = parse_instant("", "2015-01-01")
OPEN_ALARMS = AlarmsAsked(("open",), 100)
STEPPED, SWAPPED = parse_instant("", "2015-04-11"), parse_instant("", "2015-08-20")


def other_cable(instrument: Instrument, name: str) -> str:
    """The cable whose loss differs most from that of one."""
    return max(instrument.cables, key=lambda one: float(np.ptp(instrument.cables[one] / instrument.cables[name])))


@pytest.fixture(scope="module")
def changed(superterp: Instrument, sky_power_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Spectra:
    """Two years: a path steps by 15 %, and another antenna gets a cable of another length."""
    content = superterp.as_dict()
    (record,) = [one for one in content["antennas"] if (one["station"], one["antenna"]) == ("CS002", 1)]
    other = other_cable(superterp, record["cable"])
    content["antennas"].remove(record)
    content["antennas"] += [{**record, "until": "2015-08-20"}, {**record, "cable": other, "since": "2015-08-20"}]
    file = tmp_path_factory.mktemp("true") / "instrument.json"
    file.write_text(json.dumps(content))
    settings = TwinSettings(stations=("CS002",), antennas=7, years=1.99, events_per_year=150)
    step = GainStep(size=0.15, date="2015-04-11", where=Where(antennas=(2,), dipoles=("Y",)))
    sky = read_sky_power(sky_power_file)
    return simulate_campaign(settings, load_instrument(str(file)), sky, np.random.default_rng(15), [step]).spectra


@pytest.fixture
def watched(make_service: Callable[..., Factory], changed: Spectra) -> Factory:
    return make_service(changed, lease_s=60.0, gate_change=0.9)


@pytest.fixture
def stepped(make_service: Callable[..., Factory], campaign: Spectra) -> Factory:
    """A service with a step alone."""
    return make_service(campaign, lease_s=60.0, gate_change=0.9)


def watch_night(factory: Factory) -> list[Any]:
    jobs = night(factory)
    assert not [job.errors for job in jobs if any(job.errors)]
    return [(job.kind, job.request.get("scope"), job.request.get("since")) for job in jobs]


def in_effect(factory: Factory, path: Scope) -> list[Version]:
    """The versions in effect of a path in 2015, in order of time."""
    with factory.database.read() as stores:
        promotions = stores.ledger.standing([path], BEGIN, parse_instant("", "2016-01-01"))
        stretches = [one for one in timeline(promotions, path) if one.start is not None and one.start >= BEGIN]
        return [stores.versions.get(str(one.calibration)) for one in stretches if one.calibration is not None]


@pytest.mark.long
def test_a_step_and_a_swapped_cable_end_as_a_change_point_and_a_new_window(watched: Factory) -> None:
    watch_night(watched)
    jobs = [job for job in reversed(watched.database.look(lambda stores: stores.jobs.newest())) if job.state == "done"]
    kinds = [job.kind for job in jobs]
    after = [job for job in jobs[kinds.index("watch") :] if job.kind == "refit"]
    assert {job.request["since"] for job in after if "changed on" in job.reason} == {BEGIN}, "the year of the changes"
    with watched.database.read() as stores:
        cuts = stores.changes.cuts()
        changes = sorted((one.change for one in stores.changes.kept()), key=lambda one: one.antennas)
        told = [one.news.sentence for one in stores.alarms.newest(OPEN_ALARMS, watched.clock())]
    assert [(one.station, one.antenna) for one in cuts] == [("CS002", 1), ("CS002", 2)]
    for change, date in zip(changes, (SWAPPED, STEPPED), strict=True):
        assert abs(change.date - date) < 3 * change.sigma + DAY_US
        assert change.sigma < 3 * DAY_US
    names = [record.cable for record in watched.instrument.antennas if (record.station, record.antenna) == ("CS002", 1)]
    old, new = (watched.instrument.cables[name] for name in (names[0], other_cable(watched.instrument, names[0])))
    for antenna, cut, expected in ((1, cuts[0], np.sqrt(old / new)), (2, cuts[1], 1.15**-0.5)):
        before, after = in_effect(watched, Scope("CS002", antenna, "Y"))
        assert (before.since, before.until, after.since) == (BEGIN, cut.date, cut.date)
        off = np.log(after.curves[0].c / before.curves[0].c / expected)
        error = np.hypot(*(one.curves[0].c_sigma_stat / one.curves[0].c for one in (before, after)))
        assert np.all(np.abs(off) < 3 * error)
        assert abs(np.mean(off)) < 0.05
    assert len(in_effect(watched, Scope("CS002", 3, "Y"))) == 1
    assert sum("its windows are cut there" in one for one in told) == 2
    assert any("antenna 2 Y" in one and "2015-04-1" in one for one in told)
    assert [one for one in watch_night(watched) if one[0] == "refit"] == [], "the cut calls for refits once"
    assert watched.models.history() == [], "no cause, and so no gain that is promised for later years"
    dismiss_and_take_back(watched, Scope("CS002", 2, "Y"))


@pytest.mark.long
@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
def test_drift_called_for_its_own_reference_without_end(
    make_service: Callable[..., Factory], changed: Spectra, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In its first year it was measured against what its own changes had cut, and might then find others."""
    watched, path = make_service(changed.select(changed.time_unix >= BEGIN / 1e6)), Scope("CS002", 1, "Y")
    watch_night(watched)
    reasons = {(job.kind, job.reason) for job in watched.database.look(lambda stores: stores.jobs.newest())}
    assert not [reason for kind, reason in reasons if kind == "drift" and reason != "the first of this window"]
    with watched.database.read() as stores:
        held = stores.versions.get(find_references(stores, watched.instrument, "CS002")[path])
    assert len(in_effect(watched, path)) == 2, "cut where its cable was swapped"
    assert (held.since, held.until) == (BEGIN, parse_instant("", "2016-01-01")), "what was made of the whole year"
    take_another_model(monkeypatch)
    with like(watched) as later:
        kinds = [{kind for kind, *_ in watch_night(later)} for _ in range(3)]
        assert "refit" in kinds[0]
        assert not kinds[2] & {"refit", "drift"}, "no version of the whole year is of this model, and yet it rests"
        assert len(in_effect(later, path)) == 2


def dismiss_and_take_back(watched: Factory, path: Scope) -> None:
    """A person dismisses a change, and the watch, which still finds it, does not cut the windows again."""
    cut_year = [version.id for version in in_effect(watched, path)]
    of_year = {("refit", scope, BEGIN) for scope in ("antenna", "station", "array")}
    parted = {("refit", "antenna", parse_instant("", "2014-01-01"))}  # the year before is looked at without this one
    (kept,) = [one for one in watched.changes.list_all("CS002") if one.change.antennas == [path.antenna]]
    with served(watched) as http:

        def decide(number: int, decision: str, **params: Any) -> Any:
            body = {"decision": decision, "reason": "snow"}
            return http.post(f"/v1/changes/{number}/decision", json=body, params=params)

        for number, decision, status in (
            (kept.number, "in_force", 409), (kept.number + 9, "dismissed", 404), (kept.number + 9, "in_force", 404),
        ):  # fmt: skip
            assert decide(number, decision).status_code == status
        foreseen = decide(kept.number, "dismissed", dry_run=True).json()["changes"]
        dismissed = decide(kept.number, "dismissed")
        told = dismissed.json()
        assert (dismissed.status_code, told["decision"], told["reason"]) == (201, "dismissed", "snow")
        assert told["changes"] == foreseen
        assert {(one["antenna"], one["before"]) for one in foreseen if one["dipole"] == "Y"} == {
            (path.antenna, version) for version in cut_year
        }, "what the two pieces are told now"
        assert {one for one in watch_night(watched) if one[0] == "refit"} - parted == of_year
        (whole,) = in_effect(watched, path)
        assert (whole.since, whole.until) == (BEGIN, parse_instant("", "2016-01-01"))
        watch_night(watched)
        listed = http.get("/v1/changes?station=CS002").json()["changes"]
        assert [one["decision"] for one in listed] == ["dismissed", "in_force"]
        assert [version.id for version in in_effect(watched, path)] == [whole.id], (
            "the watch finds the change again, and leaves the window whole"
        )
        again = decide(kept.number, "in_force")
        assert (again.status_code, again.json()["decision"]) == (201, "in_force")
        announced = [one["after"] for one in again.json()["changes"] if one["dipole"] == path.dipole]
        assert sorted(announced) == sorted(cut_year), "told beside years that knew nothing of the change"
        assert {one for one in watch_night(watched) if one[0] == "refit"} - parted == of_year
        assert [version.id for version in in_effect(watched, path)] == cut_year, "the versions of before answer again"


@pytest.mark.long
@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
def test_c_of_before_a_step_answered_for_the_whole_year_once_somebody_adopted_it(stepped: Factory) -> None:
    """And when the model went, the mean over the step answered for ever: the watch did not look at it again."""
    watch_night(stepped)
    paths = [Scope("CS002", antenna, dipole) for antenna in (2, 3) for dipole in "XY"]

    def answers() -> list[list[str]]:
        return [[version.id for version in in_effect(stepped, path)] for path in paths]

    def alarms() -> list[str]:
        with stepped.database.read() as stores:
            return [one.news.sentence for one in stores.alarms.newest(OPEN_ALARMS, stepped.clock())]

    before, known, alarmed = answers(), stepped.changes.list_all(), alarms()
    assert [len(of_path) for of_path in before] == [2, 2, 1, 1]
    # adopted as it was before what follows the date was refused; ledgers have such models
    cause = AdoptedCause(
        "gain_step", "CS002", "antenna 2 Y", 0.15, 0.003, {"date_unix": STEPPED / 1e6}, since_unix=BEGIN // 10**6
    )
    model, plain = Model((cause,)), Model()
    change = ModelChange(
        0, "CS002", ADOPTED, model.id, plain.id, model.id, BEGIN, None, None, None, None, {}, None, 0, "test", "x"
    )  # fmt: skip
    assert stepped.models.adopt(Adoption(change, model, plain, cause, ()), promote=True)
    watch_night(stepped)
    assert (answers(), stepped.changes.list_all(), alarms()) == (before, known, alarmed), "a change and no cause"
    stepped.models.withdraw(model.id, ReasonBody(reason="test"), "test")
    assert answers() == before, "at once"
    for _ in range(2):
        watch_night(stepped)
        assert (answers(), stepped.changes.list_all(), len(alarms())) == (before, known, len(alarmed))


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
@pytest.mark.long
def test_c_in_effect_was_the_mean_over_a_step_that_was_found_and_nothing_said_so(
    stepped: Factory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A night that found a change refitted its windows in the next one, and the alarm spoke of it as done."""
    path = {"station": "CS002", "antenna": 2, "dipole": "Y"}
    _, key = stepped.keys.create(("admin",))
    look_for_due_work(stepped)
    with monkeypatch.context() as patched:
        enqueue_next = DueWork.enqueue_next

        def stop_at_the_watch(due: DueWork, part: Part) -> list[int]:
            return [] if part.kind == WATCH else enqueue_next(due, part)

        patched.setattr(DueWork, "enqueue_next", stop_at_the_watch)  # the night ends with what it found
        work(stepped)
    with TestClient(make_app(stepped), headers={"Authorization": f"Bearer {key}"}) as http:

        def told() -> list[Any]:
            at = {"at": "2015-02-01", **path}
            (curve,) = http.get("/v1/calibrations/effective", params=at).json()["curves"]
            (alarm,) = http.get("/v1/alarms", params={"kind": "step"}).json()["alarms"]
            (change,) = http.get("/v1/changes").json()["changes"]
            page = "found, not yet refitted" in http.get("/drift").text
            known = http.get("/v1/status").json()["not_refitted"]
            return [curve["flag_reason"], curve["flag"][20], alarm["sentence"][-26:], change["refitted"], page, known]

        sentence = (
            "CS002 antenna 2 changed on 2015-04-10 (found, not yet refitted): C in effect is the mean over the change"
        )
        assert told() == [sentence, "uncertain", " (found, not yet refitted)", False, True, [sentence]]
        before = http.get("/v1/calibrations/effective", params={"at": "2014-06-01", **path}).json()["curves"][0]
        assert before["flag_reason"] is None, "another window"
        as_of = format_instant(stepped.clock())
        assert stepped.due.enqueue()
        work(stepped)
        assert told()[::3] == [None, True]
        assert told()[4:] == [False, []]
        pinned = http.get("/v1/calibrations/effective", params={"at": "2015-02-01", "as_of": as_of, **path}).json()
        assert pinned["curves"][0]["flag_reason"] == sentence, "what was known then"


def test_later_data_move_a_date_within_its_error_and_no_window(watched: Factory) -> None:
    """A date that moved by an hour with every event would have called for refits of three scopes every night."""
    change = {
        "station": "CS002", "is_known": False, "date_unix": STEPPED / 1e6, "date_sigma_days": 1.0,
        "members": [
            {"antenna": antenna, "dipole": dipole, "significance": 9.0, "size": size, "sigma": 0.003}
            for antenna, dipole, size in ((2, "Y", -0.07), (2, "X", -0.05))
        ],
        "size": -0.07, "sigma": 0.003, "shape": {},
    }  # fmt: skip
    moved, far = ({**change, "date_unix": STEPPED / 1e6 + 86_400 * days} for days in (2.0, 40.0))
    vague, known = {**moved, "date_sigma_days": 50.0}, {**far, "is_known": True}
    exact, later = ({**change, "date_sigma_days": 1e-3, "date_unix": STEPPED / 1e6 + 3600 * h} for h in (0, 20))
    for name, changes in (
        ("first", [change]), ("away", []), ("moved", [moved, vague, known]), ("far", [far]), ("none", []),
        ("known", [known]), ("exact", [exact]), ("later", [later]),
    ):  # fmt: skip
        with watched.database.write() as stores:
            settle_changes(stores, {"changes": changes}, {} if name == "away" else measured(2), 1)
            dates = [] if name in ("none", "known") else [STEPPED + 40 * DAY_US if name == "far" else STEPPED]
            assert [one.date for one in stores.changes.cuts("CS002")] == dates, name


def measured(*antennas: int) -> dict[tuple[str | None, int, str | None], tuple[float, float]]:
    """Paths with events at all times."""
    return {("CS002", one, dipole): (-np.inf, np.inf) for one in antennas for dipole in "XY"}


def step_of(
    days: float, size: float, *, error_days: float, error: float, antennas: Sequence[int] = (2,)
) -> dict[str, Any]:
    """A step as a report of drift tells it."""
    members = [{"antenna": one, "dipole": "X", "significance": 9.0, "size": size, "sigma": error} for one in antennas]
    return {
        "station": "CS002", "is_known": False, "date_unix": STEPPED / 1e6 + 86_400 * days, "members": members,
        "date_sigma_days": error_days, "size": size, "sigma": error, "shape": {},
    }  # fmt: skip


def test_a_change_follows_later_events_that_give_it_another_date_or_size(watched: Factory) -> None:
    """A size found in the first weeks stayed for ever: the mean of the station was 1.7 sigma off."""
    early, later = step_of(0, -0.07, error_days=10, error=0.02), step_of(5, -0.05, error_days=1, error=0.003)
    both = [step_of(4, -0.05, error_days=4, error=0.003), step_of(16, -0.03, error_days=4, error=0.003)]
    seen = []
    for now, changes in enumerate(
        ([early], [later], [later], both, both, [step_of(4, -0.055, error_days=4, error=0.01)])
    ):
        with watched.database.write() as stores:
            settle_changes(stores, {"changes": changes}, measured(2), now)
            seen.append([(round((one.date - STEPPED) / DAY_US), one.power) for one in stores.changes.cuts("CS002")])
    power = [(1.0 + size) ** -2 for size in (-0.07, -0.05, -0.05, -0.05, -0.05, -0.05)]
    assert seen == [[(0 if k == 0 else 5, pytest.approx(one))] for k, one in enumerate(power)]
    with watched.database.read() as stores:
        (kept,) = stores.changes.kept()
        assert [(by.made, by.ended, by.size) for by in kept.evidence] == [(0, 1, -0.07), (1, None, -0.05)]
        (then,) = stores.changes.kept(as_of=0)
        assert (then.change.size, then.change.sigma, then.stands) == (-0.07, 10 * DAY_US, True)


def test_an_antenna_that_came_or_went_by_the_record_has_no_size_that_nobody_measured(watched: Factory) -> None:
    """It was listed as a step of C by -0.12 ± 362 %, found by drift, and drawn with that error."""
    time_unix = STEPPED / 1e6 + 86_400.0 * np.arange(-200, 200)
    antennas = np.arange(1, 8)
    ln_c = np.random.default_rng(1).normal(0.0, 0.01, (7, 400, 3)).astype(np.float32)
    is_after = time_unix >= STEPPED / 1e6
    ln_c[antennas == 1, ~is_after] = np.nan
    ln_c[np.ix_(antennas == 2, is_after)] = np.nan
    arrays = write_events({"X": EventModes(antennas, time_unix, ln_c)})
    year = Sums("drift", Scope("CS002"), BEGIN, STEPPED, "", 0, 0, 0, 0, arrays)
    known = {("CS002", antenna): (STEPPED / 1e6,) for antenna in (1, 2, 3)}
    history = assemble_history([year], known)
    report = describe_followed(history, follow(history), np.linspace(30.0, 80.0, 51))
    report |= {"recorded": list(_find_recorded(history, known))}
    old = Change("CS002", ((1, "X"), (2, "X")), "step", STEPPED, 0, -0.001, 3.6)
    with watched.database.write() as stores:
        stores.changes.note(old, Evidence("drift", "", 0.0, 0))
        stores.changes.note(old, Evidence("record", "", None, 0))
        settle_changes(stores, report, _list_measured(history), 1)
        kept = {tuple(one.change.antennas): one for one in stores.changes.kept()}
    assert {of: one.change.size is None for of, one in kept.items()} == {(1, 2): True, (3,): False}
    assert (kept[3,].change.size_sigma or 1.0) < 0.01
    assert {by.source for one in kept.values() for by in one.evidence if by.ended is None} == {"record"}
    assert {one.state for one in kept.values()} == {"on record"}


def test_a_change_found_in_one_dipole_is_of_both_once_it_is_found_in_both(watched: Factory) -> None:
    """The other dipole was never taken out of the mean of its station."""
    one = step_of(0, -0.05, error_days=1, error=0.01)
    other = {**one, "members": [*one["members"], {**one["members"][0], "dipole": "Y"}]}
    seen = []
    for now, told in enumerate((one, other, other)):
        with watched.database.write() as stores:
            settle_changes(stores, {"changes": [told]}, measured(2), now)
            (kept,) = stores.changes.kept()
            seen.append((kept.change.dipoles_of(2), len(kept.evidence)))
    assert seen == [(("X",), 1), (("X", "Y"), 2), (("X", "Y"), 2)]


def test_the_dipoles_of_an_antenna_that_change_by_two_amounts_are_one_change_with_both(watched: Factory) -> None:
    """The size of one was taken out of the other: of four antennas, the mean was 1.8 % off."""
    one = step_of(0, -0.1, error_days=1, error=0.003)
    tilt = {"tilt": {"value": 0.04, "sigma": 0.005}}
    seen = []
    for now, size in enumerate((-0.05, -0.051, -0.07, -0.1)):
        y = {**one["members"][0], "dipole": "Y", "size": size, "shape": tilt}
        with watched.database.write() as stores:
            settle_changes(stores, {"changes": [{**one, "members": [*one["members"], y]}]}, measured(2), now)
            (kept,) = stores.changes.kept()
            seen.append([(own.dipole, own.size, own.tilt) for own in kept.change.own])
            (cut,) = stores.changes.cuts("CS002")
            power = [cut.step_of(letter)[0] for letter in "XY"]
            assert power == pytest.approx([0.9**-2, (1 + (size if size != -0.051 else -0.05)) ** -2])
    assert seen == [[("Y", -0.05, 0.04)], [("Y", -0.05, 0.04)], [("Y", -0.07, 0.04)], []]
    with watched.database.read() as stores:
        (kept,) = stores.changes.kept()
    unlike = replace(kept, change=replace(kept.change, own=(OwnSize(2, "Y", -0.05, 0.003),)))
    told = tell_size(unlike.change, np.array([30.0, 80.0]))
    assert told == "-10.00 ± 0.30 %, Y of antenna 2 by -5.00 ± 0.30 %"
    assert describe_change(unlike, watched)["own_sizes"] == [
        {"antenna": 2, "dipole": "Y", "value": -0.05, "sigma": 0.003, "unit": "fraction of C"}
    ]
    dead = replace(unlike, change=replace(unlike.change, own=(OwnSize(2, "Y", 9.0, 0.003),)))
    assert [(cut.power, cut.own) for cut in dead.cuts] == [(None, ())], "nothing is left to be scaled"


@pytest.mark.parametrize("source", ["drift", "investigation", "person", "record"])
def test_a_dipole_that_drift_had_taken_back_stayed_in_its_change(watched: Factory, source: str) -> None:
    """Events of one night showed a step in both dipoles, those of the next in one: the other was left out of means."""
    x = step_of(0, -0.05, error_days=1, error=0.01)
    y, both = ({**x, "members": [{**x["members"][0], "dipole": one} for one in letters]} for letters in ("Y", "XY"))
    apart, seen = {**x, "date_unix": x["date_unix"] + 86_400}, []
    before = {path: (-np.inf, STEPPED - 1) if path[2] == "Y" else span for path, span in measured(2).items()}
    with watched.database.write() as stores:
        (found,) = read_changes(both)
        stores.changes.note(found, Evidence(source, "", None, 0))
        for now, told in enumerate(([both], [x], [apart, y], [y], [both], [x], [both], [y]), 1):
            settle_changes(stores, {"changes": told}, before if now == 2 else measured(2), now)
            (kept,) = stores.changes.kept()
            seen.append("".join(kept.change.dipoles_of(2) or ()))
    assert seen == (["XY", "XY", "XY", "Y", "YX", "X", "XY", "Y"] if source == "drift" else ["XY"] * 8)


def test_a_change_of_which_a_person_spoke_keeps_its_date_and_size(watched: Factory) -> None:
    entered = Change("CS002", ((2, None),), "step", STEPPED, 0, -0.07, 0.02)
    with watched.database.write() as stores:
        stores.changes.note(entered, Evidence("person", "ops", None, 0))
        settle_changes(stores, {"changes": [step_of(0.5, -0.05, error_days=1, error=0.003)]}, measured(2), 1)
        (kept,) = stores.changes.kept()
        assert (kept.change, len(kept.evidence)) == (entered, 2)


def test_a_change_that_a_person_entered_without_a_size_has_the_one_that_drift_finds(watched: Factory) -> None:
    """Its antenna left the mean of its station for ever, as if nothing were known of it."""
    entered = Change("CS002", ((2, None),), "step", STEPPED, 0)
    seen = []
    with watched.database.write() as stores:
        stores.changes.note(entered, Evidence("person", "ops", None, 0))
        for now, size in enumerate((-0.05, -0.051, -0.06), 1):
            settle_changes(stores, {"changes": [step_of(0.5, size, error_days=1, error=0.003)]}, measured(2), now)
            (kept,) = stores.changes.kept()
            seen.append(kept.change)
    assert seen == [replace(entered, size=size, size_sigma=0.003) for size in (-0.05, -0.05, -0.06)]
    assert kept.seen_at(0).change == entered


def test_what_a_person_enters_again_replaces_what_stood(watched: Factory) -> None:
    """A typo of the size stood for ever: a second entry was answered with the numbers of the first."""
    x, both = ((2, "X"),), ((2, None),)
    told = [
        (Change("CS002", x, "step", STEPPED, DAY_US), "drift"),
        (Change("CS002", both, "step", STEPPED + DAY_US // 2, 0), "person"),  # the log book, without a size
        (Change("CS002", both, "step", STEPPED + 2 * DAY_US, 0, 0.5, 0.0), "person"),
        (Change("CS002", both, "step", STEPPED + 2 * DAY_US, 0, 0.05, 0.01), "person"),
        (Change("CS002", ((3, "X"),), "step", STEPPED + 3 * DAY_US, 0, 0.2, 0.01), "person"),
        (Change("CS002", both, "step", STEPPED, DAY_US, 0.07, 0.01), "investigation"),
    ]
    seen = []
    with watched.database.write() as stores:
        for now, (change, source) in enumerate(told):
            stores.changes.note(change, Evidence(source, "", None, now))
            kept = stores.changes.kept()[0]
            seen.append((kept.change.date - STEPPED, kept.change.size, kept.change.dipoles_of(2)))
        settle_changes(stores, {"changes": [step_of(0, 0.08, error_days=1, error=0.003)]}, measured(2), 9)
        assert stores.changes.kept()[0].change == kept.change, "a person has spoken"
    assert seen == [(0, None, ("X",))] * 2 + [(2 * DAY_US, one, None) for one in (0.5, 0.05, 0.05, 0.05)]
    assert [(by.source, by.size, by.ended) for by in kept.evidence] == [
        ("drift", None, None), ("person", None, 2), ("person", 0.5, 3), ("person", 0.05, None),
        ("investigation", None, None),
    ]  # fmt: skip
    then = [kept.seen_at(now).change for now in range(6)]
    assert [one.size for one in then] == [None, None, 0.5, 0.05, 0.05, 0.05]
    assert [one.date - STEPPED for one in then] == [date for date, *_ in seen]


def test_of_antennas_that_changed_together_each_change_follows_and_a_part_moves_none(watched: Factory) -> None:
    of_both = {"error_days": 1, "error": 0.01, "antennas": (1, 2)}
    for now, (size, antennas) in enumerate(((-0.05, (1,)), (-0.05, (2,)), (-0.08, (1, 2)), (-0.05, (1, 2)))):
        told = [step_of(0, size, **{**of_both, "antennas": antennas})]
        told += [step_of(0, -0.05, **{**of_both, "antennas": (1,)})] if antennas == (2,) else []
        with watched.database.write() as stores:
            settle_changes(stores, {"changes": told}, measured(1, 2), now)
    with watched.database.write() as stores:
        kept = stores.changes.kept()
        assert [(one.change.antennas, one.change.size, len(one.evidence)) for one in kept] == [
            ([1], -0.05, 3),
            ([2], -0.05, 3),
        ]
        settle_changes(stores, {"changes": [step_of(0, -0.2, **{**of_both, "antennas": (3,)})]}, {}, 9)
        joint = Change("CS002", ((5, "X"), (6, "X")), "step", STEPPED, 0, -0.07, 0.02)
        stores.changes.note(joint, Evidence("drift", "", 9.0, 0))
        settle_changes(stores, {"changes": [step_of(0, -0.2, **{**of_both, "antennas": (5,)})]}, {}, 10)
        assert joint in [one.change for one in stores.changes.kept()]


def test_what_steps_together_by_different_sizes_is_several_changes() -> None:
    """The median of four paths followed one, whose size was taken out of another antenna too: the mean was 6 % off."""
    told = {
        "station": "CS002", "is_known": False, "date_unix": STEPPED / 1e6, "date_sigma_days": 1.0, "size": 0.21,
        "sigma": 0.002,
        "shape": {"tilt": {"value": 0.04, "sigma": 0.005}, "curvature": {"value": 0.01, "sigma": 0.005}},
        "members": [
            {"antenna": antenna, "dipole": dipole, "size": size, "sigma": 0.002}
            for antenna, dipole, size in (
                (0, "X", 0.21), (0, "Y", 0.2), (2, "Y", -0.01), (3, "Y", -0.012), (None, "X", 0.1)
            )
        ],
    }  # fmt: skip
    found = [(one.paths, one.size, one.tilt, one.curvature) for one in read_changes(told)]
    antenna, others = ((0, "X"), (0, "Y")), ((2, "Y"), (3, "Y"))
    assert found == [(antenna, 0.21, 0.04, None), (others, -0.01, None, None), ((), 0.1, None, None)]
    assert len(read_changes({**told, "is_known": True})) == 1


def test_a_member_of_a_date_had_the_significance_of_the_most_significant_one(watched: Factory) -> None:
    told = step_of(0, -0.2, error_days=1, error=0.003)
    told["members"] += [{"antenna": 3, "dipole": "Y", "size": 0.02, "sigma": 0.003, "significance": 6.0}]
    with watched.database.write() as stores:
        settle_changes(stores, {"changes": [told]}, measured(2, 3), 1)
        kept = {one.change.paths: one.evidence[0].significance for one in stores.changes.kept()}
    assert kept == {((2, "X"),): 9.0, ((3, "Y"),): 6.0}


def test_an_alarm_of_antennas_whose_labels_were_exchanged_gave_the_size_of_one_for_both() -> None:
    flat, size = {"value": 0.001, "sigma": 0.002}, {0: 0.5325, 4: -0.352}
    change = {
        "station": "CS002", "is_known": False, "date_unix": STEPPED / 1e6, "date_sigma_days": 1.0, "size": 0.5325,
        "sigma": 0.0044, "shape": {"tilt": {"value": 0.2, "sigma": 0.004}, "curvature": flat},
        "members": [
            {"antenna": antenna, "dipole": dipole, "size": size[antenna], "sigma": 0.0044}
            for antenna in size for dipole in "XY"
        ],
    }  # fmt: skip
    (news,) = tell_news({"changes": [change], "slopes": [], "trends": {}}, np.array([30.0, 80.0]), cuts_windows=True)
    assert "CS002, 4 together: C changed by +53.25 ± 0.44 % in the mean over the band and by a tilt" in news.sentence
    assert "(antenna 0 X, antenna 0 Y), by -35.20 ± 0.44 % (antenna 4 X, antenna 4 Y), if its" in news.sentence


def test_an_alarm_gives_the_size_of_each_dipole_of_an_antenna_that_differs() -> None:
    told = step_of(0, 0.12, error_days=1, error=0.003)
    told["members"] += [{**told["members"][0], "dipole": "Y", "size": 0.05}]
    (news,) = tell_news({"changes": [told], "slopes": [], "trends": {}}, np.array([30.0, 80.0]), cuts_windows=False)
    assert "by +12.00 ± 0.30 % (antenna 2 X), by +5.00 ± 0.30 % (antenna 2 Y), if" in news.sentence


def test_an_alarm_of_a_step_along_frequency_says_where() -> None:
    """A step of 5 sigma in a shape was told as a change of C by less than its error."""
    flat, tilted = {"value": 0.001, "sigma": 0.002}, {"value": np.log(1.05), "sigma": 0.01}
    change = {
        "station": "CS002", "is_known": False, "date_unix": STEPPED / 1e6, "date_sigma_days": 40.0, "size": -0.0036,
        "sigma": 0.0043, "members": [{"antenna": 2, "dipole": "Y"}], "shape": {"tilt": tilted, "curvature": flat},
    }  # fmt: skip
    (news,) = tell_news(
        {"changes": [change], "slopes": [], "trends": {}}, np.array([30.0, 55.0, 80.0]), cuts_windows=True
    )
    assert news.sentence.startswith(
        "CS002 antenna 2 Y: C changed by a tilt (+5.00 ± 1.05 % at 80 MHz, -4.76 % at 30 MHz) and by -0.36 ± 0.43 % "
        "in the mean over the band, if its noise stayed, on 2015-"
    ), "what was measured is power: of a board with another noise C changed by a fifth less than the alarm said"


YEAR = {"since": "2015-01-01", "until": "2016-01-01"}
WithChange = Callable[..., Factory]


@pytest.fixture
def with_change(
    make_service: Callable[..., Factory], superterp: Instrument, sky_power_file: Path, campaign: Spectra, tmp_path: Path
) -> WithChange:
    """Makes a service that holds the campaign, with an instrument whose antenna 2 has another cable since a date."""

    def make(date: str, spectra: Spectra = campaign, **more: bool) -> Factory:
        content = superterp.as_dict()
        (record,) = [one for one in content["antennas"] if (one["station"], one["antenna"]) == ("CS002", 2)]
        content["cables"]["spare"] = content["cables"][record["cable"]]
        content["antennas"].remove(record)
        content["antennas"] += [{**record, "until": date}, {**record, "cable": "spare", "since": date}]
        instrument, sky = tmp_path / "instrument.json", tmp_path / "sky.json"
        instrument.write_text(json.dumps(content))
        write_sky_power(read_sky_power(sky_power_file), sky)
        return make_service(spectra, instrument=str(instrument), sky_power=sky, **more)

    return make


def refit_window(factory: Factory, scope: str, **window: str) -> Job:
    job = refit(factory, scope, **{**YEAR, **window})
    assert job.state == "done", job.errors
    return job


@pytest.mark.long
def test_a_cable_that_changed_inside_a_year_makes_two_windows_of_its_paths_alone(with_change: WithChange) -> None:
    factory = with_change("2015-04-11")
    refit_window(factory, "antenna")
    with TestClient(make_app(factory)) as client:
        versions = client.get("/v1/calibrations?limit=100").json()["calibrations"]
        windows: dict[int, set[tuple[str, str]]] = {}
        for one in versions:
            windows.setdefault(one["antenna"], set()).add((one["since"][:10], one["until"][:10]))
        whole, change = ("2015-01-01", "2016-01-01"), "2015-04-11"
        assert windows == {a: {whole} for a in (0, 1, 3)} | {2: {(whole[0], change), (change, whole[1])}}
        ask = {"station": "CS002", "antenna": 2, "dipole": "Y"}
        before, after = (
            client.get("/v1/calibrations/effective", params={"at": at, **ask}).json()["curves"][0]
            for at in ("2015-03-01", "2015-06-01")
        )
        # the power gain rises by 15 % at that date: C falls by 6.7 %, and neither window mixes both
        assert np.median(np.array(after["c"]) / np.array(before["c"])) == pytest.approx(1.15**-0.5, abs=0.02)


@pytest.mark.long
def test_a_window_too_small_for_a_fit_borrows_from_its_neighbour_and_says_so(with_change: WithChange) -> None:
    factory = with_change("2015-12-01", cut_windows=False)  # the step in April would part the longer window, too
    refit_window(factory, "antenna")
    with TestClient(make_app(factory)) as client:
        ask = {"station": "CS002", "antenna": 2, "dipole": "X", "at": "2015-12-15"}
        (curve,) = client.get("/v1/calibrations/effective", params=ask).json()["curves"]
        assert curve["answered_by"] == "antenna"
        assert curve["events"] < 60
        version = client.get(f"/v1/calibrations/{curve['calibration']}").json()
        assert "too few events for a fit: C of X is that of other windows, with a gain of its own" in version["reason"]
        (longer,) = client.get("/v1/calibrations/effective", params={**ask, "at": "2015-06-01"}).json()["curves"]
        ratio = np.array(curve["c"]) / np.array(longer["c"])
        assert np.ptp(ratio) < 0.03, "a gain with a tilt and a curvature: nothing else is its own"
        assert np.mean(ratio) == pytest.approx(1.0, abs=0.03)
        assert curve["c_sigma_stat"][20] > longer["c_sigma_stat"][20]


@pytest.mark.long
def test_a_small_window_beside_a_deaf_antenna_borrowed_nothing(with_change: WithChange, campaign: Spectra) -> None:
    """It borrows from another year, once that has a fit, whatever changed between."""
    is_deaf = (campaign.antenna == 2) & (np.abs(campaign.time_unix - 1433894400.0) < 175 * 86400)
    factory = with_change("2015-12-01", campaign.select(~is_deaf))
    assert version_of_december(factory).status == "too_few_events", "nothing stands there to borrow from"
    refit_window(factory, "antenna", since="2014-01-01", until="2015-01-01")
    borrowed = version_of_december(factory)
    assert "too few events for a fit: C of X is that of other windows" in borrowed.reason
    assert "beside" in borrowed.inputs


def version_of_december(factory: Factory) -> Version:
    """What antenna 2 gets for December 2015, after its antenna changed."""
    job = refit_window(factory, "antenna")
    with factory.database.read() as stores:
        found = stores.versions.get_many(job.results[0]["calibrations"]).values()
    (version,) = [one for one in found if one.scope == Scope("CS002", 2, "X") and one.since > start_of_year(2015)]
    return version


def test_a_station_is_fitted_without_the_antenna_whose_cable_changed(with_change: WithChange) -> None:
    """A cable that was changed inside a year refused the whole station's refit."""
    factory = with_change("2015-06-01")
    job = refit_window(factory, "station")
    with factory.database.read() as stores:
        version = stores.versions.get(job.results[0]["calibrations"][0])
    assert {antenna for _, antenna in version.chains["X"].members} == {0, 1, 3}


def test_an_investigation_leaves_out_the_antenna_whose_cable_changed(with_change: WithChange) -> None:
    factory = with_change("2015-06-01")
    body = InvestigationBody.model_validate({**YEAR, "station": "CS002", "reason": "test"})
    number = factory.investigations.request(body, "test")
    work(factory)
    job = get_job(factory, number)
    assert job.state == "done", job.errors
    report = factory.database.look(lambda stores: stores.investigations.get(job.results[0]["results"][0])).report
    # the step was planted in the antenna that is left out
    assert "gain_step" not in [finding["cause"] for finding in report["findings"]]


@pytest.mark.long
def test_a_year_with_an_adopted_cause_is_cut_where_hardware_changed(with_change: WithChange, campaign: Spectra) -> None:
    """Both windows of the path have the cause, of one size, fitted to the whole year of the station."""
    factory = with_change("2015-04-11")
    since, until = start_of_year(2015), start_of_year(2016)
    year = campaign.select((campaign.time_unix >= since / 1e6) & (campaign.time_unix < until / 1e6))
    cause = AdoptedCause("lst_offset", "CS002", "station", 0.0, 0.1)
    chain, extended = (
        Wanted("antenna", Scope("CS002"), since, until, model, "test", "test") for model in (Model(), Model((cause,)))
    )
    plain, made = (
        {(v.scope, v.since): v for v in factory.fits.make(factory.fits.fit_causes(year, one.model), one).versions}
        for one in (chain, extended)
    )
    assert made.keys() == plain.keys()
    assert {path.antenna for path, _ in made} == {0, 1, 2, 3}
    assert len([path for path, _ in made if path.antenna == 2]) == 4
    for key, version in made.items():
        assert version.model == extended.model.id
        assert version.window == plain[key].window
        (now,), (was,) = version.curves, plain[key].curves
        assert np.abs(np.array(now.c) / np.array(was.c) - 1).max() < 0.05, "nothing is off along LST"
        assert np.all(np.array(now.c_sigma_stat) > 0.99 * np.array(was.c_sigma_stat))


def test_antennas_whose_windows_are_cut_escaped_what_is_wrong_with_their_station(
    with_change: WithChange, campaign: Spectra
) -> None:
    """Their pieces are fitted by themselves, and passed the gate while all others were held back as misfits."""
    factory = with_change("2015-04-11")
    since, until = start_of_year(2015), start_of_year(2016)
    year = campaign.select((campaign.time_unix >= since / 1e6) & (campaign.time_unix < until / 1e6))
    wanted = Wanted("antenna", Scope("CS002"), since, until, Model(), "test", "test")
    made = factory.fits.make(factory.fits.fit_causes(year, wanted.model), wanted).versions

    def spoil(*antennas: int) -> list[Version]:
        return [
            replace(one, curves=tuple(curve.as_misfit() for curve in one.curves))
            if one.scope.antenna in antennas
            else one
            for one in made
        ]

    assert len({one.window for one in made}) == 3
    assert {one.status for one in made} == {"converged"}
    assert {one.status for one in share_misfits(spoil(0, 1, 3))} == {"misfit"}
    assert [one.status for one in share_misfits(spoil(0))] == [one.status for one in spoil(0)]


def test_a_watch_whose_events_are_gone_since_it_was_asked_for_ends_without_a_report(factory: Factory) -> None:
    with factory.database.write() as stores:
        number = stores.jobs.add(Order(WATCH, {}, [{}], "", "test"), factory.clock())
    work(factory)
    assert number is not None
    assert get_job(factory, number).state == "done"
    assert factory.database.look(lambda stores: stores.drift.report_made()) is None


def test_a_path_of_which_no_event_was_measured_has_no_newest_spectra(factory: Factory) -> None:
    time_unix, ln_c = 1.4e9 + np.arange(10.0), np.zeros((2, 10, 3), dtype=np.float32)
    ln_c[1] = np.nan
    owners = np.array(["CS001", "CS001"]), np.array([0, 1]), np.array(["X", "X"])
    history = History(*owners, time_unix, ln_c, np.full((2, 0), np.inf))
    with factory.database.read() as stores:
        assert list(_find_left_out(stores, history)) == []
