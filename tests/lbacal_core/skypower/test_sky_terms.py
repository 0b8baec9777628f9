from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.sky.names import load_sky, read_sky_level
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.sky_terms import SKY_BUDGETS, SkyTerm, read_anchors, sky_terms, zero_level_sigma_k

CHANNELS = [30.0, 50.0, 65.0, 80.0]


@pytest.fixture(scope="module")
def few_channels() -> Instrument:
    whole = load_instrument("lofar-superterp")
    at = np.isin(whole.frequency_mhz, CHANNELS)
    return replace(
        whole,
        frequency_mhz=whole.frequency_mhz[at],
        antenna_gain=whole.antenna_gain[at],
        receiver_gain=whole.receiver_gain[at],
        cables={name: loss[at] for name, loss in whole.cables.items()},
        gain_provenance=None,
    )


def rms_level(terms: tuple[SkyTerm, ...]) -> np.ndarray:
    """Root of the summed squares of the means over LST and dipoles, shape (freq,)."""
    means = [np.mean([values.mean(axis=0) for values in term.d_ln_p.values()], axis=0) for term in terms]
    return np.asarray(np.sqrt(np.sum(np.square(means), axis=0)))


def test_the_budget_of_the_paper_is_23_percent_in_power(few_channels: Instrument) -> None:
    terms = sky_terms(few_channels, "paper")
    np.testing.assert_allclose(rms_level(terms), np.sqrt(0.2**2 + 0.1**2 + 0.05**2))
    assert all(term.d_ln_p[dipole].shape == (96, 4) for term in terms for dipole in "XY")


def test_seven_models_have_one_level_of_12_percent_and_what_is_left_has_none(few_channels: Instrument) -> None:
    first, *others = sky_terms(few_channels, "models")
    assert np.all(first.d_ln_p["X"] == 0.12)
    for term in others:
        assert np.mean([values.mean() for values in term.d_ln_p.values()]) == pytest.approx(0.0, abs=1e-12)


def test_the_measured_sky_is_known_to_a_quarter_of_the_paper(few_channels: Instrument) -> None:
    total = rms_level(sky_terms(few_channels, "measured"))
    assert np.all(total[1:] < 0.25 * 0.23)
    assert total[0] > total[1], "below 50 MHz the embedded sky is an extrapolation"


def test_level_and_slope_are_those_of_the_measurements(few_channels: Instrument) -> None:
    level, slope = sky_terms(few_channels, "measured")[:2]
    together = np.hypot(level.d_ln_p["X"][0], slope.d_ln_p["X"][0])
    np.testing.assert_allclose(together, read_sky_level().sigma(few_channels.frequency_mhz))


def test_a_zero_level_is_what_an_isotropic_brightness_does(few_channels: Instrument) -> None:
    term = next(one for one in sky_terms(few_channels, "measured") if one.name == "zero level of the sky")
    step = 1e-3
    plain = compute_sky_power(few_channels, "gsm")
    more = compute_sky_power(few_channels, load_sky("gsm").changed(extra_isotropic=step))
    nu = few_channels.frequency_mhz
    per_kelvin = (more.power["X"] / plain.power["X"] - 1) / (step * 50.0 * (150.0 / nu) ** 2.75)
    kelvin = zero_level_sigma_k(read_anchors()) * (nu / 75.0) ** -2.55
    swing = term.d_ln_p["X"] - term.d_ln_p["X"][0]
    np.testing.assert_allclose(swing, kelvin * (per_kelvin - per_kelvin[0]), atol=1e-9)
    # with the scale that keeps the mean at EDGES, little of it is left in the mean over LST
    assert np.all(np.abs(term.d_ln_p["X"].mean(axis=0)) < 0.02)


def test_the_transfer_to_the_north_is_what_models_tied_in_the_south_differ_by(few_channels: Instrument) -> None:
    terms = [one for one in sky_terms(few_channels, "measured") if one.name.startswith("transfer")]
    assert {term.source.split()[1] for term in terms} == {"gsm408", "haslam", "lfsm", "maeda"}
    assert np.all(rms_level(tuple(terms)) < 0.04)


def test_c_made_with_gsm_carries_the_measured_difference_in_full(few_channels: Instrument) -> None:
    *others, bias = sky_terms(few_channels, "measured", sky="gsm")
    assert len(others) == len(sky_terms(few_channels, "measured"))
    np.testing.assert_allclose(bias.d_ln_p["Y"][7], read_sky_level().ln_ratio(few_channels.frequency_mhz))


def test_an_unknown_budget_is_refused_with_those_there_are(few_channels: Instrument) -> None:
    with pytest.raises(BadInputError, match=", ".join(SKY_BUDGETS)):
        sky_terms(few_channels, "hope")
