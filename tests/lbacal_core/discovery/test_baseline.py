from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.causes.cause import Template, signature, spectral_signature
from lbacal_core.discovery.baseline import fit_baseline
from lbacal_core.discovery.hypothesis import list_targets
from lbacal_core.discovery.refit import fit_chain
from lbacal_core.discovery.scan import FamilySpectra, batch_families, correlate, group_templates, list_families, overlap
from lbacal_core.discovery.station import model_modes
from lbacal_core.discovery.view import ChannelTemplates
from lbacal_core.sky.differences import compute_model_differences
from lbacal_twin.campaign import expected_power
from tests.lbacal_core.discovery.worlds import CALM, SILENT


@pytest.fixture(scope="module")
def silent(world):
    return world.with_settings(**SILENT, noise_level=0.0)


@pytest.fixture(scope="module")
def exact(silent):
    return silent.look()


def test_spectra_without_noise_leave_nothing_and_give_the_planted_constants(silent, exact):
    assert np.abs(exact.residual).max() < 1e-6
    truth = silent.station.truth
    planted = (truth.n_lna, truth.n_rcu, truth.n_adc)
    for k, name in enumerate(("n_lna", "n_rcu", "n_adc")):
        assert exact.noise_constants()[:, k] == pytest.approx(planted[k], rel=1e-4), name


def test_the_fitted_slope_is_the_planted_calibration_to_the_power_minus_two(silent, exact):
    planted = exact.arrange(silent.station.truth.c) ** -2 * silent.instrument.antenna_gain
    assert exact.slopes() == pytest.approx(planted, rel=1e-4)


def test_the_chain_of_the_mean_path_is_that_of_its_paths(silent, exact):
    planted = exact.arrange(expected_power(silent.station.stages, silent.station.scene, []))
    # The median of three gains that scatter by 4 %.
    assert exact.modelled_power() == pytest.approx(planted, rel=0.15)
    assert np.mean(exact.modelled_power() / planted) == pytest.approx(1.0, abs=0.04)


def test_constants_that_a_flat_receiver_does_not_tell_apart_add_up_to_what_is_recorded(world):
    """Each was taken for half of the error that it has alone: an ionosphere of 0.1 had a size of 0.120 ± 0.004."""
    flat = np.ones(world.instrument.frequency_mhz.size)
    noisy = replace(world, instrument=replace(world.instrument, receiver_gain=flat)).with_settings(
        **CALM, path_gain=0.0
    )
    look = noisy.look()
    assert np.all(look.model.baseline.solution.is_merged[:, 1:])
    planted = look.arrange(expected_power(noisy.station.stages, noisy.station.scene, []))
    assert look.modelled_power() == pytest.approx(planted, rel=0.02)


def test_a_level_that_comes_out_below_zero_is_taken_for_half_of_its_error(world):
    """As where somebody has taken the noise of the converter out of the spectra already, and a little more."""
    look = world.look()
    n_adc = np.median(look.noise_constants()[:, 2])
    less = fit_baseline(replace(look.data, power=look.data.power - 1.2 * n_adc))
    assert np.median(less.solution.q[:, 1]) < 0
    channels = less.solution.x.shape[1]
    error = np.sqrt(np.median(less.solution.covariance[:, channels + 2, channels + 2]))
    assert less.terms.adc_noise == pytest.approx(0.5 * error)


