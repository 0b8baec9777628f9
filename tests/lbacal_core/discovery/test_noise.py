from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from lbacal_core.causes.cause import RAIN
from lbacal_core.discovery.baseline import fit_baseline
from lbacal_core.discovery.noise import (
    HEAVY,
    STANDS_OUT,
    NoiseLevels,
    _beyond,
    _choose_vectors,
    _scatter,
    beyond_noise,
    find_memory_of_gains,
    is_heavy,
    list_kinds,
    split_residuals,
    with_memory,
)
from lbacal_core.discovery.project import LARGEST, EventGains

FLAT = np.ones((1, 51))
NU = np.linspace(-1.0, 1.0, 51)
"""Frequency from end to end of the band."""
THREE = np.stack([np.ones(51), 1.0 - 0.5 * NU**2, np.exp(-0.5 * (NU / 0.2) ** 2) * NU])
"""A gain behind everything, one in front of the noise of the receiver, and a resonance that moves."""


def test_the_levels_of_known_noise_are_found(station, noise):
    levels = split_residuals(station, noise, FLAT).levels
    assert abs(levels.path_channel / 0.044 - 1) < 0.02  # 1/sqrt(2 x 16 paths x 300 events x 50) is 0.15 %
    # a vector of 51 channels: its amount is root 51 times the gain
    assert abs((levels.mean_path_shared[0, 0, 0] / 51) ** 0.5 / 0.04 - 1) < 0.05  # the median of 16 paths
    assert abs((levels.common_sum[0, 0, 0] / 51) ** 0.5 / (0.03 * 2**0.5) - 1) < 0.15  # 300 events: 4 %, and the paths
    assert (levels.common_difference[0, 0, 0] / 51) ** 0.5 < 0.008
    np.testing.assert_allclose(levels.path_scale, 1.0)


def split_damaged(station, noise, *lost):
    """Residuals of a station that lacks some spectra, each an index of paths and events."""
    relative_variance = station.relative_variance.copy()
    for at in lost:
        relative_variance[at] = np.inf
    damaged = replace(station, relative_variance=relative_variance)
    return split_residuals(damaged, noise * damaged.is_present[:, :, None], FLAT)


def test_a_dead_antenna_leaves_the_mean_but_is_still_compared_with_it(station, noise):
    dead = station.antenna == station.antenna[0]
    residuals = split_damaged(station, noise, np.ix_(dead, np.arange(100, 300)))
    assert not np.any(residuals.in_mean[dead])
    assert np.all(residuals.in_mean[~dead])
    assert np.all(residuals.deviation[dead][:, 100:] == 0.0)
    assert np.all(residuals.deviation[dead][:, :100] != 0.0)


def test_an_antenna_apart_is_no_measure_of_others(station, noise):
    apart = station.antenna == station.antenna[0]
    odd = noise + apart[:, None, None] * np.where(np.arange(300) % 40 < 20, 0.2, -0.2)[:, None]
    aside = replace(station, apart=frozenset({int(station.antenna[0])}))
    residuals, quiet = split_residuals(aside, odd, FLAT), split_residuals(aside, noise, FLAT)
    assert np.array_equal(residuals.in_mean, ~apart)
    np.testing.assert_array_equal(residuals.mean, quiet.mean)
    assert np.all(residuals.deviation[apart] != 0.0)


def test_an_antenna_that_dies_in_the_last_days_leaves_the_mean_and_one_with_gaps_does_not(station, noise):
    late, gappy = station.antenna == station.antenna[0], station.antenna == station.antenna[-1]
    gaps = np.random.default_rng(5).choice(300, 45, replace=False)
    in_mean = split_damaged(station, noise, np.ix_(late, np.arange(275, 300)), np.ix_(gappy, gaps)).in_mean
    assert not np.any(in_mean[late])
    assert np.all(in_mean[~late])


def test_a_noisy_path_gets_its_own_scale(station, noise):
    louder = noise.copy()
    louder[3] *= 2.0
    residuals = split_residuals(station, louder, FLAT)
    scale = residuals.levels.path_scale
    assert abs(scale[3] - 2.0) < 0.2  # its own share of the mean is taken out of it
    # the mean of eight paths, one of them with four times the variance
    own = residuals.polarisations == station.dipole[3]
    assert np.mean(residuals.spread[own]) == pytest.approx((7 + 4) / 8**2, rel=0.1)
    assert np.mean(residuals.spread[~own]) == pytest.approx(1 / 8, rel=0.1)
    np.testing.assert_allclose(np.delete(scale, 3), 1.0, atol=0.06)


