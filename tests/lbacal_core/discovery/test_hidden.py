"""What the differences between sky models hide, and that nothing is named for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.discovery.report import investigate
from lbacal_core.skypower.model import compute_sky_power
from lbacal_twin.faults.antenna import GainStep
from lbacal_twin.faults.fault import Where


def under(world, sky, *faults):
    """Spectra under another sky than the own."""
    return replace(world, sky=sky).spectra(*faults)


@pytest.fixture(scope="module")
def other_sky(world):
    """The Low Frequency Sky Model: 15 % more power at 55 MHz, and another slope along frequency."""
    return compute_sky_power(world.instrument, "lfsm")


@pytest.mark.long
def test_the_level_of_another_sky_was_named_a_slope_of_the_noise_of_the_lna(world, other_sky):
    """The mean over LST of model differences was dropped, because A(nu) describes it; A multiplies N_LNA too."""
    level = {d: np.mean(other_sky.power[d] / world.sky.power[d], axis=0) for d in "XY"}
    only_level = replace(world.sky, power={d: world.sky.power[d] * level[d] for d in "XY"})
    for sky in (other_sky, only_level):
        report, _ = investigate(under(world, sky), world.instrument, world.sky, is_own_sky=True)
        assert report["verdict"] == "consistent"


def test_what_sky_models_hide_is_listed_with_the_share_that_is_left(world):
    report, _ = investigate(world.spectra(), world.instrument, world.sky, is_own_sky=True)
    reasons = {one["cause"]: one["why"] for one in report["unidentifiable"]}
    assert {"lna_noise_slope", "isotropic_level"} <= reasons.keys()
    assert "of its information is left" in reasons["lna_noise_slope"]
    assert not {"dipole_swap", "zenith_weighting", "point_source", "gain_step"} & reasons.keys()
    assert not {"lna_noise_slope", "isotropic_level"} & {
        score["cause"] for scores in report["scores"].values() for score in scores
    }
    # What the noise takes of them was a share of rounding errors, once -0.16.
    for noise in report["noise"].values():
        assert not {"lna_noise_slope", "isotropic_level"} & noise["taken"].keys()
        assert all(-1e-6 < share < 1 for share in noise["taken"].values())


def test_a_sky_power_at_its_word_hides_nothing(world):
    report, _ = investigate(world.spectra(), world.instrument, world.sky)
    assert not {"lna_noise_slope", "isotropic_level"} & {one["cause"] for one in report["unidentifiable"]}


@pytest.mark.long
def test_a_gain_step_keeps_its_significance_under_another_sky(world, other_sky):
    step = GainStep(size=0.03, date="2014-07-01", where=Where(antennas=(1,)))
    told, _ = investigate(world.spectra(step), world.instrument, world.sky)
    own, _ = investigate(under(world, other_sky, step), world.instrument, world.sky, is_own_sky=True)
    (one,), (other,) = told["findings"], own["findings"]
    assert one["cause"] == other["cause"] == "gain_step"
    assert other["significance_sigma"] == pytest.approx(one["significance_sigma"], rel=0.1)


@pytest.mark.long
@pytest.mark.parametrize("harmonic", [1, 2, 3])
def test_a_wave_of_the_sky_that_no_model_has_gets_no_name(world, other_sky, harmonic):
    """It was named: a pattern that is too wide, a source, a line at the end of the band.

    Paths with long cables show less of the sky, and what of a wrong sky their deviations from the mean show had the
    form of a cause.
    """
    phase = 2 * np.pi * harmonic * other_sky.lst_hours / 24
    factor = 1 + 0.04 * np.cos(phase)[:, None] * np.linspace(1.2, 0.8, 51)
    sky = replace(other_sky, power={d: power * factor for d, power in other_sky.power.items()})
    report, _ = investigate(under(world, sky), world.instrument, world.sky, is_own_sky=True)
    assert report["findings"] == []
    assert report["unexplained"] is None


@pytest.mark.long
@pytest.mark.parametrize("is_own_sky", [True, False])
def test_a_step_beside_a_wave_of_the_sky_is_named_with_its_size(world, is_own_sky):
    """Its size was 8 sigma off: with the wave a part of the step had been taken out of the data."""
    step = GainStep(size=0.03, date="2014-07-01", where=Where(antennas=(1,)))
    harmonics = [np.cos(2 * np.pi * (k * world.sky.lst_hours / 24 + 0.1 * k)) for k in (1, 2, 3)]
    factor = 1 + 0.03 * (2 / 3) ** 0.5 * np.sum(harmonics, axis=0)[:, None]
    sky = replace(world.sky, power={d: power * factor for d, power in world.sky.power.items()})
    report, _ = investigate(under(world, sky, step), world.instrument, world.sky, is_own_sky=is_own_sky)
    (found,) = report["findings"]
    assert (found["cause"], found["evidence"]["target"]) == ("gain_step", "antenna 1")
    assert abs(found["size"]["value"] - 0.03) < 3 * found["size"]["sigma"]
    assert (report["unexplained"] is None) == is_own_sky
