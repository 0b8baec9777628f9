"""A chain of stages: the twin walks along it, and the fit finds what it planted."""

from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.instrument.instrument import parse_instrument
from lbacal_core.skypower.model import compute_sky_power
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings

NU = np.arange(30.0, 81.0, 2.0)
RESONANCE = 5.0 * np.exp(-(((NU - 58.0) / 16.0) ** 2)) + 0.05
FREE = {"noise_temperature_k": "free"}


def make_instrument(*front, behind=({"name": "amp", "kind": "amplifier", "gain_db": 30, **FREE},)):
    passband = (1.0 / (1.0 + (NU / 70.0) ** 12)).tolist()
    content = {
        "name": "staged", "latitude_deg": 52.9, "longitude_deg": 6.9, "height_m": 10, "frequency_mhz": NU.tolist(),
        "dipoles": {"X": {"azimuth_deg": 45}, "Y": {"azimuth_deg": 135}}, "antenna": "short-dipole",
        "antenna_gain": RESONANCE.tolist(), "antenna_gain_provenance": {"kind": "absolute", "source": "drawn"},
        "stages": [
            *front,
            {"name": "coax", "kind": "cable", "gain_db": -4},
            {"name": "filter", "kind": "filter", "gain": passband, **FREE},
            *behind,
            {"name": "adc", "kind": "adc", **FREE},
        ],
        "antennas": [{"station": "S1", "antenna": number} for number in range(4)],
    }  # fmt: skip
    return parse_instrument(content, "staged")


def fit_staged(instrument, seed):
    sky = compute_sky_power(instrument)
    settings = TwinSettings(events_per_year=300)
    campaign = simulate_campaign(settings, instrument, sky, np.random.default_rng([190, seed]))
    report = fit_calibration(campaign.spectra, instrument, sky)
    assert {curve.status for curve in report.curves} == {"converged"}
    truth = campaign.truth
    pulls = [
        np.median((curve.c - truth.curve(curve.dipole, curve.station, curve.antenna)) / curve.c_sigma_stat)
        for curve in report.curves
    ]
    return report, truth.stations[0].constants, np.array(pulls)


GROUND = {"name": "ground", "kind": "ground", "noise_temperature_k": 290, "solid_angle_sr": 0.1}
FREE_LNA = {"name": "lna", "kind": "lna", "gain_db": 25, **FREE}
KNOWN_LNA = FREE_LNA | {"noise_temperature_k": 150, "noise_temperature_error_k": 15}


@pytest.mark.parametrize("lna", [FREE_LNA, KNOWN_LNA], ids=["free", "known"])
def test_c_and_the_noise_of_stages_come_out_within_their_errors(lna):
    pulls_of_c, pulls = [], []
    for seed in range(3):
        report, planted, own = fit_staged(make_instrument(GROUND, lna), seed)
        pulls_of_c.append(own)
        for curve in report.curves:
            # a flat amplifier and the converter behind it add the same in every channel
            assert curve.merged.constants == ("n_amp", "n_adc")
            found = {name: curve.parameters[name] for name in ("n_lna", "n_filter")}
            pulls.append([(one.value - planted[name]) / one.sigma for name, one in found.items()])
    assert np.sqrt(np.mean(np.square(pulls_of_c))) < 1.5
    # a temperature that is known counts once for all curves
    assert np.sqrt(np.mean(np.square(pulls))) < 1.7


def test_a_temperature_that_is_known_is_known_better_afterwards_and_so_is_c():
    free, _, _ = fit_staged(make_instrument(GROUND, FREE_LNA), 0)
    known, _, _ = fit_staged(make_instrument(GROUND, KNOWN_LNA), 0)
    assert all(0.0 < curve.parameters["n_lna"].sigma < 15.0 for curve in known.curves)
    assert all(curve.parameters["n_lna"].sigma > 100.0 for curve in free.curves)
    errors = [np.median([np.median(curve.c_sigma_stat / curve.c) for curve in one.curves]) for one in (free, known)]
    assert errors[1] < 0.8 * errors[0]
    assert "n_lna in K, known as 150 +- 15" in known.provenance.notes["noise_constants"]


def test_a_temperature_that_is_wrong_in_the_file_moves_c_and_fails_the_chain_test():
    planted = make_instrument(GROUND, KNOWN_LNA)
    sky = compute_sky_power(planted)
    spectra = simulate_campaign(TwinSettings(events_per_year=300), planted, sky, np.random.default_rng(5)).spectra
    right = fit_calibration(spectra, planted, sky).curves[0]
    wrong = fit_calibration(spectra, make_instrument(GROUND, KNOWN_LNA | {"noise_temperature_k": 2000}), sky).curves[0]
    assert right.chi2_per_dof < 2.0 < wrong.chi2_per_dof
    assert np.median(np.abs(wrong.c - right.c) / right.c_sigma_stat) > 2.0