def test_gains_with_a_shape_along_frequency_are_found_for_the_means_and_for_paths(station, noise):
    """Only a gain flat in frequency was noise; any other was structure, or a name."""
    flat = noise - noise.mean(axis=2, keepdims=True)
    of_path, of_mean = [], []
    for seed in range(8):  # one draw knows the variance of the means to a third
        rng = np.random.default_rng(seed)
        front = 0.04 * rng.standard_normal((*noise.shape[:2], 1)) * THREE[1]
        moved = 0.02 * rng.standard_normal((1, noise.shape[1], 1)) * THREE[2]
        levels = split_residuals(station, flat + front + moved, THREE).levels
        of_path.append(np.diag(levels.vectors.T @ levels.of_all(levels.mean_path_shared) @ levels.vectors))
        of_mean.append(np.diag(levels.vectors.T @ levels.of_all(levels.common_sum) @ levels.vectors / 2))
    assert np.sqrt(np.mean(of_path, axis=0)) == pytest.approx(0.04 * THREE[1], rel=0.1)
    found = np.sqrt(np.mean(of_mean, axis=0))[18:21]
    assert found == pytest.approx(0.02 * np.abs(THREE[2, 18:21]), rel=0.3)


def test_what_follows_an_axis_is_structure_and_no_noise_that_events_share(station, noise):
    """A wave along LST that most events have was taken for a vector of their noise, and nothing was left to find."""
    wave = np.cos(2 * np.pi * station.conditions.lst_hours / 24)[None, :, None] * THREE[2]
    still = split_residuals(station, noise, THREE).levels
    levels = split_residuals(station, noise + 0.02 * wave, THREE).levels
    assert np.trace(levels.common_sum[0]) < 2 * np.trace(still.common_sum[0]) + 1e-6


@pytest.mark.parametrize("on", ["since", "between", "hours", "at random"])
def test_interference_that_begins_or_ends_is_structure_and_what_comes_at_random_is_noise(station, noise, on):
    """15 % in three channels since a date were a vector of the noise, and what was left of them a ripple."""
    day = np.ptp(station.conditions.time_unix) * 0.5 + station.conditions.time_unix.min()
    utc = station.conditions.utc_hours
    amount = {
        "since": station.conditions.time_unix > day,
        "between": np.abs(station.conditions.time_unix - day) < 60 * 86400.0,
        "hours": (utc > 6.0) & (utc < 15.0),
        "at random": np.random.default_rng(4).exponential(1.0, utc.size),
    }[on]
    relative = 1.0 + 0.3 * np.cos(2.0 * np.pi * station.conditions.lst_hours / 24.0)
    line = 0.15 * np.isin(np.arange(noise.shape[2]), (8, 21, 36)) * (amount * relative)[:, None]
    flat = np.ones((1, noise.shape[2])) / noise.shape[2] ** 0.5
    vectors = split_residuals(station, noise + line, flat).levels.vectors
    assert len(vectors) == (2 if on == "at random" else 1)


def test_what_most_events_share_is_noise_and_what_a_few_have_is_not(station, noise):
    rng = np.random.default_rng(6)
    shape, events = np.sin(9 * NU), noise.shape[1]
    often = noise + 0.02 * rng.standard_normal((1, events, 1)) * shape
    burst = noise + 0.12 * (np.arange(events) % 36 == 0)[:, None] * shape
    seeds = np.concatenate([FLAT, NU[None]])
    in_often, in_burst = (split_residuals(station, one, seeds).levels.vectors for one in (often, burst))
    along = [np.linalg.norm(vectors @ shape) / np.linalg.norm(shape) for vectors in (in_often, in_burst)]
    by_seeds = np.linalg.norm(np.linalg.qr(seeds.T)[0].T @ shape) / np.linalg.norm(shape)
    assert along[0] > 0.9
    assert along[1] == pytest.approx(by_seeds, abs=0.05)


def test_levels_are_at_most_three_vectors(station, noise):
    seeds = np.concatenate([THREE, NU[None]])
    levels = split_residuals(station, noise, seeds).levels
    assert levels.vectors.shape == (3, 51)
    assert np.linalg.matrix_rank(levels.common_sum[0]) <= 3


