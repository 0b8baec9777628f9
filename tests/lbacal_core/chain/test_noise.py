"""The noise constants of a chain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import Boltzmann

from lbacal_core.antenna.ideal import IsotropicAntenna
from lbacal_core.chain.intercepts import three_constants
from lbacal_core.chain.noise import noise_constants
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.antennas import GainProvenance
from lbacal_core.instrument.stages import Stage
from lbacal_core.skypower.model import compute_sky_power


def staged(low_band, *stages, **changes):
    return replace(low_band, stages=stages, gain_provenance=GainProvenance("absolute", "a table"), **changes)


def test_the_chain_of_the_paper_written_as_stages_has_its_three_constants(low_band):
    stages = (
        Stage("lna", "antenna", is_free=True),
        Stage("coax", "cable"),
        Stage("rcu", "amplifier", low_band.receiver_gain, is_free=True),
        Stage("adc", "adc", is_free=True),
    )
    found, plain = noise_constants(staged(low_band, *stages)), noise_constants(low_band)
    assert found.names == plain.names == ("n_lna", "n_rcu", "n_adc")
    for name in ("front", "behind", "known", "mean", "precision"):
        np.testing.assert_array_equal(getattr(found, name), getattr(plain, name))
    np.testing.assert_array_equal(plain.behind, three_constants(low_band.receiver_gain).behind)


def test_kelvin_at_the_input_of_a_stage_are_referred_to_the_sky_through_what_stands_before(low_band):
    ones = np.ones(low_band.frequency_mhz.size)
    stages = (
        Stage("balun", "filter", 0.5 * ones),
        Stage("lna", "lna", 100 * ones, noise_k=200 * ones, error_k=20.0),
        Stage("coax", "cable"),
        Stage("rcu", "amplifier", low_band.receiver_gain, is_free=True),
        Stage("adc", "adc", is_free=True),
    )
    found = noise_constants(staged(low_band, *stages))
    assert (found.names[0], found.units[0], found.mean[0], found.precision[0]) == ("n_lna", "K", 200.0, 20.0**-2)
    received = low_band.antenna_gain * 0.5 * found.front[0]
    np.testing.assert_allclose(received, Boltzmann * 1e6)
    assert not found.known.any()
    exact = noise_constants(staged(low_band, stages[0], replace(stages[1], error_k=0.0), *stages[2:]))
    np.testing.assert_allclose(exact.known, 200 * found.front[0])
    assert len(exact.front) == 0


def test_a_ground_that_fills_half_the_sphere_adds_what_a_sky_of_its_temperature_does(low_band):
    ones = np.ones(low_band.frequency_mhz.size)
    ground = Stage("ground", "ground", noise_k=290 * ones, solid_angle_sr=2 * np.pi)
    found = noise_constants(staged(low_band, ground, Stage("adc", "adc", is_free=True), receiver_gain=ones))

    class UniformSky:
        name, lmax = "uniform", 2

        def temperature(self, frequency_mhz):
            multipoles = np.zeros((frequency_mhz.size, 3, 3), dtype=complex)
            multipoles[:, 0, 0] = 290.0 * np.sqrt(4 * np.pi)
            return multipoles

        def digest(self):
            return "uniform"

    sky = compute_sky_power(low_band, UniformSky(), IsotropicAntenna())
    # the beam is cut at the horizon on a grid
    np.testing.assert_allclose(found.known, sky.power["X"].mean(axis=0), rtol=0.01)


def test_a_known_temperature_behind_cables_that_differ_is_refused(low_band):
    ones = np.ones(low_band.frequency_mhz.size)
    stages = (
        Stage("coax", "cable"), Stage("amp", "amplifier", ones, noise_k=290 * ones), Stage("adc", "adc", is_free=True)
    )  # fmt: skip
    unlike = replace(low_band, cables={"short": 0.5 * ones, "long": 0.3 * ones}, antennas=())
    with pytest.raises(BadInputError, match="free, or none, behind cables that differ"):
        noise_constants(staged(unlike, *stages, receiver_gain=ones))
    same = replace(unlike, cables={"short": 0.5 * ones})
    known = noise_constants(staged(same, *stages, receiver_gain=ones)).known
    np.testing.assert_allclose(known * same.antenna_gain * 0.5, 290 * Boltzmann * 1e6)


def test_kelvin_beside_a_gain_that_is_not_in_square_metres_are_refused(low_band):
    ones = np.ones(low_band.frequency_mhz.size)
    stages = (Stage("lna", "lna", ones, noise_k=200 * ones), Stage("adc", "adc", is_free=True))
    with pytest.raises(BadInputError, match="to refer kelvin to the sky"):
        replace(low_band, stages=stages, receiver_gain=ones, gain_provenance=None)
