from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sqlalchemy import update

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.curves.validity import Promotion, Scope
from lbacal_core.spectra.spectra import Spectra
from service.factory import Factory
from service.scheduler import look_for_due_work
from service.schema.tables import calibration, spectrum
from service.storage.changes import STEP, Change, Decision, Evidence, KeptChange
from service.storage.jobs import Job, Part
from service.storage.sums import KeptPiece
from service.storage.versions import Examined, Version
from service.usecases.calibrations import CurveInEffect
from service.usecases.fits import read_served
from service.usecases.refits import _confirm, _find_alike, _list_before
from service.usecases.windows import ALONE
from service.wire.bodies import ChangeBody, DecisionBody, PromotionBody
from tests.service.conftest import (
    add_spectra,
    get_version,
    instant,
    like,
    new_version,
    night,
    refit,
    take_another_model,
    work,
)


@pytest.fixture
def bare(station: Factory) -> Factory:
    """The service of the campaign, without its spectra."""
    with station.database.write() as stores:
        connection = stores.spectra._connection
        connection.exec_driver_sql("DELETE FROM spectrum")
        connection.exec_driver_sql("DELETE FROM event_station")
    return station


def spoil(campaign: Spectra, row: int, factor: float) -> Spectra:
    power = campaign.power.copy()
    power[row] = np.minimum(power[row] * factor, 1e308)
    return replace(campaign, power=power)


@pytest.mark.long
@pytest.mark.parametrize("factor", [1000.0, 3.0, 1e308])
def test_one_bad_spectrum_stopped_array_station_and_path_for_the_year(
    bare: Factory, campaign: Spectra, factor: float
) -> None:
    row = int(np.flatnonzero((campaign.antenna == 2) & (campaign.dipole == "X"))[77])
    add_spectra(bare, spoil(campaign, row, factor))
    window = campaign.time_unix < np.datetime64("2015-01-01", "s").astype(float)
    for scope, count in (("array", 1), ("station", 1), ("antenna", 8)):
        job = refit(bare, scope)
        result = job.results[0]
        assert (len(result["promoted"]), result["gated"]) == (count, {}), scope
        clean = {c.name: c for c in fit_calibration(
            campaign.select(window), bare.simulation, scope).curves}  # fmt: skip
        for name in result["calibrations"]:
            version = get_version(bare, name)
            of_path = version.scope.key in ("array", "CS002", "CS002/2/X")
            named = [(one.event_id, one.path) for one in version.anomalies.worst]
            assert named == ([(str(campaign.event_id[row]), "CS002/2/X")] if of_path else []), scope
            for curve in version.curves:
                expected = clean[curve.name]
                # one event of 400 less
                assert np.all(np.abs(curve.c - expected.c) < 0.3 * expected.c_sigma_stat), curve.name


def test_the_gate_names_the_events_that_made_it_object(bare: Factory, campaign: Spectra) -> None:
    """Every twelfth event is a state of the path, which no rule may leave out: a human decides, who is told which."""
    of_path = np.flatnonzero((campaign.antenna == 2) & (campaign.dipole == "X"))
    power = campaign.power.copy()
    power[of_path[::12]] *= 1000.0
    add_spectra(bare, replace(campaign, power=power))
    result = refit(bare, "antenna").results[0]
    (objection,) = result["gated"].values()
    assert objection.startswith("CS002 antenna 2 X: ")
    assert "; worst events: " in objection
    assert objection.count(" of CS002/2/X (power ") == 3
    assert "of the 396 spectra" in objection or "spectra of this path are like this" in objection
    assert len(result["promoted"]) == 7
    assert len(refit(bare, "station").results[0]["promoted"]) == 1, "the mean does without that path"