def test_bursts_in_a_few_events_do_not_count_as_noise(station, noise):
    """Lightning in six events of a hundred made its own level, and the search said "consistent"."""
    is_hit = (np.arange(noise.shape[1]) % 16 == 0)[None, :, None]
    still, burst = (split_residuals(station, one, THREE).levels for one in (noise, noise + 0.2 * is_hit * THREE[1]))
    assert np.trace(burst.common_sum[0]) == pytest.approx(np.trace(still.common_sum[0]), rel=0.15)


def test_gains_that_all_paths_share_leave_nothing_in_the_deviations_of_those_that_show_more(station, noise):
    """Paths on one cable name moved together, and a step of one that nobody had hidden was named at 5.4 sigma."""
    rng = np.random.default_rng(11)
    classes = len(station.conditions.dipoles)
    share = np.array([1.0 - 0.2 * (name == "115") for name in station.conditions.cables])[:, None]
    seeds = np.stack([np.ones((classes, 51)), share * THREE[1], share * THREE[2]], axis=1)
    gain, shift = 0.03 * rng.standard_normal((1, 300, 1)), 0.03 * rng.standard_normal((1, 300, 1))
    own = 0.04 * rng.standard_normal((*noise.shape[:2], 1)) * seeds[station.class_of, 1][:, None]
    common = gain * seeds[station.class_of, 1][:, None] + shift * seeds[station.class_of, 2][:, None]
    still, residuals = (
        split_residuals(station, 0.5 * (noise - noise.mean(axis=2, keepdims=True)) + own + one, seeds)
        for one in (0.0, common)
    )
    long = np.array(station.conditions.cables)[station.class_of] == "115"
    taken = residuals.taken[long].mean(axis=0)
    truth = (residuals.deviation + residuals.taken - still.deviation - still.taken)[long].mean(axis=0)
    # the mean of a polarisation has gains of eight paths, 1.4 % beside 3 %, and what follows an axis stays
    assert np.std(truth - taken) < 0.6 * np.std(truth)
    # those on the long cable show less of their own gains, too
    one, other = (
        levels.vectors.T @ levels.path_shared[0, c] @ levels.vectors
        for levels in [residuals.levels]
        for c in (int(station.class_of[long][0]), int(station.class_of[~long][0]))
    )
    assert np.trace(one) / np.trace(other) == pytest.approx(0.64, rel=0.15)


def _levels(station, residual, rain):
    conditions = replace(station.conditions, covariates={**station.conditions.covariates, RAIN: 1.0 * rain})
    return split_residuals(replace(station, conditions=conditions), residual, THREE).levels


@pytest.mark.parametrize("spell", [5, 25])
def test_events_in_rain_have_levels_of_their_own(station, noise, spell):
    """A resonance that moves in rain alone was structure in single events, and once a cause that follows rain.

    Where fewer than 40 events were wet they were weighed as dry ones: interference and the Sun were named.
    """
    wet = np.arange(noise.shape[1]) % spell == 0
    moved = 0.6 * np.random.default_rng(9).standard_normal((1, noise.shape[1], 1)) * wet[:, None] * THREE[2]
    levels = _levels(station, noise + moved, wet)
    np.testing.assert_array_equal(levels.kind_of, wet)
    dry, rainy = (np.diag(levels.vectors.T @ one @ levels.vectors).max() for one in levels.common_sum)
    assert rainy > 4 * dry


def test_a_few_events_in_rain_are_weighed_as_the_others_where_they_are_alike_but_for_a_burst(station, noise):
    wet = np.arange(noise.shape[1]) % 25 == 0
    burst = noise + 2.0 * (np.arange(noise.shape[1]) == 50)[:, None] * THREE[2]
    for residual in (noise, burst):
        assert not np.any(_levels(station, residual, wet).kind_of)


@pytest.mark.parametrize("spell", [5, 20])
def test_a_resonance_that_moves_with_the_millimetres_of_rain_is_no_noise(station, noise, spell):
    """It made events in rain a kind of their own, whose noise took half of its score."""
    rng = np.random.default_rng(4)
    rain = np.where(np.arange(noise.shape[1]) % spell == 0, rng.exponential(1.5, noise.shape[1]), 0.0)
    moved = 0.2 * rain[:, None] * THREE[2]
    still, levels = (_levels(station, one, rain) for one in (noise, noise + moved))
    np.testing.assert_array_equal(levels.kind_of, still.kind_of)
    along = levels.vectors @ THREE[2] / np.linalg.norm(THREE[2])
    # what moves has a variance of 0.4 in rain, and the noise of the means none along this vector
    assert max(along @ one @ along for one in levels.common_sum) < 1e-3


