from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial.legendre import legvander
from scipy.stats import chi2, kstest

from lbacal_core.causes.axes import axis_named
from lbacal_core.discovery import residual_structure
from lbacal_core.discovery.refit import fit_chain
from lbacal_core.discovery.residual_structure import (
    STATION,
    _Candidate,
    _expected_first,
    _try_all,
    chance_of_pattern,
    depart,
    find_structure,
    fit_pattern,
    strongest_structure,
)
from lbacal_core.discovery.single_events import _chance_together, _largest_of_noise, find_in_events
from lbacal_core.discovery.station import gather_stations
from lbacal_twin.faults.uncatalogued import MainsHum
from tests.lbacal_core.discovery.worlds import Look, look_with_residual

SIGNIFICANT = 0.002


def test_nothing_is_left_of_a_clean_station(model):
    assert find_structure(model, np.random.default_rng(1), SIGNIFICANT) is None


def test_the_largest_structure_of_noise_predicts_nothing_of_events_not_used(model):
    strongest = strongest_structure(model, np.random.default_rng(1))
    assert find_structure(model, np.random.default_rng(1), 1.001 * strongest.p_value) is None


def test_a_wave_over_the_day_is_left_along_utc_and_predicts_events_not_used(spoil, simulation):
    spoilt = fit_chain(gather_stations(spoil(MainsHum(size=0.01)), simulation)[0]).linear
    found = find_structure(spoilt, np.random.default_rng(1), SIGNIFICANT)
    assert found is not None
    assert (found.axis_name, found.target) == ("utc", "station")
    assert found.held_out_gain > 0
    # What it is in the means, taken out, leaves nothing.
    left = spoilt.with_residuals(spoilt.residuals.mean - found.term, spoilt.residuals.deviation)
    assert found.channel_share.sum() == pytest.approx(1.0)
    assert find_structure(left, np.random.default_rng(1), SIGNIFICANT) is None


@pytest.mark.long
def test_the_probability_of_structure_in_noise_is_uniform(look):
    rng = np.random.default_rng(1)
    paths, events, channels = look.data.power.shape
    p = []
    for seed in range(40):
        noise = 0.044 * rng.standard_normal((paths, events, channels))
        noise += 0.04 * rng.standard_normal((paths, events, 1)) + 0.03 * rng.standard_normal((1, events, 1))
        found = look_with_residual(look, noise).residual_structure(seed)
        p.append(found.p_value)
    assert kstest(p, "uniform").statistic < 0.26  # 40 draws leave 0.21 (95 %), 0.25 (99 %)
    assert np.mean(np.array(p) < 0.1) < 0.25  # 0.1 +- 0.05


def waves(conditions):
    """A function of every axis, of mean square 1."""
    days = conditions.time_unix / 86_400.0
    span = (conditions.time_unix - conditions.time_unix.min()) / np.ptp(conditions.time_unix)
    warmth = conditions.covariates["temperature_c"] - conditions.covariates["temperature_c"].mean()
    return {
        "lst": np.cos(2 * np.pi * 3 * conditions.lst_hours / 24.0),
        "utc": np.cos(2 * np.pi * 3 * conditions.utc_hours / 24.0),
        "date": np.cos(2 * np.pi * 4 * span),
        "temperature": warmth**2 - np.mean(warmth**2),
        "rain": (conditions.covariates["rain_mm_h"] > 0).astype(float),
        "date, period 7 d": np.cos(2 * np.pi * days / 7.0),
        "date, period 27.3 d": np.cos(2 * np.pi * days / 27.3),
        "date, period 29.53 d": np.cos(2 * np.pi * days / 29.53),
    }


AXES = ("lst", "utc", "date", "temperature", "rain", "date, period 7 d", "date, period 27.3 d", "date, period 29.53 d")


def along(look, axis):
    """A wave along an axis with a slope from 0 at 30 MHz to 2 at 80 MHz, shape (event, freq)."""
    wave = waves(look.data.conditions)[axis]
    return np.outer(wave / np.std(wave), 1.0 + np.linspace(-1, 1, look.data.power.shape[2]))


def with_shown(look, shown):
    """What is shown beside the noise that the look has."""
    return look_with_residual(look, look.model.baseline.residual + shown)


