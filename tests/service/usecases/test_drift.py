"""Drift of a station's year after one more event: what came since is read, and the answer is that of the whole year."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from lbacal.instants import parse_instant
from lbacal_core.curves.validity import Scope
from lbacal_core.spectra.spectra import Spectra
from service.factory import Factory
from service.scheduler import look_for_due_work
from service.storage.drift import DriftSource
from service.storage.jobs import Order
from service.usecases.drift_measurement import KIND
from tests.service.test_worker import work

YEAR = {"station": "CS002", "since": parse_instant("", "2015-01-01"), "until": parse_instant("", "2016-01-01")}


def measured(factory: Factory) -> tuple[Any, list[str], DriftSource]:
    """Months and events of the year, and what they were measured from."""
    with factory.database.read() as stores:
        source = stores.drift.source("CS002", YEAR["since"])
        assert source is not None
        return stores.drift.ratios(Scope("CS002"), YEAR["since"]), stores.drift.digests(), source


def measure_again(factory: Factory, source: DriftSource) -> None:
    """Measure the year as if it had been measured from something else."""
    with factory.database.write() as stores:
        stores.drift.keep_source("CS002", YEAR["since"], source)
        stores.jobs.add(Order(KIND, YEAR, [YEAR], "test", "test", inputs=factory.inputs.text), factory.clock())
    work(factory)


@pytest.mark.long
def test_after_one_more_event_drift_reads_it_alone_and_is_that_of_the_whole_year(
    station: Factory, campaign: Spectra
) -> None:
    look_for_due_work(station)
    work(station)
    _, before, first = measured(station)
    assert first.screened == first.spectra
    typical = campaign.event_id[campaign.time_unix > YEAR["since"] / 1e6][5]
    one = campaign.select(campaign.event_id == typical)
    later = replace(one, event_id=np.full(len(one), "999999999"), time_unix=one.time_unix + 3600.0)
    with station.database.write() as stores:
        stores.spectra.add(later)
    look_for_due_work(station)
    work(station)
    added, digests, source = measured(station)
    assert (source.spectra, source.screened) == (first.spectra + len(later), first.screened)
    assert len(set(digests) & set(before)) == 2, "the events of the year of the new one are others"

    measure_again(station, replace(source, inputs="another reference"))
    whole, of_whole, read = measured(station)
    assert read == replace(source, screened=source.spectra)
    assert of_whole == digests
    assert whole == added

    measure_again(station, replace(read, flag=read.flag + 1))
    assert measured(station) == (whole, of_whole, read)


@pytest.mark.long
def test_the_planted_step_is_first_with_its_antenna_and_date(station: Factory, http: TestClient) -> None:
    look_for_due_work(station)
    work(station)
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
