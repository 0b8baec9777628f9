from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest, norm

from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.causes.cause import signature
from lbacal_core.discovery.hypothesis import list_targets, p_of, sigma_of, trials_factor
from lbacal_core.discovery.refit import fit_chain
from lbacal_core.discovery.scan import list_families, scan, score_families, score_in_means, score_in_path
from lbacal_core.discovery.station import gather_stations
from tests.lbacal_core.discovery.worlds import MOVING, p_value_of
from validation.anywhere import investigate_drawn


def test_scores_of_a_clean_station_are_not_significant(model):
    found = scan(model, CAUSES, list_targets(model.station))
    assert {score.cause.identifier for score in found} == set(MOVING)
    assert min(score.p_value for score in found) > 0.003


@pytest.mark.parametrize("label", ["station", "dipole Y of all antennas", "antenna 2", "antenna 2 X"])
def test_scores_of_many_equal_the_products_of_one(model, label):
    """The factorised scan against `LinearModel.products` of each best template by itself."""
    (target,) = (target for target in list_targets(model.station) if target.label == label)
    for score in scan(model, CAUSES, [target]):
        values = signature(score.cause, model.terms, model.station.conditions, score.template)
        (product,), ((information,),) = model.products([values], [target])
        # The scan leaves out what classes of a polarisation say against each other where it is little.
        assert score.z == pytest.approx(product / information**0.5, rel=1e-2, abs=0.01)
        assert score.events == model.station.event_id.size


def test_targets_score_together_as_each_does_alone(model):
    """Targets of which the means show the same are scored as one, and every target gets its own score."""
    causes = [cause for cause in CAUSES if cause.identifier in {"rfi_line", "dipole_swap"}]
    families, targets = list_families(model.station.conditions, causes), list_targets(model.station)
    together = score_families(model, families, targets)
    for t in (
        k
        for k, target in enumerate(targets)
        if target.label in {"antenna 0", "antenna 3", targets[-2].label, "station"}
    ):
        for (_, z, size), (_, own_z, own_size) in zip(
            together, score_families(model, families, targets[t : t + 1]), strict=True
        ):
            np.testing.assert_allclose(z[:, t], own_z[:, 0], rtol=1e-6, atol=1e-6)
            np.testing.assert_allclose(size[:, t], own_size[:, 0], rtol=1e-6, atol=1e-9)


DRAWS = 500
STATION_CAUSES = ("gain_step", "filter_shift", "lst_offset", "solar_emission", "lna_noise_slope", "rfi_broadband")
LOCAL_CAUSES = ("gain_step", "gain_drift", "gain_temperature", "compression", "lst_offset")


def drawn_scores(look, effects, seed):
    """Score vectors of noise, shape (draw, effect): normal, with the covariance that the scores have."""
    values, vectors = np.linalg.eigh(look.covariance_of_scores(effects))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.random.default_rng(seed).standard_normal((DRAWS, len(effects))) @ root.T


@pytest.fixture(scope="module")
def small(world):
    return world.with_settings(antennas=2, events_per_year=100).look()


def largest(look, causes, labels, seed):
    """Best score of each cause in every draw, and the score of the scan that says how it is corrected."""
    effects = look.effects(causes, labels)
    drawn = np.abs(drawn_scores(look, effects, seed))
    of_cause = np.array([cause for cause, *_ in effects])
    scores = {score.cause.identifier: score for score in look.scan(causes, labels)}
    assert set(scores) == set(causes)
    return {cause: drawn[:, of_cause == cause].max(axis=1) for cause in causes}, scores


SEARCHES = [
    (STATION_CAUSES, ["station"]),
    (LOCAL_CAUSES, ["station", "antenna 0", "antenna 1", "antenna 0 X", "antenna 1 Y"]),
]


@pytest.mark.long
@pytest.mark.parametrize(("causes", "labels"), SEARCHES)
def test_corrected_probabilities_of_noise_are_uniform(causes, labels, small):
    """The smallest corrected probability of each of 500 drawn scans, over all causes, is as rare as it says."""
    best, scores = largest(small, causes, labels, seed=1)
    p = np.min([[p_value_of(scores[cause], z) for z in best[cause]] for cause in causes], axis=0)
    # Causes are taken for independent, and are not quite: the probabilities are a little too large, never too small.
    assert kstest(p, "uniform").statistic < 0.12  # 0.06 is what 500 draws leave (95 %)
    assert np.mean(p < 0.1) == pytest.approx(0.1, abs=0.04)  # 3 standard deviations of 500 draws
    assert np.mean(p < 0.1) < 0.1 + 0.03


