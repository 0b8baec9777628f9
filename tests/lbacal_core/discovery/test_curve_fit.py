from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.discovery.curve_fit import GRID_HOURS, CurveFitter, gather_curve, list_choices
from lbacal_core.lstcurve.compare import AS_RECORDED, band_weights, noise_prior
from lbacal_core.lstcurve.curve import LstCurve, estimate_noise
from lbacal_core.skypower.differences import model_difference_modes

BAND = (30.0, 80.0)
LST = np.arange(48) / 2.0 + 0.25
NOISE_DB = 0.03


@pytest.fixture(scope="module")
def station(chain, sky):
    weights = band_weights(chain, AS_RECORDED, BAND)
    return gather_curve(chain, sky, weights, noise_prior(chain, BAND, weights))


@pytest.fixture(scope="module")
def causes(station):
    return {choice.label: choice for choice in list_choices(station)}


@pytest.fixture(scope="module")
def fitter(station, causes):
    """A fitter of the curve that some causes make at some sizes, with 0.03 dB of noise on the points."""

    def make(changes=(), seed=1, scatter=NOISE_DB, modes=None, noise=0.5, prior=None):
        planted = [causes[label] for label, _ in changes]
        power = station.terms_with(planted, np.array([size for _, size in changes]), noise).power().sum(axis=-1)
        rng = np.random.default_rng(seed)
        variation = {}
        for dipole, on_grid in zip("XY", power, strict=True):
            angle = 2 * np.pi * np.subtract.outer(LST, GRID_HOURS) / 24
            order = np.arange(1, 16)
            series = (1 + 2 * np.cos(angle[..., None] * order).sum(axis=-1)) @ on_grid / on_grid.size
            variation[dipole] = 10 * np.log10(series / series.mean()) + scatter * rng.standard_normal(LST.size)
        curve = LstCurve(LST, variation, np.full(LST.size, 0.1), 0.5, True, "simulated")
        shown = replace(station, prior=prior or station.prior)
        return CurveFitter(curve, shown, estimate_noise(curve), modes)

    return make


def test_a_curve_of_the_simulation_leaves_its_noise(fitter):
    plain = fitter().fit(())
    assert plain.chi2 / plain.dof == pytest.approx(1.0, abs=0.35)  # 94 degrees of freedom, and their noise estimated
    for dipole in "XY":
        assert np.nanstd(plain.residual_db[dipole]) == pytest.approx(NOISE_DB, rel=0.35)


SIZES = {"lst_offset": -0.2, "zenith_weighting": 0.5, "missing_noise": 1.2, "dipole_azimuth": 8.0}


@pytest.mark.parametrize("label", SIZES)
def test_the_size_that_was_put_in_comes_out_within_its_error(label, fitter, causes):
    cause, size = causes[label], SIZES[label]
    one = fitter([(label, size)])
    fewer, more = one.fit(()), one.fit((cause,))
    assert fewer.chi2 > more.chi2 + 20
    # The known noise is 0.04 below the true one, which is part of what is missing.
    known = one.station.prior.mean if label == "missing_noise" else 0.5
    assert more.sizes[0] == pytest.approx(size + 0.5 - known, abs=4 * more.sigmas[0])
    assert 0 < more.sigmas[0] < 0.3 * abs(size)
    # Held-out points know nothing of the prior, which is what missing noise disagrees with.
    assert one.held_out_gain(fewer, more) > (0 if label == "missing_noise" else 5)
    assert not more.is_at_edge


def test_the_error_of_a_size_is_its_scatter(fitter, causes):
    cause = causes["lst_offset"]
    fits = [fitter([("lst_offset", 0.1)], seed=seed).fit((cause,)) for seed in range(12)]
    sizes, sigmas = np.array([one.sizes[0] for one in fits]), np.array([one.sigmas[0] for one in fits])
    assert 0.5 < np.std(sizes, ddof=1) / np.median(sigmas) < 1.7  # 1.0 +- 0.2 of 12 sizes


def test_a_cause_that_is_not_there_predicts_nothing(fitter, causes):
    gains = []
    for seed in range(8):
        one = fitter(seed=seed)
        gains.append(one.held_out_gain(one.fit(()), one.fit((causes["zenith_weighting"],))))
    assert np.mean(gains) < 0.5


