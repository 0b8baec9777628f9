from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.discovery.curve_search import describe_curve, investigate_curve
from lbacal_core.lstcurve.compare import AS_RECORDED, band_weights
from lbacal_core.lstcurve.curve import LstCurve
from lbacal_core.provenance import Provenance
from lbacal_core.skypower.model import vary_sky_power

BAND = (30.0, 80.0)


def simulated(chain, power, lst_hours, noise_share=0.3, seed=0):
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
    assert report["findings"][0]["size"]["value"] == 1.0
    assert report["verdict"] == "explained"


def test_noise_beyond_what_is_published_is_found_and_named_beside_an_isotropic_level(chain, sky, lst_hours):
    curve = simulated(chain, sky, lst_hours, noise_share=0.7)
    report = describe_curve(investigate_curve(curve, sky, chain, BAND, is_own_sky=False), Provenance({}))
    (finding,) = report["findings"]
    assert {finding["cause"], *finding["indistinguishable"]} >= {"missing_noise", "isotropic_level"}
    share = finding["parameters"]["fraction_of_mean_sky_power"] + report["noise"]["of_mean_sky_power"]["prior"]["value"]
    relative = finding["size"]["sigma"] / finding["size"]["value"]
    assert abs(share / (0.7 / 0.3) - 1) < 4 * relative  # a share of 0.7 of the total is 0.7 / 0.3 of the sky


@pytest.mark.parametrize("noise_share", [0.0, 0.2, 0.4])
def test_noise_within_its_prior_is_no_finding(noise_share, chain, sky, lst_hours):
    curve = simulated(chain, sky, lst_hours, noise_share)
    report = describe_curve(investigate_curve(curve, sky, chain, BAND, is_own_sky=False), Provenance({}))
    assert report["verdict"] == "consistent"
    assert report["noise"]["of_mean_sky_power"]["share"] == pytest.approx(noise_share, abs=0.05)


def test_noise_that_nobody_published_is_free_and_no_cause(chain, sky, lst_hours):
    other = replace(chain, name="another")
    curve = simulated(chain, sky, lst_hours, noise_share=0.7)
    report = describe_curve(investigate_curve(curve, sky, other, BAND, is_own_sky=False), Provenance({}))
    assert report["verdict"] == "consistent"
    assert report["noise"]["of_mean_sky_power"]["prior"] is None
    assert {"missing_noise", "isotropic_level"} <= {one["cause"] for one in report["unidentifiable"]}


def test_a_shift_in_sidereal_time_comes_out_in_hours(chain, sky, lst_hours):
    curve = simulated(chain, sky, (lst_hours + 0.5) % 24)
    moved = replace(curve, lst_hours=lst_hours)
    report = describe_curve(investigate_curve(moved, sky, chain, BAND, is_own_sky=False), Provenance({}))
    assert report["findings"][0]["cause"] == "lst_offset"
    assert abs(report["findings"][0]["size"]["value"] - 0.5) < 4 * report["findings"][0]["size"]["sigma"]


@pytest.mark.long
def test_a_pair_is_found_although_neither_fits_alone(chain, sky, lst_hours):
    exchanged = replace(sky, power={"X": sky.power["Y"], "Y": sky.power["X"]})
    curve = simulated(chain, exchanged, lst_hours, noise_share=0.7)
    report = describe_curve(investigate_curve(curve, sky, chain, BAND, is_own_sky=False), Provenance({}))
    named = {finding["cause"]: {finding["cause"], *finding["indistinguishable"]} for finding in report["findings"]}
    assert "dipole_swap" in named
    assert any("missing_noise" in names for names in named.values())
    assert report["verdict"] == "explained"


def test_half_a_cosine_too_many_in_the_sky_integral_is_named_beside_a_wider_pattern(chain, sky, lst_hours):
    wrong = vary_sky_power(chain, zenith_exponent=0.5)
    found = investigate_curve(simulated(chain, sky, lst_hours), wrong, chain, BAND, is_own_sky=False)
    report = describe_curve(found, Provenance({}))
    (finding,) = report["findings"]
    assert {finding["cause"], *finding["indistinguishable"]} == {"zenith_weighting", "pattern_width"}
    if finding["cause"] == "zenith_weighting":
        assert finding["size"]["value"] == pytest.approx(-0.5, abs=4 * finding["size"]["sigma"])


def test_a_whole_cosine_too_many_reads_as_one(chain, sky, lst_hours):
    """By the ratio own(-1)/own(0) it read as 0.77."""
    wrong = vary_sky_power(chain, zenith_exponent=1.0)
    found = investigate_curve(simulated(chain, sky, lst_hours), wrong, chain, BAND, is_own_sky=False)
    assert found.single[0].labels == ("zenith_weighting",)
    assert found.single[0].sizes[0] == pytest.approx(-1.0, abs=4 * found.single[0].sigmas[0])
    assert found.single[0].sigmas[0] < 0.05


def test_what_no_cause_describes_is_unexplained(chain, sky, lst_hours):
    curve = simulated(chain, sky, lst_hours)
    ripple = 0.3 * np.sin(2 * np.pi * 5 * lst_hours / 24)
    odd = replace(curve, variation_db={d: curve.variation_db[d] + ripple for d in "XY"})
    report = describe_curve(investigate_curve(odd, sky, chain, BAND, is_own_sky=False), Provenance({}))
    assert report["verdict"] == "unexplained"
    assert report["unexplained"]["where"]["axis"] == "lst"
    assert report["findings"] == []


def test_a_cause_beside_residual_structure_is_similar_to_it_and_no_finding(chain, sky, lst_hours):
    """A curve has one axis, along which both act: the structure might be what the cause is taken for."""
    exchanged = replace(sky, power={"X": sky.power["Y"], "Y": sky.power["X"]})
    curve = simulated(chain, exchanged, lst_hours)
    ripple = 0.3 * np.sin(2 * np.pi * 5 * lst_hours / 24)
    odd = replace(curve, variation_db={d: curve.variation_db[d] + ripple for d in "XY"})
    report = describe_curve(investigate_curve(odd, sky, chain, BAND, is_own_sky=False), Provenance({}))
    assert report["verdict"] == "unexplained"
    assert report["findings"] == []
    assert "dipole_swap" in [finding["cause"] for finding in report["unexplained"]["similar_to"]]
    assert "residual structure" in report["sentence"]


def test_the_same_curve_gives_the_same_report(chain, sky, lst_hours):
    curve = simulated(chain, sky, lst_hours, noise_share=0.2)
    once, again = (
        describe_curve(investigate_curve(curve, sky, chain, BAND, is_own_sky=False), Provenance({})) for _ in range(2)
    )
    assert json.dumps(once) == json.dumps(again)
