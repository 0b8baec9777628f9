from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import Boltzmann

from lbacal_core.antenna.ideal import IsotropicAntenna
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.antennas import GainProvenance
from lbacal_core.instrument.chain import ChainTerms, calibration_factor, noise_constants, three_constants
from lbacal_core.instrument.stages import Stage
from lbacal_core.sky.power import compute_sky_power
from tests.oracles import chain_power

FREQUENCY = np.linspace(30, 80, 11)
CHAIN = {
    "antenna_gain": 0.2 + np.exp(-(((FREQUENCY - 58) / 8) ** 2)),
    "correction": 1 + 0.1 * np.sin(FREQUENCY),
    "cable_loss": 10 ** (-0.1 * np.sqrt(FREQUENCY)),
    "receiver_gain": 1.1 - 0.009 * (FREQUENCY - 30),
    "scale": 3e4,
    "n_lna": 0.2,
    "n_rcu": 1e-3,
    "n_adc": 5.0,
}


def test_power_is_a_line_in_sky_power_with_the_slope_and_intercept_of_the_docstring():
    sky = np.outer([1.0, 2.0, 5.0], np.ones(11))
    slope = CHAIN["antenna_gain"] * CHAIN["correction"] * CHAIN["cable_loss"] * CHAIN["receiver_gain"] * CHAIN["scale"]
    intercept = CHAIN["n_lna"] * slope + CHAIN["n_rcu"] * CHAIN["scale"] * CHAIN["receiver_gain"] + CHAIN["n_adc"]
    np.testing.assert_allclose(chain_power(sky, **CHAIN), slope * sky + intercept, rtol=1e-12)


def test_noise_enters_behind_what_precedes_it():
    sky = np.ones((1, 11))
    base = chain_power(sky, **CHAIN)
    louder_adc = chain_power(sky, **{**CHAIN, "n_adc": 6.0})
    np.testing.assert_allclose(louder_adc - base, 1.0, rtol=1e-9)
    louder_rcu = chain_power(sky, **{**CHAIN, "n_rcu": 2e-3})
    np.testing.assert_allclose((louder_rcu - base)[0], 1e-3 * CHAIN["receiver_gain"] * CHAIN["scale"], rtol=1e-9)


def test_longer_cable_raises_c_with_frequency():
    slope = CHAIN["antenna_gain"] * CHAIN["cable_loss"]
    longer = CHAIN["antenna_gain"] * CHAIN["cable_loss"] ** 1.5
    ratio = calibration_factor(longer, CHAIN["antenna_gain"]) / calibration_factor(slope, CHAIN["antenna_gain"])
    assert np.all(ratio > 1)
    assert np.all(np.diff(ratio) > 0)


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


def test_the_power_of_the_terms_is_the_chain_equation_written_out():
    rng = np.random.default_rng(11)
    classes, events, channels = 2, 5, 7
    sky = rng.uniform(1.0, 3.0, (classes, events, channels))
    antenna_gain, correction, receiver_gain = rng.uniform(0.5, 2.0, (3, channels))
    cable_loss = rng.uniform(0.1, 0.9, (classes, channels))  # two classes of paths: two lengths of cable
    scale, n_lna, n_rcu, n_adc = 30.0, 0.2, 0.05, 4.0
    terms = ChainTerms(
        sky=sky,
        n_lna=np.array(n_lna),
        front=(antenna_gain * correction * cable_loss * receiver_gain * scale)[:, None, :],
        receiver_noise=n_rcu * scale * receiver_gain,
        adc_noise=np.array(n_adc),
    )
    rest = {"antenna_gain": antenna_gain, "correction": correction, "receiver_gain": receiver_gain, "scale": scale}
    rest |= {"n_lna": n_lna, "n_rcu": n_rcu, "n_adc": n_adc}
    written_out = [chain_power(sky[path], cable_loss=cable_loss[path], **rest) for path in range(classes)]
    np.testing.assert_allclose(terms.power(), written_out, rtol=1e-13)