def test_what_does_not_follow_rain_keeps_its_variance(station):
    """Three ways to follow rain describe a part of the noise of 60 events; the rest is scaled."""
    rng = np.random.default_rng(6)
    events = station.power.shape[1]
    rain = np.where(np.arange(events) % 5 == 0, rng.exponential(1.5, events), 0.0)
    conditions = replace(station.conditions, covariates={**station.conditions.covariates, RAIN: rain})
    amount = rng.standard_normal((400, events, 2))
    kinds = list_kinds(replace(station, conditions=conditions), amount[0])
    left = kinds.beside_rain(amount)
    np.testing.assert_array_equal(left[:, rain == 0], amount[:, rain == 0])
    assert np.mean(left[:, rain > 0] ** 2) == pytest.approx(1.0, abs=0.03)
    followed = amount + rain[:, None] * [2.0, -1.0] + np.tanh(rain)[:, None]
    np.testing.assert_allclose(kinds.beside_rain(followed), left, atol=1e-9)


def test_normal_amounts_keep_their_covariance_and_hardly_any_is_heavy():
    rng = np.random.default_rng(8)
    truth = np.array([[2.0, 0.6, 0.0], [0.6, 1.0, 0.1], [0.0, 0.1, 0.1]])
    amount = rng.multivariate_normal(np.zeros(3), truth, 20_000)
    assert is_heavy(amount).mean() == pytest.approx(HEAVY, abs=5 * (HEAVY / 20_000) ** 0.5)
    np.testing.assert_allclose(_scatter(amount), truth, atol=0.05)


def test_noise_has_no_vector_of_its_own_and_a_vector_beyond_noise_stands_out():
    rng = np.random.default_rng(5)
    largest = [np.linalg.eigvalsh(x.T @ x)[-1] for x in rng.standard_normal((200, 300, 48))]
    units = np.array([beyond_noise(float(value), 300, 48) for value in largest])
    assert np.mean(units) == pytest.approx(-1.2, abs=0.4)  # the law's mean is -1.21 and its spread 1.27
    assert np.sum(units > STANDS_OUT) <= 2
    strong = rng.standard_normal((300, 48)) + 1.2 * rng.standard_normal((300, 1)) * np.eye(48)[0]
    assert beyond_noise(float(np.linalg.eigvalsh(strong.T @ strong)[-1]), 300, 48) > STANDS_OUT


def test_the_noise_of_an_event_has_at_most_three_vectors():
    found = _beyond(np.diag([4.0, 3.0, 2.0, 1.5]), 0.5)
    np.testing.assert_allclose(np.diag(found), [3.5, 2.5, 1.5, 0.0])


def test_lines_of_interference_make_no_vector_of_the_noise():
    """Lines left in a fifth of the events, two in one channel, were a vector, along which they lie on one side."""
    rng = np.random.default_rng(7)
    events, channels = 760, 51
    seed = np.ones((1, channels)) / channels**0.5
    noise = rng.standard_normal((2, events, channels)) + 20.0 * rng.standard_normal((events, 1)) * seed
    line = np.zeros((events, channels))
    line[rng.choice(events, 150, replace=False), rng.integers(channels, size=150)] = rng.exponential(2.5, 150)
    line[[100, 500], 5] = 14.0
    tilt = rng.standard_normal((events, 1)) * np.cos(9 * np.linspace(-1, 1, channels)) / 5.0**0.5
    everyone = [np.arange(events)]

    def choose(mean):
        return _choose_vectors(mean, seed, everyone, 1.0, lambda amount, _: (0.0, amount[None]))[0]

    assert len(choose(noise + line)) == 1
    assert len(choose(noise + tilt)) == 2
    # Beside cut lines a vector that is not orthogonal to the others gave information below 0, and scores of 18 sigma.
    chosen = choose(noise + tilt + np.abs(line))
    np.testing.assert_allclose(chosen @ chosen.T, np.eye(2), atol=1e-12)


