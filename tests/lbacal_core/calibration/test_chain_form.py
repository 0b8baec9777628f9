from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.special import logsumexp

from lbacal_core.calibration.chain_form import (
    FORM_OF_CHAIN,
    ChainForm,
    compare_forms,
    integrate_lines,
    list_amounts,
    list_forms,
)
from lbacal_core.calibration.continued import continue_fit
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.curves.curves import CONVERGED
from lbacal_core.curves.kept_lines import read_lines, write_lines
from lbacal_core.discovery.calibrate import fit_causes
from lbacal_core.instrument.chain import BEHIND, FORMS, PUBLISHED, SLOPED
from lbacal_core.instrument.stages import Stage
from lbacal_core.pipeline import calibrate
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.power import compute_sky_power
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings
from tests.lbacal_core.calibration.conftest import Scene


@dataclass(frozen=True)
class OtherChain(Scene):
    """The scene with noise behind the resonance, (P_sky G_ant + N) A L, or a slope of N_LNA by 25 MHz."""

    n_amplifier: float = 0.0
    n_lna_slope: float = 0.0

    def mean_power(self, sky, cable="80"):
        nu, gain = self.instrument.frequency_mhz, self.instrument.antenna_gain
        behind = self.n_amplifier * self.slope(cable) / gain
        return super().mean_power(sky, cable) + behind + self.slope(cable) * self.n_lna_slope * (nu - 55.0) / 25.0


def other_chain(scene, **noise):
    return OtherChain(scene.instrument, scene.sky_power, **noise)


SPECTRA = 12, 500
"""Seed and events."""


def draw(scene, seed=SPECTRA[0], events=SPECTRA[1]):
    return scene.spectra(np.random.default_rng(seed), events=events)


def pulls_of_c(scene, curves):
    """(C - truth) over its statistical error, shape (curve, freq)."""
    return np.array([
        (one.c - np.sqrt(scene.instrument.antenna_gain / scene.slope("80" if one.antenna % 2 else "50")))
        / one.c_sigma_stat
        for one in curves
    ])  # fmt: skip


@pytest.mark.parametrize(
    ("noise", "form"),
    [
        ({}, PUBLISHED),
        ({"n_lna": 0.0}, PUBLISHED),
        ({"n_lna": 0.0, "n_amplifier": 0.05}, BEHIND),
        ({"n_amplifier": 0.05}, BEHIND),
        ({"n_lna_slope": 0.1}, SLOPED),
    ],
    ids=["published", "no LNA noise", "behind", "both", "sloped"],
)
def test_the_form_of_the_chain_that_made_the_data_is_preferred(scene, noise, form):
    made = other_chain(scene, **noise)
    found = compare_forms(draw(made), scene.simulation)
    assert found.name == form
    assert found.probability[form] > 0.95


def test_published_data_have_the_published_curves_to_the_last_bit(scene, spectra):
    report = fit_causes(spectra, scene.simulation).fit("antenna")
    plain = fit_calibration(spectra, scene.simulation, "antenna")
    for one, before in zip(report.curves, plain.curves, strict=True):
        np.testing.assert_array_equal(one.c, before.c)
    assert report.provenance.notes[FORM_OF_CHAIN].startswith("noise enters in front of the antenna's resonance")


def test_noise_behind_the_resonance_leaves_c_within_its_error(scene):
    """Data by the formula of this file. With the published form C is off by many standard deviations."""
    made = other_chain(scene, n_amplifier=0.05)
    spectra = draw(made)
    report = calibrate(spectra, scene.simulation)
    assert {curve.status for curve in report.curves} == {CONVERGED}
    assert report.provenance.notes[FORM_OF_CHAIN].startswith("noise enters behind the antenna's resonance")
    # 8 paths share the events' gains, which move C alike at all frequencies
    assert np.sqrt(np.mean(pulls_of_c(made, report.curves) ** 2)) < 1.5
    published = fit_calibration(spectra, scene.simulation).curves
    assert np.sqrt(np.mean(pulls_of_c(made, published) ** 2)) > 5.0
    found = np.mean([one.parameters["n_amplifier"].value for one in report.curves])
    assert found == pytest.approx(0.05, rel=0.05)


def test_a_curve_predicts_power_by_the_form_it_was_fitted_with(scene):
    made = other_chain(scene, n_amplifier=0.05)
    curve = calibrate(draw(made), scene.simulation).curves[1]
    lst = np.linspace(0.0, 23.0, 12)
    expected = made.mean_power(scene.sky_power.at(curve.dipole, lst), "50")
    np.testing.assert_allclose(scene.simulation.background(curve, lst), expected, rtol=0.02)


def test_a_fit_is_continued_in_its_own_form(scene):
    spectra = draw(other_chain(scene, n_amplifier=0.05))
    simulation = scene.simulation.with_form(compare_forms(spectra, scene.simulation).name)
    whole = fit_calibration(spectra, simulation)
    kept = read_lines(write_lines(whole.lines))
    assert {one.form for one in kept} == {BEHIND}
    found = continue_fit(kept, spectra.select(np.zeros(len(spectra), dtype=bool)), scene.simulation)
    for curve in whole.curves:
        c, _, _ = found.curves[curve.path]
        # information is kept in single precision
        np.testing.assert_allclose(c, curve.c, rtol=1e-3)