def test_a_cause_correlates_fully_with_itself_and_less_with_others(model):
    conditions = model.station.conditions
    targets = {target.label: target for target in list_targets(model.station)}
    named = {cause.identifier: cause for cause in CAUSES}
    drift, *others = (
        group_templates(conditions, named[name], named[name].templates(conditions))
        for name in ("gain_drift", "lst_offset", "rfi_line")
    )
    families = [*drift, *others[0], *others[1]]
    itself, other, *lines = overlap(model, named["gain_drift"], Template(), targets["station"], families)
    assert itself > 1 - 1e-6
    assert abs(other) < 0.5
    direct = correlate(model, [*drift, *others[0], others[1][7]], targets["station"])[0]
    np.testing.assert_allclose(np.concatenate([itself, other, lines[7]]), direct, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(correlate(model, drift, targets["antenna 2"]), [[1.0]], rtol=1e-9)


def test_a_template_that_the_fit_leaves_free_is_no_trial(model):
    """What rounding leaves of it was as long as 0.2 of a unit, and one trial more: 3 % of those of interference."""
    (cause,) = (cause for cause in CAUSES if cause.identifier == "gain_drift")
    (drift,) = group_templates(model.station.conditions, cause, cause.templates(model.station.conditions))
    constant = replace(drift, profiles=np.ones_like(drift.profiles))
    (target,) = (target for target in list_targets(model.station) if target.scope == "station")
    np.testing.assert_allclose(correlate(model, [drift, constant], target), np.diag([1.0, 0.0]), atol=1e-12)
    itself, free = overlap(model, cause, Template(), target, [drift, constant])
    assert itself > 1 - 1e-6
    assert free == 0.0


def test_spectral_templates_times_time_profiles_are_the_signatures_of_all_templates(model):
    conditions = model.station.conditions
    for family in list_families(conditions, CAUSES)[::7]:
        for k in (0, -1):
            template = family.templates[k]
            base = signature(family.cause, model.terms, conditions, family.templates[0])
            profile = family.cause.time_profile(conditions, template)
            first = family.cause.time_profile(conditions, family.templates[0])
            both = (profile[:, 0] != 0) & (first[:, 0] != 0)
            direct = signature(family.cause, model.terms, conditions, template)
            expected = base[:, both] / first[both] * profile[both]
            np.testing.assert_allclose(direct[:, both], expected, rtol=2e-3, atol=2e-5 * np.abs(direct).max())


def test_lines_are_one_spectrum_times_factors_and_are_the_signatures_of_each(model):
    conditions = model.station.conditions
    families = list_families(conditions, [cause for cause in CAUSES if cause.identifier == "rfi_line"])
    (batch,) = batch_families(conditions, families, model.station.power[0].size)
    spectra = FamilySpectra.of(model, batch)
    assert spectra.values.shape[0] == 1
    for k in (0, 7, -1):
        direct = spectral_signature(batch[k].cause, model.terms, conditions, batch[k].templates[0])
        np.testing.assert_allclose(spectra.whole[k], direct, rtol=1e-6, atol=1e-9)


@pytest.fixture(scope="module")
def views(station, world):
    """The means of the paths with a free sky, and the paths of a class: two rows with waves, one row without."""
    model = fit_chain(station).linear
    model = replace(model, modes=model_modes(station, compute_model_differences(world.instrument)))
    return model.common, model.paths[0]


@pytest.mark.parametrize("k", [0, 1])
def test_information_of_the_free_vectors_is_that_of_each_written_out(views, k):
    view = views[k]
    size = view.slope.shape[0] * view.slope.shape[2]
    amounts = np.eye(len(view.prior_information))
    seen = view.see(view.described(amounts[[0, size - 1, size, -1]]))
    direct = view.sum(seen.along, view.weight)
    whole = view.information_of_free(view.weight)
    np.testing.assert_allclose(direct, np.swapaxes(whole[:, [0, size - 1, size, -1]], 0, 1), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(whole, np.swapaxes(whole, 1, 2), rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("k", [0, 1])
def test_templates_in_channels_are_the_same_templates_written_out(views, k):
    view, rng = views[k], np.random.default_rng(1)
    rows, events, channels = view.slope.shape
    spectra, factors = rng.uniform(0.5, 1.0, (rows, events, channels)), rng.standard_normal((3, channels))
    profiles = (np.arange(events) % 5 < np.array([[2], [4]])).astype(float)
    shares = np.vstack([np.eye(rows), np.full((1, rows), 0.5)])
    lines = ChannelTemplates(spectra, np.arange(rows), shares, factors)
    alone = spectra * shares[:, :, None, None] * factors[:, None, None, None]
    seen = view.see(alone)
    for quick, direct in zip(view.inner(lines, profiles), view.inner(seen, profiles), strict=True):
        np.testing.assert_allclose(quick, direct, rtol=1e-6, atol=1e-9 * np.abs(direct).max())
    np.testing.assert_allclose(view.score(lines, profiles), view.score(seen, profiles), rtol=1e-9, atol=1e-9)
