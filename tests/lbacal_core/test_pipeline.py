"""Instruments that are not LOFAR, through the whole path: simulated by the twin, fitted, investigated."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.discovery.report import investigate
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.pipeline import calibrate
from lbacal_core.skypower.model import compute_sky_power
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.antenna import GainStep
from lbacal_twin.faults.fault import Where
from lbacal_twin.settings import TwinSettings
from tests import short_dipole
from validation.anywhere import draw_instrument

SETTINGS = TwinSettings(events_per_year=300)
TABLES = ("gain", "noise_k")


def make_instrument(arms, frequency_mhz, latitude_deg, *, antennas, tilts=None, receiver_gain=None) -> Instrument:
    flat = np.ones(frequency_mhz.size)
    return Instrument(
        name="somewhere",
        latitude_deg=latitude_deg,
        longitude_deg=21.4,
        height_m=1000.0,
        frequency_mhz=frequency_mhz,
        dipole_azimuth_deg=arms,
        antenna_gain=flat,
        receiver_gain=flat if receiver_gain is None else receiver_gain,
        cables={"long": 0.5 * flat},
        antennas=tuple(AntennaRecord("S1", number, "long") for number in range(antennas)),
        antenna="short-dipole",
        dipole_tilt_deg=tilts or {},
    )


ONE_ARM = make_instrument({"A": -6.0}, np.arange(50.0, 90.0), -26.7, antennas=1)
THREE_ARMS = make_instrument(
    {"EW": 90.0, "NS": 0.0, "UP": 0.0}, np.arange(50.0, 84.0, 1.0), 40.9, antennas=4, tilts={"UP": 90.0}
)


def pulls_of(report, truth):
    return np.array(
        [
            (curve.c - truth.curve(curve.dipole, curve.station, curve.antenna)) / curve.c_sigma_stat
            for curve in report.curves
        ]
    )


def test_one_arm_in_the_south_is_calibrated_and_found_consistent():
    """EDGES and MIST have one dipole: an instrument had to have X and Y."""
    sky = compute_sky_power(ONE_ARM)
    campaign = simulate_campaign(SETTINGS, ONE_ARM, sky, np.random.default_rng(1))
    report = calibrate(campaign.spectra, ONE_ARM)
    assert [(curve.dipole, curve.status) for curve in report.curves] == [("A", "converged")]
    # one curve, whose channels move together
    assert np.sqrt(np.nanmean(pulls_of(report, campaign.truth) ** 2)) < 3.0
    found, _ = investigate(campaign.spectra, ONE_ARM, sky)
    assert found["verdict"] == "consistent"
    why = {one["cause"]: one["why"] for one in found["unidentifiable"]}
    assert why["dipole_swap"] == "the instrument has one dipole"
    json.dumps(found, allow_nan=False)


@pytest.mark.long
def test_three_arms_one_upright_are_calibrated_and_a_step_of_one_is_named():
    """GRAND has three: two level arms and one upright."""
    sky = compute_sky_power(THREE_ARMS)
    step = GainStep(size=0.1, where=Where(antennas=(2,), dipoles=("UP",)), date="2014-08-07")
    clean = simulate_campaign(SETTINGS, THREE_ARMS, sky, np.random.default_rng(2))
    report = calibrate(clean.spectra, THREE_ARMS)
    assert [curve.dipole for curve in report.curves[:3]] == ["EW", "NS", "UP"]
    assert {curve.status for curve in report.curves} == {"converged"}
    # 12 curves of one station, which share its gain of events
    assert np.sqrt(np.nanmean(pulls_of(report, clean.truth) ** 2)) < 1.8
    spoiled = simulate_campaign(SETTINGS, THREE_ARMS, sky, np.random.default_rng(2), [step])
    found, _ = investigate(spoiled.spectra, THREE_ARMS, sky)
    assert [one["cause"] for one in found["findings"]] == ["gain_step"]
    assert found["findings"][0]["where"]["dipoles"] == ["UP"]
    assert found["findings"][0]["where"]["antennas"] == [2]
    json.dumps(found, allow_nan=False)


def test_a_letter_that_the_instrument_does_not_have_is_named():
    sky = compute_sky_power(ONE_ARM)
    spectra = simulate_campaign(SETTINGS, ONE_ARM, sky, np.random.default_rng(1)).spectra
    other = replace(spectra, dipole=np.full(len(spectra), "B"))
    with pytest.raises(BadInputError, match=r"row 0: expected a dipole of instrument somewhere \(A\), found 'B'"):
        calibrate(other, ONE_ARM)
    with pytest.raises(BadInputError, match=r"P_sky of each dipole of instrument somewhere .*found no EW, NS, UP"):
        sky.require_made_for(THREE_ARMS)


@pytest.mark.parametrize("seed", [1, 7])
def test_an_instrument_drawn_anywhere_is_investigated_and_found_consistent(seed):
    rng = np.random.default_rng([17, seed])
    drawn = draw_instrument(rng)
    few = np.linspace(0, drawn.frequency_mhz.size - 1, 16).astype(int)  # minutes with 200 channels
    drawn = replace(
        drawn,
        frequency_mhz=drawn.frequency_mhz[few],
        antenna_gain=drawn.antenna_gain[few],
        receiver_gain=drawn.receiver_gain[few],
        cables={name: loss[few] for name, loss in drawn.cables.items()},
        stages=tuple(
            replace(stage, **{name: None if (table := getattr(stage, name)) is None else table[few] for name in TABLES})
            for stage in drawn.stages
        ),
    )
    sky = compute_sky_power(drawn)
    spectra = simulate_campaign(TwinSettings(events_per_year=200), drawn, sky, rng).spectra
    report, _ = investigate(spectra, drawn, sky)
    assert report["verdict"] == "consistent"
    json.dumps(report, allow_nan=False)


def test_daily_means_at_one_sidereal_time_are_not_identifiable_and_no_traceback() -> None:
    """82 days of one dipole ended in `cannot reshape array of size 0`: no table and no report."""
    instrument = short_dipole.make_instrument(79.4, -90.8)
    report = calibrate(short_dipole.daily_means(instrument, np.random.default_rng(1)), instrument)
    (curve,) = report.curves
    assert (curve.status, curve.events, curve.lst_coverage) == ("not_identifiable", 82, 4 / 96)
    assert '"status": "not_identifiable"' in json.dumps(report.as_dict(), allow_nan=False)
