"""The sky over its model, where the receiver is calibrated in kelvin."""

from __future__ import annotations

import json

import numpy as np
import pytest

from lbacal_core.antenna.ideal import ShortDipole
from lbacal_core.antenna.model import zenith_gain
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.curves.curves import parse_curve
from lbacal_core.curves.kelvin import SkyOverModel, parse_sky_over_model
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import parse_instrument
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.table import SkyPower
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings

NU = np.arange(50.0, 90.0, 2.0)


def make_content():
    return {
        "name": "in kelvin", "latitude_deg": -26.7, "longitude_deg": 116.6, "height_m": 300,
        "frequency_mhz": NU.tolist(), "dipoles": {"A": {"azimuth_deg": 85}}, "antenna": "short-dipole",
        "antenna_gain": zenith_gain(ShortDipole(1.5), NU).tolist(),
        "antenna_gain_provenance": {"kind": "absolute", "source": "analytic"}, "calibrated_in_kelvin": {"error": 0.01},
        "receiver_gain": [1.0] * NU.size, "cables": {"none": [1.0] * NU.size},
        "antennas": [{"station": "S1", "antenna": number, "cable": "none"} for number in range(4)],
    }  # fmt: skip


def test_a_sky_that_is_brighter_than_the_model_is_measured_and_c_is_known():
    instrument = parse_instrument(make_content(), "in kelvin")
    sky = compute_sky_power(instrument)
    brighter = SkyPower(NU, sky.lst_hours, {"A": 1.1 * sky.power["A"]}, "brighter")
    campaign = simulate_campaign(TwinSettings(events_per_year=300), instrument, brighter, np.random.default_rng(8))
    kelvin = campaign.spectra.power
    assert 300 < np.median(kelvin[:, 0]) < 50_000, "temperatures, at 50 MHz"
    report = fit_calibration(campaign.spectra, instrument, sky)
    levels = [curve.sky_over_model for curve in report.curves]
    pulls = [(one.mean / 1.1 - 1.0) / np.hypot(one.mean_sigma_stat / one.mean, one.sigma_laboratory) for one in levels]
    assert np.sqrt(np.mean(np.square(pulls))) < 2.0
    assert all(one.mean_sigma_stat < 0.03 for one in levels)
    truth = [campaign.truth.curve("A", "S1", number) for number in range(4)]
    assert all(abs(one.c / c - 1.0).max() < 4 * one.c_sigma / one.c for one, c in zip(levels, truth, strict=True))
    content = json.loads(json.dumps(report.curves[0].as_dict(), allow_nan=False))
    assert parse_curve(content).as_dict() == report.curves[0].as_dict()
    assert "of the model" in str(levels[0])


def test_the_error_of_the_mean_takes_correlations_along_frequency_whole():
    alone = SkyOverModel.of(np.full(4, 3.7157e-9), 1e-4 * np.eye(4), 0.01)
    together = SkyOverModel.of(np.full(4, 3.7157e-9), np.full((4, 4), 1e-4), 0.01)
    assert together.mean == pytest.approx(1.0, rel=1e-4)
    assert together.mean_sigma_stat == pytest.approx(0.02, rel=1e-3)
    assert alone.mean_sigma_stat == pytest.approx(0.01, rel=1e-3)


def test_a_channel_without_c_counts_for_nothing_and_is_null():
    level = SkyOverModel.of(np.array([np.nan, 3.7157e-9]), 1e-4 * np.eye(2), 0.01)
    content = json.loads(json.dumps(level.as_dict(), allow_nan=False))
    assert content["ratio"][0] is None
    assert level.mean == pytest.approx(1.0, rel=1e-4)
    assert parse_sky_over_model(content).as_dict() == content
    assert parse_sky_over_model(None) is None


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("calibrated_in_kelvin", {"error": 0}, "a fraction of the power, 0 to 1, found 0.0"),
        ("calibrated_in_kelvin", True, "an object with error, found bool"),
        ("antenna_gain_provenance", None, "to refer kelvin to the sky, found kelvin beside one that is not said to be"),
    ],
)
def test_kelvin_need_an_error_and_square_metres(field, value, message):
    with pytest.raises(BadInputError, match=message):
        parse_instrument(make_content() | {field: value}, "in kelvin")