def test_what_was_left_out_is_shown_and_stays_in_the_database(bare: Factory, campaign: Spectra) -> None:
    row = int(np.flatnonzero((campaign.antenna == 1) & (campaign.dipole == "Y"))[5])
    name = str(campaign.event_id[row])
    add_spectra(bare, spoil(campaign, row, 50.0))
    version = get_version(bare, refit(bare, "station").results[0]["calibrations"][0])
    assert (version.anomalies.left_out, version.anomalies.worst[0].event_id) == (1, name)
    with bare.database.read() as stores:
        stored = stores.spectra.event(name)
    assert (stored.spectra, stored.flag) == (8, None)


def refits_of_night(factory: Factory) -> list[Job]:
    return [job for job in night(factory) if job.kind == "refit"]


def flag_first(station: Factory, campaign: Spectra) -> None:
    first = campaign.event_id[np.argmin(campaign.time_unix)]
    station.intake.set_flag(str(first), "bad", reason="test", by="test")


def count(factory: Factory, name: str) -> int:
    with factory.database.read() as stores:
        return int(stores.versions._connection.exec_driver_sql(f"SELECT count(*) FROM {name}").scalar_one())  # noqa: S608


@pytest.mark.long
def test_a_night_that_hardly_moves_c_leaves_no_version_and_is_not_due_again(
    after_night: Factory, campaign: Spectra
) -> None:
    """After 365 nights of one station its page was 11 MB: every new event made 576 versions and promotions."""
    before = {name: count(after_night, name) for name in ("calibration", "promotion")}
    flag_first(after_night, campaign)
    jobs = refits_of_night(after_night)
    results = [job.results[0] for job in jobs]
    news = sum(len(result["promoted"]) for result in results)
    examined = sum(result["examined"] for result in results)
    assert (news + examined, [result["gated"] for result in results]) == (10, [{}] * 3)
    assert examined >= 8, "one event of 400 moves C by about 0.05 standard deviations"
    assert count(after_night, "calibration") == before["calibration"] + news
    assert count(after_night, "promotion") == before["promotion"] + news
    assert look_for_due_work(after_night) == []
    assert count(after_night, "examined") == examined + 10, "the other year looked at its neighbour's lines"


@pytest.mark.long
def test_a_channel_without_a_value_made_the_night_fail_on_sqlite_and_was_kept_for_ever_on_postgresql(
    after_night: Factory, campaign: Spectra
) -> None:
    """C of 62 to 66 events has no value at 80 MHz: the shift to the next night was NaN, which is NULL in SQLite."""
    path = Scope("CS002", 0, "X")
    with after_night.database.write() as stores:
        in_effect = stores.ledger.answers([path], 1_400_000_000_000_000, None)[path][0].calibration
        (version,) = stores.versions.get_many([str(in_effect)]).values()
        (curve,) = version.payload
        for name in ("c", "c_sigma_stat", "c_sigma_sys", "c_over_h"):
            curve[name][-1] = None
        curve["flag"][-1], curve["covariance"] = "outside", None
        stored = update(calibration).where(calibration.c.id == in_effect)
        stores.versions._connection.execute(stored.values(curves=json.dumps([curve])))
    flag_first(after_night, campaign)
    jobs = refits_of_night(after_night)
    assert [(job.state, job.errors) for job in jobs] == [("done", ())] * 3
    (of_paths,) = (job.results[0] for job in jobs if job.request["scope"] == "antenna")
    assert in_effect not in of_paths["promoted"]
    made = [get_version(after_night, name) for name in of_paths["promoted"]]
    assert path in [version.scope for version in made], "a channel that got its value is news"


@pytest.mark.long
def test_what_was_examined_confirms_the_version_in_effect(after_night: Factory, campaign: Spectra) -> None:
    flag_first(after_night, campaign)
    night(after_night)
    with after_night.database.read() as stores:
        rows = stores.versions._connection.exec_driver_sql("SELECT calibration FROM examined ORDER BY scope").scalars()
        found = [stores.versions.confirmation(name) for name in rows.all()]
    assert found
    for one in found:
        assert isinstance(one, Examined)
        assert 0 <= one.shift < 0.25
        assert one.inputs != one.calibration
        version = get_version(after_night, one.calibration)
        assert (version.scope, version.window) == (one.scope, (one.since, one.until))
    assert {one.scope.station for one in found if one} <= {None, "CS002"}