@pytest.mark.long
@pytest.mark.parametrize(("causes", "labels"), SEARCHES)
def test_the_trials_of_a_cause_are_those_of_its_own_templates_and_targets(causes, labels, small):
    best, scores = largest(small, causes, labels, seed=2)
    for cause in causes:
        share = np.mean([p_of(z, scores[cause].trials) < 0.1 for z in best[cause]])
        assert share == pytest.approx(0.1, abs=0.055), cause  # 4 standard deviations; 90 % quantile of 2000 draws: 7 %


def test_every_cause_looked_for_has_the_same_right_to_a_false_alarm(small):
    scores = small.scan(["gain_drift", "lst_offset", "gain_step"], ["station"])
    alone = {s.cause.identifier: s for name in ("gain_drift", "lst_offset", "gain_step") for s in small.scan([name])}
    for score in scores:
        own = 1.0 - (1.0 - p_of(4.5, score.trials)) ** 3
        assert p_value_of(score, 4.5) == pytest.approx(own, rel=1e-3)
        assert p_value_of(score, 4.5) == p_value_of(score, -4.5)
    assert alone["gain_step"].trials > 3 * alone["gain_drift"].trials


def test_a_local_cause_has_the_trials_of_each_of_its_targets(small):
    """Scores of different antennas are independent: 9 targets are 9 trials of a cause with one template."""
    (station,) = small.scan(["gain_drift"], ["station"])
    (everywhere,) = small.scan(["gain_drift"])
    assert station.trials == pytest.approx(1.0)
    # 4 paths, 2 antennas, 2 dipoles, the station.
    assert everywhere.trials == pytest.approx(9.0)


def test_gaps_in_the_weather_take_no_trials_away(small):
    """Temperature is missing at other events than rain: what follows one, the other or neither counts all the same."""
    whole = {score.cause.identifier: score for score in small.scan(["resonance_shift"], ["station"])}
    events = np.arange(small.data.event_id.size)
    covariates = small.data.conditions.covariates
    gaps = small.data.conditions.with_covariates(
        temperature_c=np.where(events % 10 == 0, np.nan, covariates["temperature_c"]),
        rain_mm_h=np.where(events % 10 == 5, np.nan, covariates["rain_mm_h"]),
    )
    data = replace(small.data, conditions=gaps)
    linear = replace(small.model.linear, station=data)
    (score,) = replace(small, data=data, model=replace(small.model, linear=linear)).scan(
        ["resonance_shift"], ["station"]
    )
    # At most as many more as the groups overlap in what they try; each factor is simulated to 7 %.
    assert 0.8 < score.trials / whole["resonance_shift"].trials < 2.0


def test_a_line_is_looked_for_in_every_channel_and_each_is_a_trial(small):
    """Two widths a channel, and windows of hours that overlap: more than the channels, fewer than the templates."""
    (line,) = small.scan(["rfi_line"], ["station"])
    templates = len(small.templates("rfi_line"))
    assert templates == 51 * 2 * 49
    assert 51 * 5 < line.trials < templates


PAIRS = [("gain_temperature", "lna_noise_temperature"), ("zenith_weighting", "pattern_width")]


@pytest.mark.parametrize(("one", "other"), [*PAIRS, *(pair[::-1] for pair in PAIRS)])
def test_causes_with_nearly_the_same_signature_are_named_together_until_they_are_strong(one, other, world):
    look = world.look()
    template = look.template(one)
    at_six = look.similar_to(one, template, 6.0)
    assert at_six[other] > 0.97
    assert 36.0 * (1.0 - at_six[other] ** 2) < 9.0
    assert other not in look.similar_to(one, template, 40.0)
    assert not {"lst_offset", "dipole_swap", "adc_jitter", one} & set(at_six)


def test_a_step_of_one_antenna_looks_like_a_drift_until_the_data_exclude_it_and_not_like_the_sky(world):
    """Effects of 40 sigma: templates alike to 0.99 leave 6 of them, and noise adds none."""
    look = world.look()
    template = look.template("gain_step", date_unix=float(np.median(look.data.conditions.time_unix)))
    found = look.similar_to("gain_step", template, 5.0, "antenna 1")
    assert "gain_drift" in found
    assert not {"lst_offset", "zenith_weighting", "rfi_broadband"} & set(found), "nobody's own: they are the station's"
    assert "gain_drift" not in look.similar_to("gain_step", template, 40.0, "antenna 1")


def test_the_last_spectrum_of_an_antenna_before_it_dies_is_no_step(clean, simulation):
    """The mean of the paths was counted at events where the antenna had no spectra: z of noise became 4.6, and 7."""
    events, event = np.unique(clean.time_unix, return_inverse=True)
    from_last = events.size - event
    is_gone = (clean.antenna == 2) & (from_last <= 18) & (from_last != 9)
    model = fit_chain(gather_stations(clean.select(~is_gone), simulation)[0]).linear
    targets = [target for target in list_targets(model.station) if target.label.startswith("antenna 2")]
    steps = [cause for cause in CAUSES if cause.identifier in {"gain_step", "adc_noise_step"}]
    assert min(score.p_value for score in scan(model, steps, targets)) > 0.1


