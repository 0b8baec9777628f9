"""Drift of a station's year after one more event: what came since is read, and the answer is that of the whole year."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from lbacal.instants import parse_instant
from lbacal_core.curves.curves import Parameter
from lbacal_core.curves.reference_chain import CableTable, ReferenceChain
from lbacal_core.curves.validity import Scope
from lbacal_core.spectra.spectra import Spectra
from service.app import make_app
from service.factory import Factory
from service.storage.database import Stores
from service.storage.drift import PathMonths
from service.storage.jobs import Order
from service.storage.sums import Sums
from service.storage.versions import MeanC, Version
from service.usecases.drift import VersionPoint, explain_version, keep_months, read_months, start_of_year, summarise
from service.usecases.drift_measurement import KIND
from tests.service.conftest import add_spectra, flat_spectra, new_version, night, work

YEAR = {"station": "CS002", "since": parse_instant("", "2015-01-01"), "until": parse_instant("", "2016-01-01")}


def measured(factory: Factory) -> tuple[str, list[str], Sums]:
    """Months and events of the year, and the block that they are kept in."""
    with factory.database.read() as stores:
        block = stores.sums.get(KIND, Scope("CS002"), YEAR["since"], YEAR["until"])
        assert block is not None
        (months,) = stores.drift.months_of_paths("CS002", YEAR["since"])
        return months.digest, stores.sums.digests(KIND), block


def measure_again(factory: Factory, block: Sums) -> None:
    """Measure the year as if it had been measured from something else."""
    with factory.database.write() as stores:
        stores.sums.put(block)
        stores.jobs.add(Order(KIND, YEAR, [YEAR], "test", "test", inputs=factory.inputs.text), factory.clock())
    work(factory)


@pytest.mark.long
def test_after_one_more_event_drift_reads_it_alone_and_is_that_of_the_whole_year(
    after_night: Factory, campaign: Spectra
) -> None:
    _, before, first = measured(after_night)
    assert first.whole == first.spectra
    typical = campaign.event_id[campaign.time_unix > YEAR["since"] / 1e6][5]
    one = campaign.select(campaign.event_id == typical)
    later = replace(one, event_id=np.full(len(one), "999999999"), time_unix=one.time_unix + 3600.0)
    add_spectra(after_night, later)
    night(after_night)
    added, digests, source = measured(after_night)
    assert (source.spectra, source.whole) == (first.spectra + len(later), first.whole)
    assert len(set(digests) & set(before)) == 1, "the events of the year of the new one are others"

    measure_again(after_night, replace(source, inputs="another reference"))
    whole, of_whole, read = measured(after_night)
    assert (read.inputs, read.whole) == (source.inputs, source.spectra)
    assert of_whole == digests
    assert whole == added

    measure_again(after_night, replace(read, flag=read.flag + 1))
    assert measured(after_night)[:2] == (whole, of_whole)
    assert measured(after_night)[2].flag == read.flag


@pytest.mark.long
@pytest.mark.usefixtures("after_night")
def test_the_planted_step_is_first_with_its_antenna_and_date(http: TestClient) -> None:
    drift = http.get("/v1/drift", params={"station": "CS002"}).json()
    (first,) = drift["steps"]
    assert (first["antenna"], first["dipole"]) == (2, "Y")
    # months were the grid of dates once, and this one was 14 days off
    assert abs(np.datetime64(first["date"]) - np.datetime64("2015-04-11")) <= np.timedelta64(3, "D")
    assert first["date_sigma_days"] < 3.0
    assert first["earliest"] <= "2015-04-11" <= first["latest"]
    # the power gain rises by 15 %: C falls by 1 - 1.15^-1/2 = 6.7 %
    assert abs(first["size"] + (1 - 1.15**-0.5)) < 4 * first["sigma"]
    assert first["significance"] > 3 * drift["threshold_sigma"]
    assert http.get(f"/v1/calibrations/{first['calibration']}").json()["since"].startswith("2015")
    assert len(drift["months"]) == 24
    assert {m["paths"] for m in drift["months"]} == {8}
    path = http.get("/v1/drift", params={"station": "CS002", "antenna": 2, "dipole": "Y"}).json()
    assert len(path["versions"]) == 2
    change = path["versions"][1]["c"] / path["versions"][0]["c"] - 1
    assert -0.08 < change < -0.03
    whole = http.get("/v1/drift").json()
    assert (whole["scope"], len(whole["months"]), len(whole["steps"])) == ("array", 24, 1)


MONTH_US = 31 * 86_400_000_000
STATIONS, YEARS = ("CS001", "CS002"), (2014, 2015)


def _measure(stores: Stores, station: str, year: int, seed: int) -> None:
    """Measure a year of a station, as a part of a drift does."""
    since, rng = start_of_year(year), np.random.default_rng(seed)
    paths = [Scope(station, a, d) for a in range(3) for d in "XY"]
    ratios = np.full((6, 11, 5), (1.0, 0.01, 0.002, -0.001, 9.0))
    ratios[..., 0] = rng.normal(1, 0.1, (6, 11))
    ratios[..., 4] += np.arange(6)[:, None] // 2
    keep_months(stores, station, since, PathMonths(paths, since + MONTH_US * np.arange(11), ratios))


@pytest.fixture
def measured_of_months(factory: Factory) -> Factory:
    """Two years of two stations, measured."""
    at = start_of_year(2014) / 1e6 + 1
    add_spectra(factory, flat_spectra(*[("one", at, s, a, d) for s in STATIONS for a in range(3) for d in "XY"]))
    with factory.database.write() as stores:
        for k, (name, year) in enumerate((s, y) for s in STATIONS for y in YEARS):
            _measure(stores, name, year, k)
    return factory


def _months_of_all(factory: Factory) -> dict[Scope, Any]:
    scopes = [Scope(), *map(Scope, STATIONS)]
    with factory.database.read() as stores:
        return dict(read_months(stores, scopes))


def test_what_is_kept_is_what_all_months_say(measured_of_months: Factory) -> None:
    for scope, months in _months_of_all(measured_of_months).items():
        with measured_of_months.database.read() as stores:
            expected = summarise(stores.drift.months_of_paths(scope.station))
        assert len(months) == 22
        assert [m.c_ratio for m in months] == pytest.approx([m.c_ratio for m in expected], abs=1e-6)
        assert [(m.month, m.paths, m.events, m.shape) for m in months] == [
            (m.month, m.paths, m.events, m.shape) for m in expected
        ]


def test_a_month_of_one_path_lies_between_its_value_less_and_more_one_standard_deviation(
    measured_of_months: Factory,
) -> None:
    path = Scope("CS001", 1, "Y")
    with measured_of_months.database.read() as stores:
        years = stores.drift.months_of_paths("CS001")
        months = read_months(stores, [path])[path]
    ratio, sigma = np.concatenate([year.ratios[year.paths.index(path), :, :2] for year in years]).T
    ends = np.array([(one.low, one.c_ratio, one.high) for one in months])
    assert ends == pytest.approx(np.stack([ratio - sigma, ratio, ratio + sigma], axis=1))
    assert {(one.paths, one.events, one.shape) for one in months} == {(1, 10, (0.002, -0.001))}


def test_the_array_is_never_told_from_months_that_a_station_had_before(measured_of_months: Factory) -> None:
    """What is kept of all stations follows from the months of each: one measured anew changes it at once."""
    before = _months_of_all(measured_of_months)[Scope()]
    with measured_of_months.database.write() as stores:
        _measure(stores, "CS001", 2015, 99)
    after = _months_of_all(measured_of_months)[Scope()]
    assert after[:11] == before[:11]
    assert all(now != was for now, was in zip(after[11:], before[11:], strict=True))
    with measured_of_months.database.read() as stores:
        expected = summarise(stores.drift.months_of_paths(None))
    assert [m.c_ratio for m in after] == pytest.approx([m.c_ratio for m in expected], abs=1e-6)


def test_a_year_of_the_matrix_holds_every_path_beside_the_median(measured_of_months: Factory) -> None:
    kept = measured_of_months.database.look(lambda stores: stores.drift.years(["CS001"]))
    first, second = (json.loads(str(one.matrix)) for one in kept)
    assert first["paths"] == [[a, d] for a in range(3) for d in "XY"]
    assert (first["months"][0], second["months"][0], np.shape(second["values"])) == ("2014-01", "2015-01", (6, 11))
    assert np.median(first["values"], axis=0) == pytest.approx(np.zeros(11), abs=1e-6)


def _made(name: str, antennas: range, n_lna: float) -> Version:
    version = new_version(Scope("CS001"), name)
    chain = ReferenceChain(tuple(("CS001", a) for a in antennas), np.ones(4), CableTable({}, ()), None)
    curves = tuple(replace(one, parameters={"n_lna": Parameter(n_lna, 0.03 * n_lna)}) for one in version.curves)
    return replace(version, chains={"X": chain, "Y": chain}, curves=curves)


def test_other_antennas_and_noise_constants_are_told() -> None:
    """A version stood 2 to 4 % beside a flat monthly line, and nothing said why."""
    first = _made("first", range(4), 1.0)
    assert explain_version(first, first, "X") == "the first"
    same = _made("same", range(4), 1.05)
    assert explain_version(same, first, "X") == "the same antennas, noise constants within their errors"
    other = _made("other", range(1, 6), 1.3)
    assert explain_version(other, first, "X") == "other antennas (1 left out, 2 more), N_LNA +30% ± 4%"


def test_the_cables_of_other_antennas_are_told_with_what_they_do() -> None:
    """A version that had one antenna more stood 8 % beside its line, and only the number of antennas was told."""
    first = _made("first", range(4), 1.0)
    other = _made("other", range(5), 1.0)
    longer = {d: replace(chain, mean_loss=np.full(4, 0.81)) for d, chain in other.chains.items()}
    curves = tuple(replace(one, c=one.c / 0.9) for one in other.curves if one.c is not None)
    versions = first, replace(other, chains=longer, curves=curves)
    means = [MeanC(one.id, one.scope, "X", k, k + 1, 1, 1.0, 0.1) for k, one in enumerate(versions)]
    _, told = VersionPoint.of(means, {one.id: one for one in versions})
    assert told.why == "other antennas (0 left out, 1 more), whose cables change C by +11.1 %"
    assert told.change == pytest.approx(0.0, abs=1e-12), "which is taken out of what is told and plotted"


@pytest.mark.long
def test_the_page_of_the_drift_says_why_a_version_differs(after_night: Factory) -> None:
    with TestClient(make_app(after_night)) as client:
        page = client.get("/drift").text
    assert "what else is another" in page
    assert ' class="wrap">the first</td>' in page