@pytest.mark.parametrize(
    ("spectra", "decided", "answers"),
    [("later", "between", "before"), ("later", "never", "after"), ("still later", "between", "before")],
)
def test_what_answered_before_a_decision_that_is_undone_answers_again(
    factory: Factory, spectra: str, decided: str, answers: str
) -> None:
    """The first fit after it was 0.45 sigma away, since other years still lent other lines; the next confirmed that."""

    def fitted(of: str, sigmas: float, by: str) -> Version:
        made = new_version(Scope("CS001"), by, 1.0 + sigmas * 0.01 / 4.0)  # sigma over the largest C
        return replace(made, inputs={"spectra": of, "beside": by})

    before, after, new = fitted("early", 0.0, "1"), fitted("later", 0.45, "2"), fitted(spectra, 0.22, "1")
    promotions = [Promotion(0, one.scope, *one.window, one.id, 0, "night", "") for one in (before, after)]
    with factory.database.write() as stores:
        stores.versions.add([before, after])
        ((first,), _) = [stores.ledger.append([one], factory.clock) for one in promotions]
        one = _confirm(stores, new, after, None, (), {"between": first.at, "never": 0}[decided])
    assert one is not None
    assert one.calibration == {"before": before, "after": after}[answers].id


def test_of_two_fits_of_the_same_spectra_the_first_answers_however_often_they_took_turns(factory: Factory) -> None:
    """Each that was near enough took the place of the other, whenever lines of another year moved."""
    scope, c = Scope("CS001"), {"one": 1.0, "other": 1.0004, "new": 1.0002}
    one, other, new = (
        replace(
            new_version(scope, name, c[name]), inputs={"spectra": "all", "beside": name}, made=instant("2020-01-01") + k
        )
        for k, name in enumerate(c)
    )
    with factory.database.write() as stores:
        stores.versions.add([one, other])
        for last in (one, other, one, other):
            stores.ledger.append([Promotion(0, scope, *last.window, last.id, 0, "night", "")], factory.clock)
            found = _confirm(stores, new, last, None, (), 0)
            assert found is not None
            assert found.calibration == one.id


@pytest.mark.parametrize("is_due", [True, False])
def test_due_work_counts_a_fit_that_gave_the_version_in_effect_as_examined(factory: Factory, is_due: bool) -> None:
    """A job named twelve versions as made that it had found in effect."""
    same, new = (new_version(Scope("CS001", antenna, "X"), f"fit {antenna}") for antenna in (0, 1))
    asked = {"promote": True, "station": "CS001", "since": same.since, "until": same.until}
    part = Part(1, 1, "refit", asked, "", "night", is_due)
    with factory.database.write() as stores:
        stores.versions.add([same])
        stores.ledger.append([Promotion(0, same.scope, *same.window, same.id, 0, "night", "")], factory.clock)
        kept = factory.refits._keep(stores, [same, new], part, {}, ALONE)
    assert kept.result["promoted"] == [new.id]
    assert kept.result["gated"] == {}
    made = [new.id] if is_due else [same.id, new.id]
    assert (kept.result["calibrations"], kept.result["examined"]) == (made, int(is_due))
    assert [one.is_in_effect for one in kept.served.values()] == [True, True]


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_due_work_that_was_news_answered_where_a_person_had_withdrawn(factory: Factory, share: float) -> None:
    """Over the rest of its window it answers; over all of it, or after it, no fit does until a person promotes."""
    scope = Scope("CS001", 0, "X")
    fits = [(f"fit {c}", new_version(scope, f"fit {c}", c)) for c in (1.0, 1.01, 1.02)]
    old, new, newest = (replace(one, inputs={"spectra": name}) for name, one in fits)
    since, until = old.window
    part = Part(1, 1, "refit", {"promote": True, "station": "CS001", "since": since, "until": until}, "", "night", True)
    end = since + int(share * (until - since))

    def promote(version: Version | None, by: str) -> None:
        name, to = (None, end) if version is None else (version.id, until)
        with factory.database.write() as stores:
            stores.versions.add([version] if version else [])
            stores.ledger.append([Promotion(0, scope, since, to, name, 0, by, "wrong cables")], factory.clock)

    def keep(version: Version) -> list[tuple[int, int | None]]:
        with factory.database.write() as stores:
            kept = factory.refits._keep(stores, [version], part, {}, ALONE)
            stores.ledger.append(kept.promotions, factory.clock)
        told = {version.id: "withdrawn by key 1 on 2020-01-01 (wrong cables): nothing answers until a person promotes"}
        assert kept.result["gated"] == ({} if kept.promotions else told)
        assert get_version(factory, version.id).gate == kept.result["gated"].get(version.id)
        return [(one.valid_from, one.valid_to) for one in kept.promotions]

    promote(old, "scheduler")
    promote(None, "key 1")
    assert keep(new) == ([(end, until)] if share < 1.0 else [])
    promote(new, "key 1")
    assert keep(newest) == [(since, until)]


