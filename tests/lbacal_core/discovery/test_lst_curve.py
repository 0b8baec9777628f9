from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.discovery.lst_curve import describe_curve, investigate_curve
from lbacal_core.lstcurve.compare import AS_RECORDED, band_weights
from lbacal_core.lstcurve.curve import LstCurve, measured_curve, read_lst_curve
from lbacal_core.provenance import Provenance

BAND = (30.0, 80.0)
pytestmark = pytest.mark.timeout(600)


def simulated(chain, power, lst_hours, noise_share=0.0, seed=0):
    """A curve of 48 points a dipole with 0.05 dB of noise, from P_sky by dipole on a grid of LST."""
    rng = np.random.default_rng(seed)
    weights = band_weights(chain, AS_RECORDED, BAND)
    variation = {}
    for dipole in "XY":
        band = power.at(dipole, lst_hours) @ weights
        band = band / band.mean()
        variation[dipole] = 10 * np.log10((1 - noise_share) * band + noise_share) + 0.05 * rng.standard_normal(48)
    return LstCurve(lst_hours, variation, np.full(48, 0.1), 0.5, True, "simulated")


@pytest.fixture(scope="module")
def lst_hours():
    return np.arange(48) / 2.0


def test_a_curve_of_the_simulation_itself_is_consistent(chain, sky, lst_hours):
    found = investigate_curve(simulated(chain, sky, lst_hours), sky, chain, BAND, is_own_sky=False)
    report = describe_curve(found, Provenance({}))
    assert report["verdict"] == "consistent"
    assert report["findings"] == []


def test_exchanged_letters_are_named_with_share_one(chain, sky, lst_hours):
    exchanged = replace(sky, power={"X": sky.power["Y"], "Y": sky.power["X"]})
    found = investigate_curve(simulated(chain, exchanged, lst_hours), sky, chain, BAND, is_own_sky=False)
    report = describe_curve(found, Provenance({}))
    assert [finding["cause"] for finding in report["findings"]] == ["dipole_swap"]
    assert report["findings"][0]["size"]["value"] > 0.95
    assert report["verdict"] == "explained"


def test_noise_in_the_data_is_a_missing_stage_or_an_isotropic_level_and_both_are_named(chain, sky, lst_hours):
    curve = simulated(chain, sky, lst_hours, noise_share=0.3)
    report = describe_curve(investigate_curve(curve, sky, chain, BAND, is_own_sky=False), Provenance({}))
    (finding,) = report["findings"]
    assert {finding["cause"], *finding["indistinguishable"]} >= {"missing_noise", "isotropic_level"}
    # a share of 0.3 of the total is 0.3 / 0.7 of the sky
    assert abs(finding["size"]["value"] - 0.3 / 0.7) < 4 * finding["size"]["sigma"]


def test_a_shift_in_sidereal_time_comes_out_in_hours(chain, sky, lst_hours):
    curve = simulated(chain, sky, (lst_hours + 0.5) % 24)
    moved = replace(curve, lst_hours=lst_hours)
    report = describe_curve(investigate_curve(moved, sky, chain, BAND, is_own_sky=False), Provenance({}))
    assert report["findings"][0]["cause"] == "lst_offset"
    assert abs(report["findings"][0]["size"]["value"] - 0.5) < 4 * report["findings"][0]["size"]["sigma"]


def test_the_measured_curve_says_that_the_letters_are_exchanged(chain, sky):
    curve = read_lst_curve(measured_curve())
    found = investigate_curve(curve, sky, chain, BAND, is_own_sky=True)
    report = describe_curve(found, Provenance({}))
    assert report["findings"][0]["cause"] == "dipole_swap"
    assert report["findings"][0]["gain"]["held_out_log_likelihood_gain"] > 0
    assert report["chi2"]["after"]["drawn_bars"] < 0.5 * report["chi2"]["before"]["drawn_bars"]
    json.dumps(report, allow_nan=False)
