"""A night after one more event reads that event; what else may have changed is left to a fit from spectra."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sqlalchemy import update

from lbacal_core.spectra.spectra import Spectra
from service.factory import Factory
from service.schema.tables import spectrum
from service.wire.bodies import PromotionBody
from tests.service.conftest import add_spectra, night, refit

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
        rows = stores.versions._connection.exec_driver_sql("SELECT kind, spectra, event FROM kept_fit").all()
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
        stores.versions._connection.exec_driver_sql("DELETE FROM kept_fit")
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
        stores.versions._connection.exec_driver_sql("DELETE FROM kept_fit")
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

    body = PromotionBody(
        calibration=None, station="CS002", antenna=0, dipole="X", valid_from="2014-01-01", valid_to="2015-01-01",
        reason="test",
    )  # fmt: skip
    year.promotions.promote(year.promotions.plan(body, "test"), lambda made, _: made)
    store(year, campaign, slice(-4, -3))
    before = kept(year)
    refit_by_night(year)
    assert [scope for scope in SCOPES if kept(year)[scope] != before[scope]] == ["antenna"]


def test_a_path_that_moves_is_fitted_by_itself_with_the_budget_of_its_station(year: Factory, campaign: Spectra) -> None:
    """Of 96 paths about two a night have moved by a quarter of their error since their version was made."""
    new = campaign.select(np.isin(campaign.event_id, events_of(campaign)[-5:]))
    louder = np.where((new.antenna == 3) & (new.dipole == "Y"), 1.15, 1.0)[:, None]
    add_spectra(year, replace(new, power=new.power * louder))
    before = kept(year)
    results = refit_by_night(year)
    (name,) = (one for one in results["antenna"]["promoted"] if year.calibrations.get(one).scope.key == "CS002/3/Y")
    assert len(results["antenna"]["promoted"]) + results["antenna"]["examined"] == 8
    assert kept(year)["antenna"] == before["antenna"]
    version = year.calibrations.get(name)
    with year.database.read() as stores:
        assert version.inputs["budget"] == version.curves[0].covariance.budget
        assert stores.budgets.get_many([version.inputs["budget"]])
    again = refit(year, "antenna", promote=False).results[0]
    made = [year.calibrations.get(one) for one in again["calibrations"]]
    whole = next(one for one in made if one.scope == version.scope)
    np.testing.assert_allclose(whole.curves[0].c, version.curves[0].c, rtol=1e-9)  # sums in another order
    np.testing.assert_allclose(whole.curves[0].c_sigma_sys, version.curves[0].c_sigma_sys, rtol=0.05)
