from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.skypower.table import SkyPower
from lbacal_twin.campaign import Campaign, simulate_campaign
from lbacal_twin.nuisances import DEAF_GAIN, NONE, REALISTIC, RESIDUAL_LINE, Nuisances
from lbacal_twin.settings import YEAR_S, TwinSettings

SETTINGS = TwinSettings(events_per_year=400)


def _simulate(instrument: Instrument, sky: SkyPower, nuisances: Nuisances, settings: TwinSettings) -> Campaign:
    return simulate_campaign(settings, instrument, sky, np.random.default_rng(1), nuisances=nuisances)


def test_missing_events_and_dead_antennas_leave_gaps(low_band: Instrument, two_waves: SkyPower) -> None:
    full = _simulate(low_band, two_waves, NONE, SETTINGS).spectra
    assert len(full) == 400 * 24
    holed = _simulate(low_band, two_waves, Nuisances(missing=0.1), SETTINGS).spectra
    assert len(holed) / len(full) == pytest.approx(0.81, abs=0.02)
    dead = _simulate(low_band, two_waves, Nuisances(dead_antennas=2), SETTINGS).spectra
    last = {
        (s, a): dead.time_unix[(dead.station == s) & (dead.antenna == a)].max()
        for s in ("CS002", "CS003")
        for a in range(6)
    }
    assert sum(time < full.time_unix.max() for time in last.values()) == 4


def test_a_thin_part_of_the_sidereal_day_has_fewer_events(low_band: Instrument, two_waves: SkyPower) -> None:
    full, thin = (
        _simulate(low_band, two_waves, Nuisances(thin=depth, thin_lst_hours=3.0), SETTINGS).spectra
        for depth in (0.0, 0.8)
    )
    counts = [
        np.histogram(local_sidereal_time(one.time_unix, low_band.longitude_deg), 24, (0, 24))[0] for one in (full, thin)
    ]
    assert (counts[1] / counts[0]).min() < 0.5
    assert (counts[1] / counts[0]).max() == 1.0


def test_a_noisy_station_scatters_more(low_band: Instrument, two_waves: SkyPower) -> None:
    noisy = Nuisances(noisy_stations=("CS003",), noise_factor=2.0)
    still = replace(SETTINGS, radiometer=0, event_gain_common=0, event_gain_path=0)
    clean = _simulate(low_band, two_waves, NONE, still).spectra
    spectra = _simulate(low_band, two_waves, noisy, SETTINGS).spectra
    scatter = [(spectra.power / clean.power - 1)[spectra.station == name].std() for name in ("CS002", "CS003")]
    assert scatter[1] / scatter[0] == pytest.approx(2.0, rel=0.05)


def test_antennas_that_see_the_same_sky_are_weakly_correlated(low_band: Instrument, two_waves: SkyPower) -> None:
    quiet = replace(SETTINGS, event_gain_common=0, event_gain_path=0, stations=("CS002",))
    clean = _simulate(low_band, two_waves, NONE, replace(quiet, radiometer=0)).spectra
    spectra = _simulate(low_band, two_waves, Nuisances(sky_correlation=0.1), quiet).spectra
    noise = (spectra.power / clean.power - 1).reshape(6, 2, -1)
    correlation = np.corrcoef(noise[:, 0])[np.triu_indices(6, 1)]
    assert correlation.mean() == pytest.approx(0.1, abs=0.01)  # 15 pairs of 20,400 numbers: 0.002
    assert np.corrcoef(noise[0])[0, 1] == pytest.approx(0.0, abs=0.03)
    assert noise.std() == pytest.approx(0.0442, rel=0.02)


def test_departures_are_in_the_truth_and_have_zero_mean(low_band: Instrument, two_waves: SkyPower) -> None:
    same, other = (
        _simulate(low_band, two_waves, Nuisances(departures=size), SETTINGS).truth.stations[0].c for size in (0.0, 0.02)
    )
    departure = other / same - 1
    # Power: 2 % from g behind N_RCU and 2 % from A; half of that in C.
    assert departure.std() == pytest.approx(0.014, rel=0.4)
    assert abs(departure.mean()) < 0.014 / 12**0.5 * 3


def test_a_deaf_antenna_hardly_hears_the_sky_and_the_truth_knows(low_band: Instrument, two_waves: SkyPower) -> None:
    same, deaf = (
        _simulate(low_band, two_waves, Nuisances(deaf_antennas=count), SETTINGS).truth.stations[0].c for count in (0, 1)
    )
    ratio = (deaf / same) ** -2
    assert sorted(ratio[:, :, 25].min(axis=1).round(6)) == [DEAF_GAIN, 1, 1, 1, 1, 1]


def test_events_of_runs_lie_together(low_band: Instrument, two_waves: SkyPower) -> None:
    counts = []
    for part in (0.0, 0.6):
        spectra = _simulate(
            low_band, two_waves, Nuisances(clustered=part), replace(SETTINGS, stations=("CS002",))
        ).spectra
        times = np.unique(spectra.time_unix)
        assert times.size == 400
        counts.append(np.histogram(times, 73, (SETTINGS.start_unix, SETTINGS.start_unix + YEAR_S))[0])
    assert counts[1].std() > 1.5 * counts[0].std()


def test_interference_that_was_left_is_in_single_channels_of_all_paths(
    low_band: Instrument, two_waves: SkyPower
) -> None:
    still = replace(SETTINGS, radiometer=0, event_gain_common=0, event_gain_path=0, stations=("CS002",))
    clean, spoilt = (
        _simulate(low_band, two_waves, Nuisances(interference=lines), still).spectra.power.reshape(12, -1)
        for lines in (0.0, 0.2)
    )
    excess = spoilt / clean - 1
    is_hit = excess > 0
    assert np.mean(is_hit.any(axis=0)) == pytest.approx(0.2 / 51, rel=0.4)  # 80 lines
    assert np.all(is_hit.all(axis=0) == is_hit.any(axis=0))
    assert excess[is_hit].mean() == pytest.approx(RESIDUAL_LINE, rel=0.4)
    assert excess.min() >= 0


def test_a_realistic_campaign_still_calibrates(low_band: Instrument, two_waves: SkyPower) -> None:
    campaign = _simulate(low_band, two_waves, REALISTIC, TwinSettings(stations=("CS002",)))
    report = fit_calibration(campaign.spectra, low_band, two_waves)
    deviations = [
        np.abs(curve.c / campaign.truth.curve(curve.dipole or "", "CS002", curve.antenna) - 1)
        for curve in report.curves
        if curve.c is not None
    ]
    assert len(deviations) >= 8
    assert np.median(deviations) < 0.03


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(BadInputError, match="missing"):
        Nuisances(missing=1.5)
