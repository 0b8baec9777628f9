from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient

from lbacal_core.causes.model import AdoptedCause, Model
from lbacal_core.curves.validity import Scope
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.skypower.table import read_sky_power, write_sky_power
from lbacal_core.spectra.spectra import Spectra
from service.app import make_app
from service.factory import Factory
from service.storage.jobs import Job
from service.storage.versions import Version
from service.usecases.drift import start_of_year
from service.usecases.fits import Wanted
from service.usecases.windows import share_misfits
from service.wire.bodies import InvestigationBody
from tests.service.conftest import refit, work

YEAR = {"since": "2015-01-01", "until": "2016-01-01"}


@pytest.fixture
def with_change(
    make_service: Callable[..., Factory], superterp: Instrument, sky_power_file: Path, campaign: Spectra, tmp_path: Path
) -> Callable[..., Factory]:
    """Makes a service that holds the campaign, with an instrument whose antenna 2 has another cable since a date."""

    def make(date: str, spectra: Spectra = campaign) -> Factory:
        content = superterp.as_dict()
        (record,) = [one for one in content["antennas"] if (one["station"], one["antenna"]) == ("CS002", 2)]
        content["cables"]["spare"] = content["cables"][record["cable"]]
        content["antennas"].remove(record)
        content["antennas"] += [{**record, "until": date}, {**record, "cable": "spare", "since": date}]
        instrument, sky = tmp_path / "instrument.json", tmp_path / "sky.json"
        instrument.write_text(json.dumps(content))
        write_sky_power(read_sky_power(sky_power_file), sky)
        return make_service(spectra, instrument=str(instrument), sky_power=sky)

    return make


def refit_window(factory: Factory, scope: str, **window: str) -> Job:
    job = refit(factory, scope, **{**YEAR, **window})
    assert job.state == "done", job.errors
    return job


def test_a_cable_that_changed_inside_a_year_makes_two_windows_of_its_paths_alone(
    with_change: Callable[..., Factory],
) -> None:
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


def test_a_window_too_small_for_a_fit_borrows_from_its_neighbour_and_says_so(
    with_change: Callable[..., Factory],
) -> None:
    factory = with_change("2015-12-01")
    refit_window(factory, "antenna")
    with TestClient(make_app(factory)) as client:
        ask = {"station": "CS002", "antenna": 2, "dipole": "X", "at": "2015-12-15"}
        (curve,) = client.get("/v1/calibrations/effective", params=ask).json()["curves"]
        assert curve["answered_by"] == "antenna"
        assert curve["events"] < 60
        version = client.get(f"/v1/calibrations/{curve['calibration']}").json()
        assert "too few events for a fit: C is that of 2015-01-01 to 2015-12-01" in version["reason"]
        (longer,) = client.get("/v1/calibrations/effective", params={**ask, "at": "2015-06-01"}).json()["curves"]
        ratio = np.array(curve["c"]) / np.array(longer["c"])
        assert np.ptp(ratio) < 1e-9, "one gain: nothing else is its own"
        assert ratio[0] == pytest.approx(1.0, abs=0.03)
        assert curve["c_sigma_stat"][20] > longer["c_sigma_stat"][20]


def test_a_small_window_beside_a_deaf_antenna_borrowed_nothing(
    with_change: Callable[..., Factory], campaign: Spectra
) -> None:
    """It borrows from the nearest window in effect, here that of the year before, and says so."""
    is_deaf = (campaign.antenna == 2) & (np.abs(campaign.time_unix - 1433894400.0) < 175 * 86400)
    factory = with_change("2015-12-01", campaign.select(~is_deaf))
    assert "of 2014-01-01 to 2015-01-01" not in reason_of_december(factory), "nothing stands there to borrow from"
    refit_window(factory, "antenna", since="2014-01-01", until="2015-01-01")
    assert "too few events for a fit: C is that of 2014-01-01 to 2015-01-01" in reason_of_december(factory)


def test_a_piece_borrowed_from_a_window_over_the_change_or_from_the_farthest(
    with_change: Callable[..., Factory], campaign: Spectra
) -> None:
    factory, (since, until) = with_change("2015-12-01"), map(start_of_year, (2015, 2016))
    path = Scope("CS002", 2, "X")

    def make(since: int, until: int, lenders: Sequence[Version] = ()) -> list[Version]:
        spectra = campaign.select((campaign.time_unix >= since / 1e6) & (campaign.time_unix < until / 1e6))
        wanted = Wanted("antenna", Scope("CS002"), since, until, Model(), "test", "test")
        made = factory.fits.make(factory.fits.fit_causes(spectra, Model()), wanted, find_lenders=lambda _: lenders)
        return [one for one in made.versions if one.scope == path]

    (far,) = make(start_of_year(2014), since)
    over = replace(far, since=since, until=until, inputs={**far.inputs, "scope": "over the change"})
    (near, piece) = make(since, until, [far, over])
    assert since < near.until == piece.since
    assert piece.inputs["borrowed_from"] == near.id


def reason_of_december(factory: Factory) -> str:
    """Why antenna 2 has the version that it gets for December 2015, after its antenna changed."""
    job = refit_window(factory, "antenna")
    with factory.database.read() as stores:
        found = stores.versions.get_many(job.results[0]["calibrations"]).values()
    (version,) = [one for one in found if one.scope == Scope("CS002", 2, "X") and one.since > start_of_year(2015)]
    return version.reason


def test_a_station_is_fitted_without_the_antenna_whose_cable_changed(with_change: Callable[..., Factory]) -> None:
    """A cable that was changed inside a year refused the whole station's refit."""
    factory = with_change("2015-06-01")
    job = refit_window(factory, "station")
    with factory.database.read() as stores:
        version = stores.versions.get(job.results[0]["calibrations"][0])
    assert {antenna for _, antenna in version.chains["X"].members} == {0, 1, 3}


def test_an_investigation_leaves_out_the_antenna_whose_cable_changed(with_change: Callable[..., Factory]) -> None:
    factory = with_change("2015-06-01")
    body = InvestigationBody.model_validate({**YEAR, "station": "CS002", "reason": "test"})
    number = factory.investigations.request(body, "test")
    work(factory)
    job = factory.jobs.get(number)
    assert job.state == "done", job.errors
    report = factory.investigations.get(job.results[0]["results"][0]).report
    # the step was planted in the antenna that is left out
    assert "gain_step" not in [finding["cause"] for finding in report["findings"]]


@pytest.mark.long
def test_a_year_with_an_adopted_cause_is_cut_where_hardware_changed(
    with_change: Callable[..., Factory], campaign: Spectra
) -> None:
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
    with_change: Callable[..., Factory], campaign: Spectra
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
