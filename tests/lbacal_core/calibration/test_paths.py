from __future__ import annotations

import weakref
from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.calibration.budget import compute_budget
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.calibration.paths import paths_of_scope, require_one_cable_each
from lbacal_core.calibration.singles import MIN_EVENTS, fit_singles, relative_variance_of
from lbacal_core.causes.model import AdoptedCause, Model
from lbacal_core.discovery.calibrate import fit_causes
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.provenance import as_json
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.table import SkyPower
from lbacal_core.spectra.blocks import SpectraByStation, split_into_blocks
from lbacal_core.spectra.screening import leave_out
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def spectra(chain: Instrument, sky: SkyPower) -> Spectra:
    """A year of four stations, each without some events of its own and with other blocks."""
    stations = tuple(sorted({one.station for one in chain.antennas}))[:4]
    settings = TwinSettings(stations=stations, antennas=2, events_per_year=100)
    rng = np.random.default_rng(3)
    made = simulate_campaign(settings, chain, sky, rng).spectra
    events, stations_at = np.unique(made.event_id), np.searchsorted(stations, made.station)
    is_away = rng.random((len(stations), events.size)) < 0.1
    made = replace(made, blocks=made.blocks + stations_at)
    return made.select(~is_away[stations_at, np.searchsorted(events, made.event_id)])


def by_station(spectra: Spectra) -> SpectraByStation:
    stations = np.unique(spectra.station).tolist()
    return SpectraByStation.of(stations, lambda name: spectra.select(spectra.station == name))


def mean_at_once(spectra: Spectra, simulation: Simulation, dipole: str) -> tuple[Floats, Floats]:
    """Power and relative variance of the mean of the array, event by event, every path of every station at hand."""
    typical = float(np.median(spectra.blocks))
    found: dict[str, list[tuple[Floats, Floats, float, float]]] = {}
    lines = []
    for block in (one for one in split_into_blocks(spectra) if one.dipole == dipole):
        fitted = fit_singles(block, simulation, typical)
        screened, sky = leave_out(block, fitted.is_left_out), simulation.sky_at(block.station, dipole, block.time_unix)
        variance = relative_variance_of(screened, typical)
        for k in np.flatnonzero((screened.is_present.sum(axis=1) >= MIN_EVENTS) & fitted.is_steady):
            slope, intercept = fitted.lines.slope[k], fitted.lines.intercept[k]
            lines.append((slope, intercept))
            level = float((slope * sky.mean(axis=0) + intercept).mean())
            for e in np.flatnonzero(screened.is_present[k]):
                row = screened.power[k, e], slope * sky[e] + intercept, level, float(variance[k, e])
                found.setdefault(str(block.event_id[e]), []).append(row)
    slope, intercept = np.mean(lines, axis=0)
    of_event = {str(name): float(time) for name, time in zip(spectra.event_id, spectra.time_unix, strict=True)}
    power, scatter = [], []
    for name in sorted(found):
        recorded, expected, level, variance = (np.array(column) for column in zip(*found[name], strict=True))
        there = simulation.sky_at(None, dipole, np.array([of_event[name]]))[0]
        deviation = (recorded - expected).sum(axis=0) / expected.sum(axis=0)
        power.append((slope * there + intercept) * (1.0 + deviation))
        scatter.append(np.sum(level**2 * variance) / level.sum() ** 2)
    return np.array(power), np.array(scatter) / np.median(scatter)


def test_the_mean_of_an_array_is_that_of_all_its_spectra_at_once(
    spectra: Spectra, chain: Instrument, sky: SkyPower
) -> None:
    simulation = Simulation(chain, sky)
    for read in paths_of_scope(by_station(spectra), simulation, "array", require_one_cable_each(spectra, chain)):
        paths = read()
        power, scatter = mean_at_once(spectra, simulation, paths.owners[0][2])
        np.testing.assert_allclose(paths.power[0], power, rtol=1e-12)
        np.testing.assert_allclose(paths.relative_variance[0], scatter, rtol=1e-12)