def test_a_night_asks_what_answered_when_the_changes_were_those_of_now(factory: Factory) -> None:
    """The same fit that was in effect before a change was found is to answer again once it is dismissed."""
    scope = Scope("CS001", 0, "X")
    early, before, after = (
        replace(new_version(scope, name, c), inputs={"spectra": name})
        for name, c in (("early", 0.99), ("before", 1.0), ("after", 1.01))
    )
    window = before.window

    def list_before(found: int, served: Version) -> dict[Any, Any]:
        said = (Decision("dismissed", found + 1, "", ""),)
        change = KeptChange(1, Change("CS001", ((0, "X"),), STEP, 0, 0), found, (Evidence("drift", "", 9.0, 0),), said)
        piece = KeptPiece(*window, [], [read_served(served, (), is_in_effect=True)])
        return _list_before(stores, [piece], [change])

    with factory.database.write() as stores:
        stores.versions.add([early, before, after])
        made = [Promotion(0, scope, *window, one.id, 0, "night", "") for one in (early, before, after)]
        (_, then, now) = [stores.ledger.append([one], factory.clock)[0] for one in made]
        ((key, one),) = list_before(then.at, after).items()
        assert list_before(now.at, after) == {}, "it answers now as then"
        assert list_before(0, after) == {}, "nothing answered then"
    assert key == (scope, *window)
    assert (one.calibration, one.is_in_effect) == (before.id, False)
    np.testing.assert_array_equal(one.curves["X"][0], before.curves[0].c)


def test_changes_are_in_force_as_before_where_a_decision_is_undone_and_for_the_paths_it_concerns() -> None:
    """Another antenna's version of before a decision came back, and what the decision itself had brought."""
    change = Change("CS001", ((1, "X"),), STEP, 0, 0)

    def last_alike(*decisions: str, path: tuple[int, str] | tuple[()] = (1, "X"), ended: int | None = None) -> int:
        said = tuple(Decision(one, 10 * (k + 2), "", "") for k, one in enumerate(decisions))
        drift = Evidence("drift", "", 9.0, 10, ended=ended)
        return _find_alike([KeptChange(1, change, 10, (drift,), said)], Scope("CS001", *path))

    assert [last_alike(), last_alike("in_force")] == [0, 0]
    assert last_alike("dismissed") == 10, "as before it was found"
    assert last_alike("dismissed", "in_force") == 20
    assert last_alike("dismissed", "in_force", "dismissed") == 30
    assert last_alike("dismissed", "in_force", "in_force") == 20
    assert last_alike(ended=70) == 10
    assert [last_alike("dismissed", path=path) for path in ((1, "Y"), (2, "X"), ())] == [0, 0, 10]