def in_events(look):
    """A ripple in four events that share nothing else, shape (event, freq)."""
    events = np.zeros(look.data.power.shape[1])
    events[[20, 50, 90, 130]] = 0.08
    return np.outer(events, np.cos(9 * np.linspace(-1, 1, look.data.power.shape[2])))


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("target", ["station", "antenna 1 Y"])
def test_structure_is_found_along_the_axis_on_which_it_lives(axis, target, look):
    paths = [f"antenna {a} {d}" for a, d in look.paths]
    # What a path shows alone is three times as large: its noise is that of one, and the mean's is taken out of it.
    amount = np.array([1.0 if target == "station" else 3.0 * (path == target) for path in paths])
    shown = amount[:, None, None] * 0.008 * along(look, axis)
    found = with_shown(look, shown).residual_structure(alpha=SIGNIFICANT)
    assert (found.axis_name, found.target) == (axis, target)
    assert found.held_out_gain > 10
    assert found.channel_share[40:].sum() > 2 * found.channel_share[:11].sum()


@pytest.mark.parametrize("again", [None, 1e-20])
def test_structure_is_told_where_events_not_used_show_it_and_not_where_chance_is_smallest(look, again):
    """A band that saturates was told along dates, which events not used refuted: events in runs share their LST."""
    shown = 0.003 * along(look, "date") + 0.002 * along(look, "rain")
    linear = with_shown(look, shown).model.linear
    tried, _ = _try_all(linear, np.random.default_rng(1))
    dates, rain = (
        next(one.p_value for one in tried if one.target == STATION and one.axis is axis_named(name))
        for name in ("date", "rain")
    )
    assert dates < rain < 1e-4
    found = find_structure(linear, np.random.default_rng(1), SIGNIFICANT, again)
    assert (found.axis_name, found.target) == ("rain", STATION)
    assert found.held_out_gain > 0


def test_of_paths_beyond_all_chance_the_one_with_more_structure_is_named(look):
    """Where the probabilities were too small for a number, the path with least was named."""
    # Nothing of it in the mean.
    amount = np.array([{(0, "Y"): -0.2, (1, "Y"): 0.4, (2, "Y"): -0.2}.get(path, 0.0) for path in look.paths])
    spoilt = with_shown(look, amount[:, None, None] * along(look, "utc"))
    assert spoilt.residual_structure(alpha=SIGNIFICANT).target == "antenna 1 Y"


def test_structure_counts_where_its_probability_is_below_the_one_asked_for(look):
    spoilt = with_shown(look, 0.004 * along(look, "utc"))
    whole = spoilt.residual_structure()
    assert (whole.axis_name, whole.target) == ("utc", "station")
    assert 1e-30 < whole.p_value < 0.05
    assert whole.held_out_gain > 0
    assert spoilt.residual_structure(alpha=1.1 * whole.p_value).p_value == whole.p_value
    assert spoilt.residual_structure(alpha=0.9 * whole.p_value) is None


def test_single_events_come_behind_the_axis_of_a_cause_that_was_significant_twice(look):
    """A band that saturates was told in single events: it also presses down the gain of each of them."""
    wave = np.outer(waves(look.data.conditions)["lst"], 1.0 + np.linspace(-1, 1, look.data.power.shape[2]))
    linear = with_shown(look, 0.008 * wave + in_events(look)).model.linear
    told = [
        find_structure(linear, np.random.default_rng(1), SIGNIFICANT, 1e-20, axes).axis_name
        for axes in ((), {"lst"}, {"temperature"})
    ]
    # Held-out events refute the axis of a cause along which nothing is.
    assert told == ["event", "lst", "event"]


def test_the_axis_of_a_cause_that_was_significant_twice_comes_before_what_chance_explains():
    """A band that saturates was told along 29.53 days in one path, which events not used confirmed by chance."""

    def tried(name, target, p_value):
        return _Candidate(axis_named(name) if name else None, target, p_value, 10.0, 10)

    sure, path = tried("rain", "antenna 1 X", 1e-9), tried("date, period 29.53 d", "antenna 11 Y", 1e-3)
    lst, events = tried("lst", STATION, 1e-2), tried("", STATION, 1e-1)
    assert _expected_first([sure, path, lst, events], {"lst"}, SIGNIFICANT) == [sure, lst, path, events]
    assert _expected_first([sure, path, lst, events], (), SIGNIFICANT) == [sure, path, lst, events]
    clear = replace(events, p_value=1e-8)
    assert _expected_first([sure, clear, path, lst], {"lst"}, SIGNIFICANT) == [sure, lst, clear, path]


