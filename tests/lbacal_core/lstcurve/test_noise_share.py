from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.lstcurve.compare import AS_RECORDED, BAND_MHZ, band_weights, noise_prior, published_noise_share


@pytest.fixture(scope="module")
def chain():
    return load_instrument("lofar-superterp")


@pytest.fixture(scope="module")
def weights(chain):
    return band_weights(chain, AS_RECORDED, BAND_MHZ)


def test_the_published_noise_is_smaller_against_a_sky_without_the_cosine(chain, weights):
    """The paper's ratio is 0.66 of a sky that its integral makes 0.70 times too dark."""
    prior = noise_prior(chain, BAND_MHZ, weights)
    share = published_noise_share(BAND_MHZ)
    assert share / (1 - share) == pytest.approx(0.66, abs=0.01)
    assert prior.mean == pytest.approx(0.696 * share / (1 - share), rel=1e-3)
    # Without the cosine the ratio is 1.1 standard deviations larger: its existence is an inference.
    assert prior.mean / 0.696 - prior.mean == pytest.approx(1.15 * prior.sigma, rel=0.05)


def test_the_stages_have_the_spectra_of_the_chain(chain, weights):
    lna, receiver, adc = noise_prior(chain, BAND_MHZ, weights).stages
    assert np.ptp(lna / weights) < 1e-12 * lna[0] / weights[0]
    assert np.ptp(receiver / chain.receiver_gain) < 1e-9 * receiver[0] / chain.receiver_gain[0]
    assert np.ptp(adc) == 0.0


def test_nothing_is_known_of_another_instrument_or_band(chain, weights):
    assert not noise_prior(replace(chain, name="another"), BAND_MHZ, weights).is_known
    assert not noise_prior(chain, (20.0, 25.0), weights).is_known