@pytest.mark.long
def test_a_refit_that_was_asked_for_stores_its_version_however_little_it_moves(
    after_night: Factory, campaign: Spectra
) -> None:
    flag_first(after_night, campaign)
    night(after_night)
    before = count(after_night, "calibration")
    result = refit(after_night, "antenna").results[0]
    assert (len(result["calibrations"]), len(result["promoted"]), result["examined"]) == (8, 8, 0)
    assert count(after_night, "calibration") >= before + 8 - 2, "at most two of them were news to the night"


@pytest.mark.long
def test_a_night_with_news_stores_it(after_night: Factory, campaign: Spectra) -> None:
    of_year = np.unique(campaign.event_id[campaign.time_unix < np.datetime64("2015-01-01", "s").astype(float)])
    for name in of_year[::3]:
        after_night.intake.set_flag(str(name), "bad", reason="test", by="test")
    results = [job.results[0] for job in refits_of_night(after_night)]
    assert sum(len(result["promoted"]) for result in results) >= 8
    changed = [v for result in results for v in result["promoted"]]
    with after_night.database.read() as stores:
        said = stores.ledger.answers([Scope("CS002", 0, "X")], 1_400_000_000_000_000, None)
    assert said[Scope("CS002", 0, "X")][0].calibration in changed


@pytest.mark.long
def test_another_model_is_news_even_where_c_stays(after_night: Factory, monkeypatch: pytest.MonkeyPatch) -> None:
    before = count(after_night, "calibration")
    take_another_model(monkeypatch)
    with like(after_night) as later:
        results = [job.results[0] for job in refits_of_night(later)]
    assert [result["examined"] for result in results] == [0] * 6
    assert count(after_night, "calibration") == 2 * before


def test_spectra_in_volts_fail_the_refit_with_the_reason(bare: Factory, campaign: Spectra) -> None:
    add_spectra(bare, replace(campaign, power=campaign.power**0.5))
    job = refit(bare, "station")
    assert job.state == "failed"
    assert "the power is an amplitude (volts), not its square" in job.errors[0]


@pytest.mark.long
def test_a_version_that_a_later_night_replaced_waited_for_a_human_for_ever(after_night: Factory) -> None:
    """A year's first versions have too few events: the status went on to count them when the year was calibrated."""
    with after_night.database.write() as stores:
        version = max(stores.versions.search(None, None, "", 1000), key=lambda one: one.made)
        assert len(stores.versions.waiting()) == 0
        for made, waiting in ((version.made - 1, 0), (version.made + HOUR_US, 1)):
            kept_back = replace(version, inputs={**version.inputs, "number": made}, made=made, gate="too_few_events")
            stores.versions.add([kept_back])
            assert len(stores.versions.waiting()) == waiting
        # what was promoted later on both sides of a change covers the year of which it was kept back
        half = (version.since + version.until) // 2
        for ends, waiting in (((version.since, half), 1), ((half, version.until), 0)):
            promotion = Promotion(0, version.scope, *ends, version.id, 0, "night", "")
            stores.ledger.append([promotion], lambda: version.made + 2 * HOUR_US)
            assert len(stores.versions.waiting()) == waiting


HOUR_US = 3_600_000_000
SCOPES = ("antenna", "array", "station")


@pytest.fixture
def year(make_service: Callable[..., Factory], campaign: Spectra) -> Factory:
    """A service that holds the year 2014 but for its last five events, and has made its versions."""
    made = make_service(lease_s=5.0)
    store(made, campaign, slice(None, -5))
    refit_by_night(made)
    return made


