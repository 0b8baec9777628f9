from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.uncertainty.one_event import ErrorOfC, measure_error, measure_event_gains
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings

INSTRUMENT = load_instrument("lofar-superterp")
SKY = compute_sky_power(INSTRUMENT)


@pytest.mark.parametrize("scope", ["antenna", "station", "array"])
@pytest.mark.parametrize(("common", "own"), [(0.03, 0.04), (0.0, 0.01)])
def test_the_gain_of_events_is_the_planted_one(scope: str, common: float, own: float) -> None:
    settings = TwinSettings(
        stations=("CS002",), antennas=6, events_per_year=600, event_gain_common=common, event_gain_path=own
    )
    spectra = simulate_campaign(settings, INSTRUMENT, SKY, np.random.default_rng(2)).spectra
    curves = fit_calibration(spectra, INSTRUMENT, SKY, scope).curves
    gains = np.array(list(measure_event_gains(curves, spectra, INSTRUMENT, SKY).values()))
    assert gains.size == 12
    # 600 events know a spread to 3 %, and twelve paths share the common part. A path whose cable differs from the
    # mean's has another share of the sky, so that its ratio to the mean's prediction varies with LST by a per cent
    beside = 0.0 if scope == "antenna" else 0.01
    planted = np.hypot(common, own)
    assert 0.88 * planted < np.median(gains) < 1.12 * np.hypot(planted, beside)


def test_one_event_on_one_antenna_is_worse_known_than_the_mean() -> None:
    settings = TwinSettings(stations=("CS002",), antennas=8, events_per_year=500)
    spectra = simulate_campaign(settings, INSTRUMENT, SKY, np.random.default_rng(4)).spectra
    own = measure_error(fit_calibration(spectra, INSTRUMENT, SKY, "antenna"), spectra, INSTRUMENT, SKY)
    mean = measure_error(fit_calibration(spectra, INSTRUMENT, SKY, "station"), spectra, INSTRUMENT, SKY)
    assert own is not None
    assert mean is not None
    assert own.antenna == 0.0
    assert 0.005 < mean.antenna < 0.05
    assert mean.statistical < own.statistical
    for error in (own, mean):
        # 5 % of power is 2.5 % of C
        assert error.event == pytest.approx(0.025, rel=0.12)
        assert error.of_one_event == pytest.approx(
            np.sqrt(error.statistical**2 + error.systematic**2 + error.antenna**2 + error.event**2)
        )
        assert error.of_one_event > error.of_mean


def test_without_a_curve_there_is_no_error() -> None:
    settings = TwinSettings(stations=("CS002",), antennas=2, events_per_year=30)
    spectra = simulate_campaign(settings, INSTRUMENT, SKY, np.random.default_rng(4)).spectra
    report = fit_calibration(spectra, INSTRUMENT, SKY, "antenna")
    assert measure_error(report, spectra, INSTRUMENT, SKY) is None


def test_what_is_not_known_is_not_taken_for_zero() -> None:
    assert np.isnan(ErrorOfC(0.01, 0.1, 0.0, np.nan).of_one_event)
    assert np.isnan(ErrorOfC(0.01, 0.1, np.nan, 0.02).of_one_event)
    assert ErrorOfC(0.03, 0.04, 0.0, np.nan).of_mean == pytest.approx(0.05)
