"""A pattern that all paths show together: probabilities of noise, a hidden pattern, and its sizes."""

import numpy as np
import pytest
from scipy.stats import chi2

from lbacal_core.discovery import residual_structure
from lbacal_core.discovery.residual_structure import chance_of_pattern, depart, fit_pattern
from tests.lbacal_core.discovery.worlds import look_with_residual

PATHS, POLARISATIONS = 24, 2


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
    noise = deviations(rng, 1, PATHS, 16)[0]
    pattern = rng.standard_normal(16)
    amounts = np.linspace(-1, 1, PATHS)
    shown = 3.0 * np.outer(amounts, pattern / np.linalg.norm(pattern))
    assert chance_of_pattern(noise, PATHS - POLARISATIONS, 16)[0] > 0.05
    chance, gain, amplitude = chance_of_pattern(noise + shown, PATHS - POLARISATIONS, 16)
    assert chance < 1e-4
    # Noise adds to the pattern along it.
    assert np.sum(shown**2) < gain < 2 * np.sum(shown**2)
    assert abs(np.corrcoef(amplitude, amounts)[0, 1]) > 0.8
    # The path with the most has 2 in 1000 by chance alone, a false alarm of one in 20 among 24 paths.
    assert PATHS * chi2.sf(np.max(np.sum((noise + shown) ** 2, axis=1)), 16) > 0.02


def test_what_a_class_shows_alike_is_no_departure_and_functions_not_told_apart_count_for_none():
    rng = np.random.default_rng(5)
    independent = rng.standard_normal((PATHS, 6, 200))
    doubled = np.concatenate([independent, independent[:, :3]], axis=1)
    information = doubled @ np.swapaxes(doubled, 1, 2)
    noise = np.einsum("pfe,pe->pf", doubled, rng.standard_normal((PATHS, 200)))
    white, told_apart = depart(noise, information)
    assert told_apart == 6
    assert np.sum(white**2) / (PATHS - 1) == pytest.approx(6, abs=1.5)
    same = np.repeat(information[:1], PATHS, axis=0)
    np.testing.assert_allclose(depart(same @ rng.standard_normal(9), same)[0], 0.0, atol=1e-9)
    assert depart(noise[:0], information[:0])[1] == 0.0


def test_sizes_of_one_path_are_those_of_least_squares_and_of_many_those_of_the_pattern():
    rng = np.random.default_rng(6)
    functions = rng.standard_normal((PATHS, 5, 300))
    information = functions @ np.swapaxes(functions, 1, 2)
    pattern, amounts = rng.standard_normal(5), np.linspace(-1, 1, PATHS)
    true = np.outer(amounts, pattern)
    data = np.einsum("pf,pfe->pe", true, functions) + rng.standard_normal((PATHS, 300))
    score = np.einsum("pfe,pe->pf", functions, data)
    alone = fit_pattern(score[:1], information[:1])[0]
    np.testing.assert_allclose(alone, np.linalg.lstsq(functions[0].T, data[0])[0], rtol=1e-9)
    each = np.stack([fit_pattern(score[k : k + 1], information[k : k + 1])[0] for k in range(PATHS)])
    together = fit_pattern(score, information)
    assert np.sum((together - true) ** 2) < 0.6 * np.sum((each - true) ** 2)


@pytest.mark.long
def test_a_tilt_that_grows_over_the_field_is_seen_though_no_path_shows_it(world, monkeypatch):
    """A wall beside 48 antennas was a compression of two boards, or nothing: no path showed it beyond chance."""
    look = world.with_settings(antennas=24).look()
    noise, conditions = look.model.baseline.residual, look.data.conditions
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