@pytest.mark.parametrize("wet", [38, 64])
def test_what_follows_rain_is_as_rare_as_noise_known_from_a_few_wet_events_makes_it(wet):
    """Noise of wet events that counted as exact made structure along rain five to twenty times too probable."""
    rng = np.random.default_rng(11)
    vectors = np.eye(51)[:3]
    kind_of = (np.arange(700) < wet).astype(np.int64)
    nothing = np.zeros((2, 3, 3))
    levels = NoiseLevels(
        vectors,
        kind_of,
        1.0,
        nothing[:, None],
        np.ones(1),
        np.ones(1),
        np.zeros(2),
        nothing,
        nothing,
        *nothing[:1],
        *nothing[:1],
        *nothing[:1],
    )
    draws = 100_000
    gain = rng.chisquare(6, draws)
    for _ in range(2):  # means of three amounts of each polarisation, over their scatter in as many events
        gain += wet * 3 / (wet - 3) * rng.f(3, wet - 3, draws)
    for p in (1e-2, 1e-3, 2e-4):
        one_in = float(np.quantile(gain, 1.0 - p))
        assert levels.chance_of_gain(one_in, 12, kind_of[None] * 1.0, 6) == pytest.approx(p, rel=0.45)
    assert levels.chance_of_gain(one_in, 12, np.ones((1, 700)), 6) < 0.4 * p  # in all events noise is known


@pytest.fixture(scope="module")
def terms(station):
    return fit_baseline(station).terms


def test_a_resonance_moves_by_the_curve_that_was_fitted_not_by_that_of_the_instruments_table(station, terms):
    """A(nu) has structure: the table's slopes were off by a third, and what they left was an alarm."""
    nu = station.conditions.frequency_mhz
    structure = 0.1 * np.sin(2 * np.pi * nu / 9.0)
    plain, changed = (EventGains.of(station, replace(terms, front=terms.front * f)) for f in (1.0, np.exp(structure)))
    np.testing.assert_allclose(changed.slope - plain.slope, CubicSpline(nu, structure)(nu, 1), atol=1e-9)
    assert changed.vectors.shape == (len(station.conditions.dipoles), 3, nu.size)


@pytest.fixture(scope="module")
def moved(station, terms):
    """Gains, residuals of events whose resonance jitters by 0.4 MHz and their gain in front by 3 %, and the jitter."""
    rng = np.random.default_rng(12)
    nu, events = station.conditions.frequency_mhz, station.power.shape[1]
    resonance = -0.5 * ((nu - 55.0) / 6.0) ** 2
    conditions = station.conditions
    # a chain with a resonance of a known form
    flat = conditions.receiver_gain * np.exp(conditions.cable_log_loss[:, None, :])
    level = terms.front.mean() / flat.mean()
    gains = EventGains.of(station, replace(terms, front=level * flat * np.exp(resonance)))
    shift, gain = 0.4 * rng.standard_normal((events, 1)), 0.03 * rng.standard_normal((events, 1))
    of_events = -0.5 * ((nu - shift - 55.0) / 6.0) ** 2 - resonance
    change = gains.front * ((1.0 + gain) * np.exp(of_events) - 1.0)
    noise = 0.044 * rng.standard_normal(station.power.shape)
    return gains, change[station.class_of] + noise, shift[:, 0]


def test_what_a_resonance_that_moves_does_on_average_is_known_from_how_far_it_moves(station, moved):
    """A resonance that jitters in rain is wider on average, and was named as widening with rain."""
    gains, residual, shift = moved
    residuals = split_residuals(station, residual, gains.vectors)
    beyond = gains.beyond_first_order(station, residuals, residuals.mean)
    front = gains.front.mean(axis=0)
    truth = front * (gains.lower_by(-shift) + gains.slope * shift[:, None])
    template = front.mean(axis=0) * (gains.lower_by(np.array(0.4)) + gains.lower_by(np.array(-0.4)))
    of_beyond, of_truth = (values @ template for values in (beyond, truth))
    assert np.mean(of_beyond) == pytest.approx(np.mean(of_truth), rel=0.25)
    assert np.corrcoef(of_beyond, of_truth)[0, 1] > 0.7  # each event's shift is known to half of it


def test_gains_far_larger_than_the_noise_leave_no_error_that_is_not_a_number(station, moved):
    """A fit that ran away ended in `Eigenvalues did not converge`: a variance was a rounding error below 0."""
    gains, residual, _ = moved
    residuals = split_residuals(station, residual, gains.vectors)
    shape, rng = residuals.levels.common_sum.shape, np.random.default_rng(14)
    for _ in range(20):
        root = 1e4 * rng.standard_normal((shape[1], shape[1]))
        shared = np.broadcast_to(root @ root.T, shape)
        quiet = replace(residuals.levels, common_sum=shared, path_shared=np.zeros_like(residuals.levels.path_shared))
        beyond = gains.beyond_first_order(station, replace(residuals, levels=quiet), residuals.mean)
        assert np.all(np.isfinite(beyond))