def test_chi_squared_is_that_of_a_dense_covariance_with_a_free_offset_a_dipole(fitter):
    one = fitter()
    plain = one.fit(())
    difference = one.measured - one.points_with((), np.zeros(0), plain.noise)
    inverse = np.linalg.inv(one.covariance)
    normal = one.offsets.T @ inverse @ one.offsets
    offsets = np.linalg.solve(normal, one.offsets.T @ inverse @ difference)
    left = difference - one.offsets @ offsets
    prior = one.station.prior
    pull = (plain.noise - prior.mean) / prior.sigma
    assert plain.chi2 == pytest.approx(left @ inverse @ left + pull**2, rel=1e-9)
    assert plain.points == 96
    assert plain.dof == 94


def test_the_spread_of_models_makes_errors_larger(fitter, causes, chain):
    modes = model_difference_modes(chain, GRID_HOURS)
    cause = causes["zenith_weighting"]
    given, own = fitter([(cause.label, 0.5)]), fitter([(cause.label, 0.5)], modes=modes)
    assert given.model_variance == (0.0, 0.0)
    assert min(own.model_variance) > 1e-4
    assert own.fit((cause,)).sigmas[0] > 1.5 * given.fit((cause,)).sigmas[0]
    assert own.fit(()).chi2 < given.fit(()).chi2


def test_an_exchange_is_true_or_not_and_has_no_size_to_fit(fitter, causes):
    swap = causes["dipole_swap"]
    one = fitter([("dipole_swap", 1.0)])
    fewer, more = one.fit(()), one.fit((swap,))
    assert (more.sizes.tolist(), more.sigmas.tolist()) == ([1.0], [0.0])
    assert more.dof == fewer.dof
    assert fewer.chi2 > more.chi2 + 1000
    assert not more.is_at_edge
    assert one.held_out_gain(fewer, more) > 500


def test_noise_is_fitted_with_its_prior_and_without_one_where_nothing_is_known(fitter, station):
    for planted in (0.3, 0.7):
        known = fitter(noise=planted).fit(())
        blind = fitter(noise=planted, prior=replace(station.prior, sigma=np.inf)).fit(())
        for fit in (known, blind):
            assert fit.noise == pytest.approx(planted, abs=4 * fit.noise_sigma)
        assert known.noise_sigma < station.prior.sigma
        assert known.noise_sigma < blind.noise_sigma
        assert (known.dof, blind.dof) == (94, 93)


def test_noise_is_never_negative(fitter):
    """A curve whose sky varies by more than the simulation's, as negative noise would make it."""
    assert fitter(noise=-0.2).fit(()).noise == pytest.approx(0.0, abs=1e-3)


def test_points_that_scatter_more_than_their_noise_widen_the_errors(fitter):
    plain = fitter().fit(())
    assert plain.scale >= 1.0
    wider = type(plain)(**{**vars(plain), "chi2": 4.0 * plain.dof})
    assert wider.scale == pytest.approx(4.0)


def test_the_change_of_c_is_that_of_the_chain_and_not_of_one_line_a_channel(fitter, causes, station):
    """An exchange moves C of a channel by itself by 10 % and more; tied intercepts allow half of it."""
    one = fitter([("dipole_swap", 1.0)])
    fewer, more = one.fit(()), one.fit((causes["dipole_swap"],))
    change = one.calibration_change(fewer, more)
    old, new = (station.terms_with(fit.choices, fit.sizes, fit.noise).sky for fit in (fewer, more))
    for d, (dipole, sign) in enumerate((("X", 1), ("Y", -1))):
        slopes = [np.polyfit(old[d, :, f], new[d, :, f], 1)[0] for f in range(51)]
        of_lines = float(np.median(np.sqrt(slopes))) - 1.0
        of_chain = float(np.median(change[dipole]))
        assert sign * of_lines > 0.07
        assert 0.005 < sign * of_chain < 0.6 * sign * of_lines
    # The larger model itself needs no other C.
    assert np.abs(one.calibration_change(more, more)["X"]).max() < 1e-9


def test_a_level_of_noise_leaves_c_as_it_is(fitter, causes):
    one = fitter([("missing_noise", 0.8)])
    change = one.calibration_change(one.fit(()), one.fit((causes["missing_noise"],)))
    assert max(np.abs(change[d]).max() for d in "XY") < 0.01