@pytest.mark.long
def test_single_events_of_noise_show_no_more_than_noise(look):
    """Compared at the same total: a level that is wrong by 2 % would look like half a standard deviation."""
    rng = np.random.default_rng(2)
    gains, sizes = [], []
    smooth = legvander(np.linspace(-1, 1, look.data.power.shape[2]), 5).T
    for seed in range(120):
        noise = 0.044 * rng.standard_normal(look.data.power.shape)
        found = find_in_events(look_with_residual(look, noise).model.linear, smooth, np.random.default_rng(seed))
        gains.append(found.gain)
        sizes.append(_largest_of_noise(rng, *look.data.power.shape[1:]))
    # 120 draws know the mean to 0.1 standard deviations.
    assert np.mean(gains) == pytest.approx(0.0, abs=0.3 * np.std(sizes))


def test_structure_in_single_events_is_found_without_an_axis(look):
    found = with_shown(look, in_events(look)).residual_structure(alpha=SIGNIFICANT)
    assert (found.axis_name, found.target) == ("event", "station")


def left_in(station, residual):
    """The structure that is significant in residuals of a station."""
    linear = look_with_residual(Look(station, fit_chain(station), None), residual).model.linear
    return find_structure(linear, np.random.default_rng(1), SIGNIFICANT)


def test_bursts_on_one_side_of_zero_are_seen_although_none_stands_out(station, model):
    """Jupiter adds one or two standard deviations to a fifth of the events, along a vector that their noise has."""
    rng = np.random.default_rng(12)
    events, vectors = station.power.shape[1], model.residuals.seeds.mean(axis=0)
    noise = 0.02 * rng.standard_normal((events, 1)) * vectors[1]
    burst = 0.08 * (rng.random((events, 1)) < 0.2) * vectors[1]
    own = 0.044 * rng.standard_normal(station.power.shape)
    assert left_in(station, own + noise) is None
    found = left_in(station, own + noise + burst)
    assert (found.axis_name, found.target) == ("event", "station")


def test_lines_of_interference_in_a_few_events_are_no_structure(station):
    """Lines that were left in one event of 25, some of them in one channel, made a clean station "unexplained"."""
    rng = np.random.default_rng(14)
    noise = 0.044 * rng.standard_normal(station.power.shape)
    line = np.zeros(station.power.shape[1:])
    line[rng.choice(len(line), 12, replace=False), [11, 11, 11, 11, *rng.choice(51, 8)]] = 0.4
    assert left_in(station, noise + line) is None


def test_a_vector_of_the_noise_that_is_off_by_a_few_per_cent_is_no_structure(station, model):
    """The fitted slope of a resonance is off by some per cent: what lies beside it goes with its amounts."""
    rng = np.random.default_rng(15)
    vector = model.residuals.seeds.mean(axis=0)[2]
    beside = 0.07 * np.linalg.norm(vector) * np.cos(9 * np.linspace(-1, 1, vector.size)) / (vector.size / 2) ** 0.5
    amounts = 0.11 * rng.standard_normal((station.power.shape[1], 1))
    own = 0.044 * rng.standard_normal(station.power.shape)
    assert left_in(station, own + amounts * (vector + beside)) is None


@pytest.mark.long
def test_tests_of_which_each_sees_a_little_see_structure_together():
    """Storms were on one side with 4 in 10,000 and alike in neighbours with 3 in 100,000, yet `consistent`."""
    assert _chance_together([0.84, 7e-4, 3.4e-5]) < 1e-5
    assert _chance_together([0.5, 0.9, 1e-6]) < 1e-5
    assert _chance_together([0.5, 0.9, 1.0]) > 0.9
    drawn = np.random.default_rng(3).random((40_000, 3))
    together = np.array([_chance_together(chances) for chances in drawn])
    for share in (0.1, 0.01, 0.001):
        # Both tests agree where one of three is rare: no more than asked, and not much less. 40 of 40,000: 16 %.
        assert 0.5 * share < np.mean(together < share) < 1.3 * share


MANY, POLARISATIONS = 24, 2