def test_a_burst_is_no_gain_however_strong_it_is(station, moved):
    gains, residual, _ = moved
    burst = residual.copy()
    burst[:, 7] += 3.0
    still, beyond = (
        gains.beyond_first_order(station, split, split.mean)[7]
        for split in (split_residuals(station, one, gains.vectors) for one in (residual, burst))
    )
    assert np.abs(beyond - still).max() < 0.01 * LARGEST


def test_a_shift_of_more_than_a_channel_is_known_where_the_curve_has_structure(station, terms):
    """One event of heavy rain moved by 1.3 MHz, and the resonance was named as following rain."""
    rng = np.random.default_rng(13)
    nu, events = station.conditions.frequency_mhz, station.power.shape[1]
    rough = replace(terms, front=terms.front * np.exp(0.01 * rng.standard_normal(nu.size)))
    gains = EventGains.of(station, rough)
    shift = 0.3 * rng.standard_normal(events)
    shift[7] = 1.3
    change = gains.front * gains.lower_by(-shift)
    residual = change[station.class_of] + 0.044 * rng.standard_normal(station.power.shape)
    residuals = split_residuals(station, residual, gains.vectors)
    beyond = gains.beyond_first_order(station, residuals, residuals.mean)[7]
    truth = (gains.front.mean(axis=0) * (gains.lower_by(-shift) + gains.slope * shift[:, None]))[7]
    assert np.std(beyond - truth) < 0.4 * np.std(truth)  # 0.8 after one round


def test_beyond_the_band_the_slopes_of_its_ends_continue(station, terms):
    gains = EventGains.of(station, terms)
    far = np.log1p(gains.lower_by(np.array([3.0, 6.0])))[:, -1]
    np.testing.assert_allclose(far, gains.slope[-1] * np.array([3.0, 6.0]))


def drawn_gains(station, hours, paths=12, size=2, seed=7):
    """Amounts of gains that keep their sign for some hours, shape (path, event, k), and the times of the events, s."""
    rng = np.random.default_rng(seed)
    time = np.sort(rng.uniform(0.0, 365.25 * 86400.0, 500))
    keep = np.exp(-np.diff(time, prepend=time[0]) / (3600.0 * hours)) if hours else np.zeros(time.size)
    amount = rng.standard_normal((paths, time.size, size))
    for k in range(1, time.size):
        amount[:, k] = keep[k] * amount[:, k - 1] + np.sqrt(1.0 - keep[k] ** 2) * amount[:, k]
    conditions = replace(station.conditions, time_unix=time)
    return (
        replace(station, conditions=conditions),
        amount,
        np.exp(-np.abs(time[:, None] - time) / (3600.0 * (hours or 1))),
    )


@pytest.mark.parametrize("hours", [12.0, 24.0])
def test_gains_that_last_for_hours_add_to_the_variance_of_a_mean_over_months(station, hours):
    """Gains of 12 h were called a step, or a drift, of one path in 3 of 8 years without any."""
    placed, amount, alike = drawn_gains(station, hours)
    step = np.arange(amount.shape[1]) < 250
    true = float(step @ alike @ step) / step.sum() - 1.0
    found = find_memory_of_gains(placed, amount)
    np.testing.assert_allclose(np.diag(found), true, rtol=0.25)
    of_one = find_memory_of_gains(placed, amount[:1])
    np.testing.assert_allclose(np.diag(of_one), true, atol=1.0)
    covariance = np.array([[4.0, 1.0], [1.0, 2.0]])
    np.testing.assert_allclose(with_memory(covariance, np.eye(2)), 2.0 * covariance)


def test_what_lasts_for_months_is_an_effect_and_no_memory(station):
    placed, amount, _ = drawn_gains(station, 0.0)
    season = np.cos(2.0 * np.pi * placed.conditions.time_unix / (365.25 * 86400.0))[:, None]
    one_path = amount + 3.0 * (np.arange(12) == 3)[:, None, None]
    for independent in (amount, one_path, amount + season, amount * (np.arange(500) % 7 > 0)[:, None]):
        assert not np.any(find_memory_of_gains(placed, independent))
    undated = replace(placed, conditions=replace(placed.conditions, time_unix=np.full(500, np.nan)))
    assert not np.any(find_memory_of_gains(undated, amount))