def test_forms_that_the_data_leave_open_are_in_the_error_of_c(scene):
    """Little noise behind the resonance and few events: neither form is excluded, and C may be that of either."""
    spectra = draw(other_chain(scene, n_amplifier=0.002), events=150)
    found = compare_forms(spectra, scene.simulation)
    assert found.is_open(BEHIND)
    assert found.name == PUBLISHED
    report = calibrate(spectra, scene.simulation, "array")
    (budget,) = report.budgets.values()
    (term,) = [one for one in budget.terms if one.name == FORM_OF_CHAIN]
    published, behind, sloped = (
        fit_calibration(spectra, scene.simulation.with_form(form), "array").curves[0].c for form in FORMS
    )
    weights = found.probability
    between = weights[BEHIND] * np.log(behind / published) ** 2 + weights[SLOPED] * np.log(sloped / published) ** 2
    # principal axes leave out what adds 1e-4 of the variance
    np.testing.assert_allclose(term.variance("X"), between, rtol=1e-2, atol=2e-4 * between.max())
    assert "open" in term.source


def test_the_integral_over_lines_is_that_of_plain_least_squares():
    """Oracle: all of (s, q) fitted by the normal equations of the whole vector (s, b), whose determinant is the volume.

    Integrals over s and q add a factor that is the same at every N; so does the basis of H.
    """
    rng, channels = np.random.default_rng(4), 7
    root = rng.normal(size=(2 * channels, 2 * channels))
    covariance, design = root @ root.T, rng.uniform(0.5, 2.0, (channels, 2))
    measured, before = rng.normal(size=2 * channels), rng.uniform(0.0, 1.0, (5, channels))
    chi2, volume = integrate_lines(measured, covariance, before, design, np.ones(channels, dtype=bool))
    weight, expected = np.linalg.inv(covariance), []
    for noise in before:
        columns = np.block([[np.eye(channels), np.zeros((channels, 2))], [np.diag(noise), design]])
        normal = columns.T @ weight @ columns
        left = measured - columns @ np.linalg.solve(normal, columns.T @ weight @ measured)
        expected.append((left @ weight @ left, 0.5 * np.linalg.slogdet(normal)[1]))
    np.testing.assert_allclose(chi2, [one for one, _ in expected], rtol=1e-9)
    np.testing.assert_allclose(np.diff(volume), np.diff([two for _, two in expected]), rtol=1e-9, atol=1e-9)


def test_the_amounts_of_a_form_are_its_prior(scene):
    """The weights add to 1, the noise is not negative, and the half-normal mean is (2 / pi)^1/2 of the sky."""
    sky = scene.sky_power.power["X"].mean(axis=0)
    for form, terms in list_forms(scene.simulation).items():
        before, weight = list_amounts(form, terms, sky)
        assert logsumexp(0.0, b=weight) == pytest.approx(0.0)
        assert np.all(before >= 0.0)
        if form == PUBLISHED:
            size = np.sqrt(np.mean((before / sky) ** 2, axis=1))
            assert weight @ size == pytest.approx((2.0 / np.pi) ** 0.5, rel=0.05)


def test_stated_stages_and_a_gain_that_is_flat_are_no_hypotheses(scene):
    stages = (Stage("antenna", "antenna", None, None, is_free=True), Stage("adc", "adc", None, None, is_free=True))
    ones = np.ones(scene.instrument.frequency_mhz.size)
    stated = Simulation(replace(scene.instrument, stages=stages, receiver_gain=ones), scene.sky_power)
    assert list(list_forms(stated)) == [PUBLISHED]
    flat = replace(scene.instrument, antenna_gain=np.ones(scene.instrument.frequency_mhz.size))
    assert list(list_forms(Simulation(flat, scene.sky_power))) == [PUBLISHED, SLOPED]
    few = draw(scene, events=10)
    assert str(compare_forms(few, scene.simulation)).endswith("not compared with other forms")


def test_a_form_is_open_that_is_probable_or_that_the_data_do_not_exclude():
    """Of one to which little was given beforehand a small probability says nothing: sizes were 1.9 sigma low."""
    for published, behind, is_open in ((0.95, 0.02, True), (0.95, 0.002, False), (0.5, 0.06, True)):
        assert ChainForm({PUBLISHED: published, BEHIND: behind}).is_open(BEHIND) == is_open


def test_the_sentence_names_the_form_its_odds_and_what_is_open():
    told = str(ChainForm({PUBLISHED: 0.09, BEHIND: 0.9, SLOPED: 0.01}))
    assert told.startswith("noise enters behind the antenna's resonance, N / G_ant")
    assert "(10 to 1 against" in told
    assert told.endswith("open: noise enters in front of the antenna's resonance, as published")


@pytest.mark.parametrize("sky", ["lfsm", "gsm408"])
@pytest.mark.parametrize("seed", [5, 6])
def test_another_sky_than_the_believed_one_does_not_change_the_form(chain, seed, sky):
    """Twin, noise in front: a sky with another level and zero than the GSM's looks like noise of a kind."""
    truth = compute_sky_power(chain, sky)
    settings = TwinSettings(stations=("CS002",), antennas=4, events_per_year=500)
    spectra = simulate_campaign(settings, chain, truth, np.random.default_rng(seed)).spectra
    assert compare_forms(spectra, Simulation(chain)).name == PUBLISHED
