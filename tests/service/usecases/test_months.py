from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from lbacal_core.curves.validity import Promotion, Scope
from lbacal_core.spectra.spectra import Spectra
from service.factory import Factory
from service.storage.database import Stores
from service.storage.drift import MonthlyRatio
from service.storage.versions import Version
from service.usecases.drift import (
    end_of_year,
    keep_missing,
    keep_months,
    read_matrix,
    read_months,
    start_of_year,
    summarise,
)

MONTH_US = 31 * 86_400_000_000
STATIONS, YEARS = ("CS001", "CS002"), (2014, 2015)


def _measure(stores: Stores, reference: str, station: str, year: int, seed: int) -> None:
    """Measure a year of a station, as a part of a drift does."""
    since, rng = start_of_year(year), np.random.default_rng(seed)
    ratios = [
        MonthlyRatio(Scope(station, a, d), since + m * MONTH_US, reference, float(rng.normal(1, 0.1)), 0.01, 9 + a)
        for a in range(3)
        for d in "XY"
        for m in range(11)
    ]
    stores.drift.replace(station, since, end_of_year(since), ratios)
    keep_months(stores, station, since, ratios)


@pytest.fixture
def measured(factory: Factory, stored: dict[str, Version]) -> Factory:
    """Two years of two stations, measured, the array not kept yet."""
    rng = np.random.default_rng(1)
    rows = [(s, a, d) for s in STATIONS for a in range(3) for d in "XY"]
    station, antenna, dipole = (np.array(column) for column in zip(*rows, strict=True))
    count = len(rows)
    spectra = Spectra(
        frequency_mhz=factory.instrument.frequency_mhz, power=rng.lognormal(0, 0.1, (count, 4)),
        event_id=np.full(count, "one"), time_unix=np.full(count, start_of_year(2014) / 1e6 + 1), station=station,
        antenna=antenna, dipole=dipole, blocks=np.full(count, 100),
    )  # fmt: skip
    with factory.database.write() as stores:
        stores.spectra.add(spectra)
        for k, (name, year) in enumerate((s, y) for s in STATIONS for y in YEARS):
            _measure(stores, stored["path"].id, name, year, k)
    return factory


def _months_of_all(factory: Factory) -> dict[Scope, Any]:
    scopes = [Scope(), *map(Scope, STATIONS)]
    with factory.database.read() as stores:
        return dict(read_months(stores, scopes))


def test_what_is_kept_is_what_all_months_say(measured: Factory) -> None:
    with measured.database.write() as stores:
        assert keep_missing(stores) == len(YEARS)
        assert keep_missing(stores) == 0
    for scope, months in _months_of_all(measured).items():
        with measured.database.read() as stores:
            expected = summarise(stores.drift.ratios(scope))
        assert len(months) == 22
        assert [m.c_ratio for m in months] == pytest.approx([m.c_ratio for m in expected], abs=1e-6)
        assert [(m.month, m.paths, m.events, m.shape) for m in months] == [
            (m.month, m.paths, m.events, m.shape) for m in expected
        ]


def test_the_array_is_never_told_from_months_that_a_station_had_before(measured: Factory) -> None:
    """What is kept of all stations is tied to the months of each: one measured anew makes it void at once."""
    with measured.database.write() as stores:
        keep_missing(stores)
    before = _months_of_all(measured)[Scope()]
    with measured.database.write() as stores:
        reference = stores.drift.ratios(Scope("CS001", 0, "X"))[0].reference
        _measure(stores, reference, "CS001", 2015, 99)
    after = _months_of_all(measured)[Scope()]
    assert after[:11] == before[:11]
    assert all(now.c_ratio != was.c_ratio for now, was in zip(after[11:], before[11:], strict=True))
    with measured.database.write() as stores:
        assert keep_missing(stores) == 1
    kept = _months_of_all(measured)[Scope()]
    assert [m.c_ratio for m in kept] == pytest.approx([m.c_ratio for m in after], abs=1e-6)


def test_a_year_of_the_matrix_holds_every_path_beside_the_median(measured: Factory) -> None:
    with measured.database.read() as stores:
        first, second = (json.loads(year) for year in read_matrix(stores, "CS001"))
    assert first["paths"] == [[a, d] for a in range(3) for d in "XY"]
    assert (first["months"][0], second["months"][0], np.shape(second["values"])) == ("2014-01", "2015-01", (6, 11))
    assert np.median(first["values"], axis=0) == pytest.approx(np.zeros(11), abs=1e-6)


def test_a_click_on_a_month_leads_to_the_version_of_the_path_in_effect_then(
    measured: Factory, client: TestClient, new_version: Callable[..., Version]
) -> None:
    path, year = Scope("CS002", 1, "Y"), (start_of_year(2014), start_of_year(2015))
    version = new_version(path, "mine")
    with measured.database.write() as stores:
        stores.versions.add([version])
        stores.ledger.append([Promotion(0, path, *year, version.id, 0, "test", "test")], measured.clock)
    found = client.get("/stations/CS002/1/Y/2014-05", follow_redirects=False)
    assert (found.status_code, found.headers["location"]) == (303, f"/calibrations/{version.id}")
    assert client.get("/stations/CS002/1/Y/2016-05").status_code == 404
    assert client.get("/stations/CS002/1/Y/May").status_code == 422
    assert client.get("/stations/CS002/77/Y/2014-05").status_code in (404, 422)