def events_of(campaign: Spectra) -> list[str]:
    """Names of the events of 2014 in order of time."""
    in_year = campaign.time_unix < np.datetime64("2015-01-01", "s").astype(float)
    names, first = np.unique(campaign.event_id[in_year], return_index=True)
    return [str(name) for name in names[np.argsort(campaign.time_unix[in_year][first])]]


def store(factory: Factory, campaign: Spectra, which: slice) -> Spectra:
    some = campaign.select(np.isin(campaign.event_id, events_of(campaign)[which]))
    add_spectra(factory, some)
    return some


def refit_by_night(factory: Factory) -> dict[str, Any]:
    """The results of the refits of one night, by scope."""
    jobs = [job for job in night(factory) if job.kind == "refit"]
    assert not any(job.errors for job in jobs)
    return {str(job.request["scope"]): job.results[0] for job in jobs}


def kept(factory: Factory) -> dict[str, tuple[int, int]]:
    """How many spectra the kept fits were made from, and their newest events."""
    with factory.database.read() as stores:
        rows = stores.versions._connection.exec_driver_sql(
            "SELECT kind, spectra, event FROM sums WHERE kind <> 'drift'"
        ).all()
    return {kind: (spectra, event) for kind, spectra, event in rows}


def test_a_night_after_one_more_event_reads_that_event_alone(year: Factory, campaign: Spectra) -> None:
    before = kept(year)
    assert sorted(before) == list(SCOPES)
    with year.database.write() as stores:
        # a fit from these would not converge
        stores.versions._connection.execute(update(spectrum).values(power=bytes(8 * campaign.frequency_mhz.size)))
    store(year, campaign, slice(-5, -4))
    results = refit_by_night(year)
    assert {scope: (one["examined"], one["calibrations"]) for scope, one in results.items()} == {
        "antenna": (8, []), "station": (1, []), "array": (1, []),
    }  # fmt: skip
    assert kept(year) == before, "what is kept is not added to"


@pytest.mark.long
def test_what_was_examined_is_what_a_fit_from_spectra_says(year: Factory, campaign: Spectra) -> None:
    before = kept(year)
    store(year, campaign, slice(-5, -3))
    refit_by_night(year)
    assert kept(year) == before
    told = shifts(year)
    with year.database.write() as stores:
        stores.versions._connection.exec_driver_sql("DELETE FROM sums")
    first = events_of(campaign)[0]
    for flag in ("bad", None):
        year.intake.set_flag(first, flag, reason="test", by="test")
    refit_by_night(year)
    fitted = shifts(year)
    assert told.keys() == fitted.keys()
    assert len(told) == 10
    assert max(abs(told[key] - fitted[key]) for key in told) < 0.1


def shifts(factory: Factory) -> dict[str, float]:
    with factory.database.read() as stores:
        rows = stores.versions._connection.exec_driver_sql("SELECT scope, shift FROM examined").all()
    return {row.scope: row.shift for row in rows}


@pytest.mark.long
def test_a_late_spectrum_of_an_event_that_was_there_is_fitted_from_spectra(year: Factory, campaign: Spectra) -> None:
    """Data of one antenna that arrive a day after those of the others have events that the kept fit holds already."""
    new = campaign.select(campaign.event_id == events_of(campaign)[-5])
    with year.database.write() as stores:
        stores.spectra.add(new.select(new.antenna != 2))
        stores.versions._connection.exec_driver_sql("DELETE FROM sums")
    refit_by_night(year)
    spectra = 8 * (len(events_of(campaign)) - 5)
    assert {count for count, _ in kept(year).values()} == {spectra + 6}
    add_spectra(year, new.select(new.antenna == 2))
    refit_by_night(year)
    assert {count for count, _ in kept(year).values()} == {spectra + 8}


