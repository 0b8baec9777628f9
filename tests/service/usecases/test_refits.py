from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.spectra import Spectra
from service.factory import Factory
from service.wire.bodies import RefitBody
from service.worker import Worker

YEAR = {"since": "2014-01-01", "until": "2015-01-01"}


@pytest.fixture
def bare(station: Factory) -> Factory:
    """The service of the campaign, without its spectra."""
    with station.database.write() as stores:
        connection = stores.spectra._connection
        connection.exec_driver_sql("DELETE FROM spectrum")
    return station


def refit(factory: Factory, scope: str, *, promote: bool = True) -> Any:
    body = RefitBody.model_validate({"scope": scope, **YEAR, "reason": "test", "promote": promote})
    number = factory.refits.request(body, "test")
    Worker(factory, "worker").run(threading.Event(), until_idle=True)
    return factory.jobs.get(number)


def spoil(campaign: Spectra, row: int, factor: float) -> Spectra:
    power = campaign.power.copy()
    power[row] = np.minimum(power[row] * factor, 1e308)
    return replace(campaign, power=power)


@pytest.mark.parametrize("factor", [1000.0, 3.0, 1e308])
def test_one_bad_spectrum_stopped_array_station_and_path_for_the_year(
    bare: Factory, campaign: Spectra, factor: float
) -> None:
    row = int(np.flatnonzero((campaign.antenna == 2) & (campaign.dipole == "X"))[77])
    with bare.database.write() as stores:
        stores.spectra.add(spoil(campaign, row, factor))
    window = campaign.time_unix < np.datetime64("2015-01-01", "s").astype(float)
    for scope, count in (("array", 1), ("station", 1), ("antenna", 8)):
        job = refit(bare, scope)
        result = job.results[0]
        assert (len(result["promoted"]), result["gated"]) == (count, {}), scope
        clean = {c.name: c for c in fit_calibration(
            campaign.select(window), bare.instrument, bare.sky_power, scope).curves}  # fmt: skip
        for name in result["calibrations"]:
            version = bare.calibrations.get(name)
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
    with bare.database.write() as stores:
        stores.spectra.add(replace(campaign, power=power))
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
    with bare.database.write() as stores:
        stores.spectra.add(spoil(campaign, row, 50.0))
    version = bare.calibrations.get(refit(bare, "station").results[0]["calibrations"][0])
    assert (version.anomalies.left_out, version.anomalies.worst[0].event_id) == (1, name)
    with bare.database.read() as stores:
        stored = stores.spectra.event(name)
    assert (stored.spectra, stored.flag) == (8, None)