def with_new_cable(chain: Instrument, station: str, antenna: int, at: float) -> Instrument:
    """The instrument with another cable of an antenna since an instant."""
    records: list[AntennaRecord] = []
    for one in chain.antennas:
        if (one.station, one.antenna) != (station, antenna):
            records.append(one)
            continue
        other = next(cable for cable in chain.cables if cable != one.cable)
        records += [replace(one, until=at), replace(one, cable=other, since=at)]
    return replace(chain, antennas=tuple(records))


@pytest.mark.parametrize("kind", ["plain", "a new cable", "a cause", "less power"])
def test_an_array_is_fitted_alike_however_its_spectra_are_read(
    kind: str, spectra: Spectra, chain: Instrument, sky: SkyPower
) -> None:
    """Its year was read into one process: 1 kB a spectrum, 4 GB of fifty stations."""
    station = str(np.unique(spectra.station)[1])
    late = Model((AdoptedCause("lst_offset", station, "station", 0.1, 0.02),))
    instrument = with_new_cable(chain, station, 1, 1.4e9) if kind == "a new cable" else chain

    def lower(own: Spectra) -> Floats:
        return own.power * np.where((own.station == station) & (own.antenna == 1), 0.9, 1.0)[:, None]

    def is_fitted(own: Spectra) -> np.ndarray:
        return (own.station != station) | (own.antenna != 1) | (kind != "a new cable")

    told = []
    for one in (spectra, by_station(spectra)):
        simulation = Simulation(instrument, sky, causes=late if kind == "a cause" else Model())
        whole = fit_causes(one, simulation)
        whole = replace(whole, unchanged=lower) if kind == "less power" else whole
        fitted = whole.keep(is_fitted)
        budget = compute_budget(fitted.spectra, fitted.simulation)
        report = fitted.fit("array")
        told.append(
            [one.digest(), fitted.spectra.digest(), as_json(report.curves), as_json(report.chains), budget.digest]
        )
        told[-1].append([report.provenance.as_dict(), as_json(report.anomalies)])
    assert told[0] == told[1]


def test_the_mean_of_an_array_holds_the_spectra_of_one_station_at_a_time(
    spectra: Spectra, chain: Instrument, sky: SkyPower
) -> None:
    made: list[weakref.ref[Spectra]] = []
    most = [0]

    def read(name: str) -> Spectra:
        own = spectra.select(spectra.station == name)
        made.append(weakref.ref(own))
        most[0] = max(most[0], sum(one() is not None for one in made))
        return own

    stations = np.unique(spectra.station).tolist()
    whole = fit_causes(SpectraByStation.of(stations, read), Simulation(chain, sky))
    compute_budget(whole.spectra, whole.simulation)
    assert [curve.status for curve in whole.fit("array").curves] == ["converged"] * 2
    assert len(made) == 2 * len(stations), "once for what they are, once for their sums"
    assert most[0] <= 2, "the one before and the next"


def test_spectra_that_are_read_station_by_station_have_no_other_mean(
    spectra: Spectra, chain: Instrument, sky: SkyPower
) -> None:
    cables = require_one_cable_each(spectra, chain)
    with pytest.raises(BadInputError, match="scope: expected array"):
        next(paths_of_scope(by_station(spectra), Simulation(chain, sky), "station", cables))


@pytest.mark.parametrize("level", [0.01, 1.0])
def test_a_path_that_hears_no_sky_is_no_part_of_the_mean_of_its_station(
    chain: Instrument, sky: SkyPower, level: float
) -> None:
    """One dead antenna of four put C of the station 15 % off, with an error of 1 %."""
    made = simulate_campaign(
        TwinSettings(stations=("CS002",), antennas=4, events_per_year=120), chain, sky, np.random.default_rng(3)
    ).spectra
    is_dead, rng = (made.antenna == made.antenna.max()) & (made.dipole == "X"), np.random.default_rng(1)
    power = made.power.copy()
    power[is_dead] = level * np.median(made.power[is_dead], axis=0) * rng.normal(1.0, 0.04, power[is_dead].shape)
    simulation = Simulation(chain, sky)
    with_it, without = (
        fit_calibration(one, simulation, scope="station").curves[0]
        for one in (replace(made, power=power), made.select(~is_dead))
    )
    assert with_it.dipole == without.dipole == "X"
    np.testing.assert_allclose(with_it.c, without.c, rtol=1e-3)