def deviations(rng, draws, paths, functions):
    """Noise of paths less the mean of their polarisation, shape (draw, path, function)."""
    noise = rng.standard_normal((draws, POLARISATIONS, paths // POLARISATIONS, functions))
    return (noise - noise.mean(axis=2, keepdims=True)).reshape(draws, paths, functions)


@pytest.mark.long
@pytest.mark.parametrize(("paths", "functions"), [(24, 40), (96, 40), (24, 4), (96, 16)])
def test_probabilities_are_those_of_drawn_noise(paths, functions):
    drawn = deviations(np.random.default_rng(3), 3000, paths, functions)
    chances = np.array([chance_of_pattern(one, paths - POLARISATIONS, functions)[0] for one in drawn])
    # The law is one of large matrices: of 22 paths and 4 functions 0.6 of what it says, a false alarm less.
    for asked in (0.2, 0.05, 0.01):
        assert 0.4 * asked < np.mean(chances < asked) < 1.35 * asked
    assert np.mean(chances) == pytest.approx(0.5, abs=0.06)


def test_what_no_path_shows_alone_all_show_together():
    rng = np.random.default_rng(4)
    noise = deviations(rng, 1, MANY, 16)[0]
    pattern = rng.standard_normal(16)
    amounts = np.linspace(-1, 1, MANY)
    shown = 3.0 * np.outer(amounts, pattern / np.linalg.norm(pattern))
    assert chance_of_pattern(noise, MANY - POLARISATIONS, 16)[0] > 0.05
    chance, gain, amplitude = chance_of_pattern(noise + shown, MANY - POLARISATIONS, 16)
    assert chance < 1e-4
    # Noise adds to the pattern along it.
    assert np.sum(shown**2) < gain < 2 * np.sum(shown**2)
    assert abs(np.corrcoef(amplitude, amounts)[0, 1]) > 0.8
    # The path with the most has 2 in 1000 by chance alone, a false alarm of one in 20 among 24 paths.
    assert MANY * chi2.sf(np.max(np.sum((noise + shown) ** 2, axis=1)), 16) > 0.02


def test_what_a_class_shows_alike_is_no_departure_and_functions_not_told_apart_count_for_none():
    rng = np.random.default_rng(5)
    independent = rng.standard_normal((MANY, 6, 200))
    doubled = np.concatenate([independent, independent[:, :3]], axis=1)
    information = doubled @ np.swapaxes(doubled, 1, 2)
    noise = np.einsum("pfe,pe->pf", doubled, rng.standard_normal((MANY, 200)))
    white, told_apart = depart(noise, information)
    assert told_apart == 6
    assert np.sum(white**2) / (MANY - 1) == pytest.approx(6, abs=1.5)
    same = np.repeat(information[:1], MANY, axis=0)
    np.testing.assert_allclose(depart(same @ rng.standard_normal(9), same)[0], 0.0, atol=1e-9)
    assert depart(noise[:0], information[:0])[1] == 0.0


def test_sizes_of_one_path_are_those_of_least_squares_and_of_many_those_of_the_pattern():
    rng = np.random.default_rng(6)
    functions = rng.standard_normal((MANY, 5, 300))
    information = functions @ np.swapaxes(functions, 1, 2)
    pattern, amounts = rng.standard_normal(5), np.linspace(-1, 1, MANY)
    true = np.outer(amounts, pattern)
    data = np.einsum("pf,pfe->pe", true, functions) + rng.standard_normal((MANY, 300))
    score = np.einsum("pfe,pe->pf", functions, data)
    alone = fit_pattern(score[:1], information[:1])[0]
    np.testing.assert_allclose(alone, np.linalg.lstsq(functions[0].T, data[0])[0], rtol=1e-9)
    each = np.stack([fit_pattern(score[k : k + 1], information[k : k + 1])[0] for k in range(MANY)])
    together = fit_pattern(score, information)
    assert np.sum((together - true) ** 2) < 0.6 * np.sum((each - true) ** 2)


@pytest.mark.long
def test_a_tilt_that_grows_over_the_field_is_seen_though_no_path_shows_it(world, monkeypatch):
    """A wall beside 48 antennas was a compression of two boards, or nothing: no path showed it beyond chance."""
    look = world.with_settings(antennas=24).look()
    noise, conditions = look.residual, look.data.conditions
    tilt = np.sin(2 * np.pi * (conditions.lst_hours - 14.0) / 24.0)[:, None]
    antennas = np.array([antenna for antenna, _ in look.paths])
    place = (antennas - antennas.mean()) / np.ptp(antennas)

    def strongest(size):
        shown = size * place[:, None, None] * tilt * np.ones(noise.shape[2])
        return look_with_residual(look, noise + shown).residual_structure()

    assert strongest(0.0).p_value > 0.01
    found = strongest(0.055)
    assert (found.axis_name, found.p_value < 1e-5, found.held_out_gain > 5) == ("lst", True, True)
    assert abs(place[[f"antenna {a} {d}" == found.target for a, d in look.paths]]) > 0.2
    amounts = np.array([found.amounts[f"antenna {a} {d}"][0] for a, d in look.paths])
    # Each amount has an error about as large as the tilt of a path.
    assert abs(np.corrcoef(amounts, place)[0, 1]) > 0.4
    monkeypatch.setattr(residual_structure, "chance_of_pattern", lambda *_: (1.0, 0.0, np.zeros(0)))
    alone = strongest(0.055)
    assert (alone.p_value > 1e-3, alone.amounts) == (True, {})