def test_independent_scores_count_each_and_equal_ones_count_once():
    assert 38 < trials_factor(np.eye(50), seed=1) < 64  # the 90 % quantile of 2000 draws: 7 % of 10 %
    assert trials_factor(np.ones((50, 50)), seed=1) < 1.3


def test_templates_of_which_the_data_show_nothing_count_once():
    """A sky file whose LST was 6 h off left no information on any template, and the search ended in an error."""
    assert trials_factor(np.zeros((5, 5)), seed=1, level=4.0) == 1.0


def test_steps_at_many_dates_are_more_trials_at_a_high_score_than_at_a_low_one():
    """The factor of a low score was taken for all: steps at 5 sigma had half the probability that they have."""
    share = np.arange(1, 200) / 200
    after, before = np.maximum.outer(share, share), np.minimum.outer(share, share)
    steps = np.sqrt(before * (1 - after) / (after * (1 - before)))
    rng = np.random.default_rng(2)
    chance = np.zeros(2)
    root = np.linalg.cholesky(steps + 1e-9 * np.eye(len(steps)))
    for _ in range(20):
        largest = np.abs(rng.standard_normal((4000, len(steps))) @ root.T).max(axis=1)
        chance += [np.mean(largest > 3.2) / 20, np.mean(largest > 4.2) / 20]
    trials = [trials_factor(steps, seed=1, level=level) for level in (3.2, 4.2)]
    assert p_of(3.2, trials[0]) == pytest.approx(chance[0], rel=0.15)
    assert p_of(4.2, trials[1]) == pytest.approx(chance[1], rel=0.25)  # 170 draws beyond: 8 %
    assert trials[1] > 1.3 * trials_factor(steps, seed=1)


def test_the_last_digits_of_correlations_do_not_move_the_trials_factor():
    """Equal eigenvalues have no eigenvectors of their own: draws along them moved it by up to 17 %."""
    correlation = np.kron(np.eye(12), 0.7 * np.ones((4, 4)) + 0.3 * np.eye(4))
    noise = 1e-12 * np.random.default_rng(3).standard_normal(correlation.shape)
    moved = trials_factor(correlation + noise + noise.T, seed=1)
    np.testing.assert_allclose(moved, trials_factor(correlation, seed=1), rtol=1e-6)


def test_probability_and_sigma_are_each_others_inverse():
    np.testing.assert_allclose(p_of(5.0, 1.0), 2 * norm.sf(5.0), rtol=1e-6)
    np.testing.assert_allclose(sigma_of(p_of(4.2, 1.0)), 4.2, rtol=1e-5)  # 1e-5 is what erfcinv keeps of p


def test_a_rival_that_describes_these_data_better_is_listed_though_more_templates_were_tried():
    """A step seen at 8.0 sigma, and at 7.9 as a drift, was a drift alone: a date is scanned and a rate is not."""
    row = investigate_drawn(25)
    assert row["named"], row["said"]
    assert row["others"] == 0


def test_the_means_alone_score_nearly_as_the_station(model):
    conditions, whole = model.station.conditions, [one for one in list_targets(model.station) if one.has_all_antennas]
    assert [one.scope for one in whole] == ["dipole", "dipole", "station"]
    for target, name in [*((one, "gain_step") for one in whole), (whole[-1], "solar_emission")]:
        families = list_families(conditions, [one for one in CAUSES if one.identifier == name])
        exact = score_families(model, families, [target])
        for (_, z, size), (_, alone, size_alone) in zip(exact, score_in_means(model, families, target), strict=True):
            assert alone.shape == z.shape
            np.testing.assert_allclose(alone, z, atol=0.5)
            np.testing.assert_allclose(alone / size_alone, z / size, rtol=0.15)


def test_one_path_alone_scores_nearly_as_beside_the_means(model):
    """The mean of a station knows a sixteenth of what one of its paths shows."""
    conditions, everyone = model.station.conditions, list_targets(model.station)
    (cause,) = [one for one in CAUSES if one.identifier == "gain_step"]
    families = list_families(conditions, [cause])
    for path, target in [(k, one) for k, one in enumerate(everyone) if one.scope == "path"][:3]:
        ((_, z, size),) = score_families(model, families, [target])
        ((_, alone, size_alone),) = score_in_path(model, families, path)
        assert alone.shape == z.shape
        assert np.corrcoef(alone.ravel(), z.ravel())[0, 1] > 0.95
        np.testing.assert_allclose(alone / size_alone, z / size, rtol=0.15)