@pytest.mark.long
def test_a_flag_an_anomalous_event_and_a_promotion_are_left_to_a_fit_from_spectra(
    year: Factory, campaign: Spectra
) -> None:
    names = events_of(campaign)
    year.intake.set_flag(names[0], "bad", reason="test", by="test")
    before = kept(year)
    refit_by_night(year)
    flagged = kept(year)
    assert {scope: flagged[scope][0] - before[scope][0] for scope in SCOPES} == dict.fromkeys(SCOPES, -8)

    new = campaign.select(campaign.event_id == names[-5])
    add_spectra(year, replace(new, power=new.power * np.where(new.antenna == 1, 9.0, 1.0)[:, None]))
    results = refit_by_night(year)
    assert {scope: kept(year)[scope][0] - flagged[scope][0] for scope in SCOPES} == {
        "antenna": 0, "array": 8, "station": 8,
    }, "one antenna is fitted from its own spectra, and its means from all"  # fmt: skip
    assert results["antenna"]["examined"] == 8, "its spectrum is left out, and moves nothing"

    path = Scope("CS002", 0, "X")
    with year.database.write() as stores:
        (in_effect,) = stores.ledger.decisive([path], instant("2014-06-01"), None).values()
        (version,) = stores.versions.get_many([str(in_effect.calibration)]).values()
        other = replace(version, inputs={**version.inputs, "other": True})
        stores.versions.add([other])
    for name, read, which in ((None, [], -4), (other.id, ["antenna"], -3)):
        body = PromotionBody(
            calibration=name, station="CS002", antenna=0, dipole="X", valid_from="2014-01-01", valid_to="2015-01-01",
            reason="test",
        )  # fmt: skip
        year.promotions.promote(year.promotions.plan(body, "test"), lambda made, _: made)
        store(year, campaign, slice(which, which + 1))
        before = kept(year)
        refit_by_night(year)
        assert [scope for scope in SCOPES if kept(year)[scope] != before[scope]] == read, "due work said the same"


@pytest.mark.long
def test_a_path_that_moves_is_fitted_by_itself_with_the_budget_of_its_station(year: Factory, campaign: Spectra) -> None:
    """Of 96 paths about two a night have moved by a quarter of their error since their version was made."""
    new = campaign.select(np.isin(campaign.event_id, events_of(campaign)[-5:]))
    louder = np.where((new.antenna == 3) & (new.dipole == "Y"), 1.15, 1.0)[:, None]
    add_spectra(year, replace(new, power=new.power * louder))
    before = kept(year)
    results = refit_by_night(year)
    (name,) = (one for one in results["antenna"]["promoted"] if get_version(year, one).scope.key == "CS002/3/Y")
    assert len(results["antenna"]["promoted"]) + results["antenna"]["examined"] == 8
    assert kept(year)["antenna"] == before["antenna"]
    version = get_version(year, name)
    with year.database.read() as stores:
        assert version.inputs["budget"] == version.curves[0].covariance.budget
        assert stores.budgets.get_texts([version.inputs["budget"]])
    again = refit(year, "antenna", promote=False).results[0]
    made = [get_version(year, one) for one in again["calibrations"]]
    whole = next(one for one in made if one.scope == version.scope)
    np.testing.assert_allclose(whole.curves[0].c, version.curves[0].c, rtol=1e-9)  # sums in another order
    np.testing.assert_allclose(whole.curves[0].c_sigma_sys, version.curves[0].c_sigma_sys, rtol=0.05)


def test_a_mean_that_was_fitted_while_a_change_was_in_force_is_fitted_again_once_it_is_dismissed(
    make_service: Callable[..., Factory], campaign: Spectra
) -> None:
    """The window beside it lent nothing meanwhile, and nothing that named the work said so."""
    made, since = make_service(cut_windows=False), int(np.datetime64("2015-01-01", "us").astype(int))
    add_spectra(made, campaign.select(campaign.time_unix < since / 1e6))
    night(made)
    add_spectra(made, campaign.select(campaign.time_unix >= since / 1e6))
    path = {"station": "CS002", "antenna": 0, "dipole": "X"}
    entered = ChangeBody.model_validate({"paths": [path], "at": {"value": "2014-07-01"}, "reason": "test"})
    parts = len(look_for_due_work(made))
    number = made.changes.enter(entered, "test").number
    for _ in range(parts):
        with made.database.write() as stores:
            part = stores.jobs.claim("test", lease_us=10**9, inputs=made.inputs.text)
        assert part is not None
        (made.refits if part.kind == "refit" else made.drift_measurement).run(part, "test")
    made.changes.decide(number, DecisionBody(decision="dismissed", reason="test"), "test")
    while look_for_due_work(made):
        work(made)
    with made.database.read() as stores:
        said = stores.ledger.decisive_at([(scope, since + 1) for scope in (Scope(), Scope("CS002"))])
        versions = stores.versions.get_many([str(one.calibration) for one in said.values()])
    assert [version.scope.key for version in versions.values() if "beside" not in version.inputs] == []


@pytest.mark.long
def test_an_antenna_that_came_back_with_another_gain_waited_for_ever(bare: Factory, campaign: Spectra) -> None:
    """Its step cut no window, as nobody knew the date to 90 days, and the gate counted what cuts alone."""
    power, since = campaign.power.copy(), np.datetime64("2015-01-01", "s").astype(float)
    power[(campaign.antenna == 1) & (campaign.time_unix >= since)] *= 0.7
    add_spectra(bare, replace(campaign, power=power))
    night(bare)

    def answer() -> CurveInEffect:
        return bare.calibrations.in_effect(instant("2015-06-01"), [Scope("CS002", 1, "X")]).curves[0]

    assert answer().promotion.scope == Scope("CS002")
    assert "of CS002 antenna 1 X waits for a person to promote it (CS002 antenna 1 X: mean C differs by" in answer().why
    body = {
        "paths": [{"station": "CS002", "antenna": 1}], "at": {"value": "2014-10-01", "sigma_days": 94.0},
        "size": {"value": 0.195, "sigma": 0.002}, "reason": "test",
    }  # fmt: skip
    assert bare.changes.enter(ChangeBody.model_validate(body), "test").cuts == []
    night(bare)
    assert answer().version.window == (instant("2015-01-01"), instant("2016-01-01"))
    assert answer().promotion.scope.antenna == 1
    assert "waits" not in answer().why
    assert night(bare) == []


@pytest.mark.long
def test_a_decision_announced_c_that_waited_at_the_gate_because_of_the_change_that_was_dismissed(
    bare: Factory, campaign: Spectra
) -> None:
    """The mean over a step differs by more than 10 % from either side, which nobody could put into effect again."""
    power, date = campaign.power.copy(), np.datetime64("2014-07-01", "s").astype(float)
    power[(campaign.antenna == 1) & (campaign.time_unix >= date)] *= 0.55
    add_spectra(bare, replace(campaign, power=power))
    body = {
        "paths": [{"station": "CS002", "antenna": 1}], "at": {"value": "2014-07-01"},
        "size": {"value": 0.348, "sigma": 0.002}, "reason": "test",
    }  # fmt: skip
    number = bare.changes.enter(ChangeBody.model_validate(body), "test").number
    night(bare)
    dismissed, path = DecisionBody(decision="dismissed", reason="test"), Scope("CS002", 1, "X")
    strict = replace(bare.changes, gate=replace(bare.gate, error=1e-9))
    _, changes, left_out = strict.foresee(number, dismissed, "test")
    assert (changes, {"at most 0.0% passes" in why for why in left_out.values()}) == ([], {True})
    _, changes, left_out = bare.changes.foresee(number, dismissed, "test")
    (after,) = {one.after for one in changes if one.path == path}
    assert left_out == {}
    bare.changes.decide(number, dismissed, "test")
    night(bare)
    for at in (instant("2014-03-01"), instant("2014-10-01")):
        assert bare.calibrations.in_effect(at, [path]).curves[0].version.id == after
