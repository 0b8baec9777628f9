from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from lbacal_core.calibration.continued import continue_fit
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.calibration.years import GAIN_SIGMAS, OTHER_NOISE, OTHER_SIGMAS, Beside, gain_modes, weigh_by_members
from lbacal_core.curves.kept_lines import KeptLines, MemberLines, join_away, read_lines, write_lines

YEARS = 3
GAINS = (0.0, 0.02, -0.03)
"""Ln of the power gain of the years in front of N_RCU."""


def draw_year(scene, number, events=300, days=365.0):
    """A year whose gain in front of N_RCU is its own: the slope and N_LNA have it, what is added behind has not."""
    rng = np.random.default_rng(100 + number)
    spectra = scene.spectra(rng, events, antennas=2, days=days)
    behind = scene.n_rcu * scene.instrument.receiver_gain + scene.n_adc
    # the scatter of what is added behind grows with the gain: 3 % of it, far below the scatter itself
    power = (spectra.power - behind) * np.exp(GAINS[number]) + behind
    names = np.char.add(f"{number}-", spectra.event_id)
    return replace(spectra, power=power, event_id=names, time_unix=spectra.time_unix + number * 365 * 86_400.0)


@pytest.fixture(scope="module")
def years(scene):
    return [draw_year(scene, number) for number in range(YEARS)]


@pytest.fixture(scope="module")
def alone(scene, years):
    return {scope: [fit_calibration(one, scene.simulation, scope) for one in years] for scope in ("antenna", "station")}


def beside(reports, own, *, is_same=True):
    others = [report for k, report in enumerate(reports) if report is not None and k != own]
    kept = [lines for report in others for lines in read_lines(write_lines(report.lines))]
    return [Beside(lines, np.full(len(lines.owners), is_same)) for lines in kept]


def true_c(scene, curve):
    assert isinstance(curve.antenna, int)
    cable = "80" if curve.antenna % 2 else "50"
    return np.sqrt(scene.instrument.antenna_gain / scene.slope(cable))


@pytest.mark.parametrize("is_same", [True, False], ids=["same hardware", "other hardware"])
def test_one_chain_through_the_years_is_that_of_all_their_lines_with_a_gain_for_each(scene, years, alone, is_same):
    """The slow way: all unknowns of the lines at once, s, constants, gains and, over a change, noise of each year."""
    report = fit_calibration(years[0], scene.simulation, "antenna", beside(alone["antenna"], 0, is_same=is_same))
    curve = next(one for one in report.curves if one.dipole == "X")
    terms, shapes = scene.simulation.noise, gain_modes(scene.instrument.frequency_mhz)
    lines = [next(one for one in year.lines if one.owners[0][2] == "X") for year in alone["antenna"]]
    sigmas = GAIN_SIGMAS if is_same else (*OTHER_SIGMAS, *[OTHER_NOISE] * 3)
    channels, count = shapes.shape[1], len(sigmas)
    measured = np.array([np.concatenate([one.slope[0], one.intercept[0]]) for one in lines])
    roots = [np.linalg.cholesky(one.information[0]).T for one in lines]
    scale = np.concatenate([measured[0][:channels], [scene.n_lna, scene.n_rcu, scene.n_adc], np.ones(2 * count)])

    def residual(unit):
        value = unit * scale
        x, n, q = value[:channels], value[channels : channels + 1], value[channels + 1 : channels + 3]
        gains = np.concatenate([np.zeros((1, count)), value[channels + 3 :].reshape(2, count)])
        found = []
        for k in range(YEARS):
            slope, noise = x * np.exp(gains[k, :3] @ shapes), np.zeros(3) if is_same else gains[k, 3:]
            intercept = terms.before(n * (1.0 + noise[:1])) * slope + (q * (1.0 + noise[1:])) @ terms.behind
            found.append(roots[k] @ (measured[k] - np.concatenate([slope, intercept])))
        return np.concatenate([*found, (gains[1:] / sigmas).ravel()])

    start = np.concatenate([np.ones(channels + 3), np.zeros(2 * count)])
    solved = least_squares(residual, start, method="lm", xtol=1e-14, ftol=1e-14)
    covariance = np.linalg.inv(solved.jac.T @ solved.jac)
    of_log_c = np.sqrt(np.diag(covariance)[:channels]) / (2.0 * solved.x[:channels])
    expected = np.sqrt(scene.instrument.antenna_gain / (solved.x * scale)[:channels])
    # N_RCU S and N_ADC weigh in another year as if they had its gain, 3 %
    assert np.max(np.abs(curve.c - expected) / curve.c_sigma_stat) < 0.1
    np.testing.assert_allclose(curve.c_sigma_stat / curve.c, of_log_c, rtol=0.02)
    assert curve.repeated.windows == YEARS


@pytest.mark.parametrize("scope", ["antenna", "station"])
def test_years_of_one_chain_differ_by_their_gains_and_their_error_is_that_of_all_events(scene, years, alone, scope):
    alone = alone[scope]
    together = [fit_calibration(one, scene.simulation, scope, beside(alone, k)) for k, one in enumerate(years)]
    for k in (1, 2):
        for was, now in zip(together[0].curves, together[k].curves, strict=True):
            ratio = np.log(now.c / was.c)
            # the mean over the band of 300 events of 4 %: 0.16 % in C
            assert np.mean(ratio) == pytest.approx(-0.5 * GAINS[k], abs=0.004)
            assert np.ptp(ratio) < 0.02
    for by_itself, now in zip(alone[0].curves, together[0].curves, strict=True):
        gained = now.c_sigma_stat / by_itself.c_sigma_stat
        assert 0.4 < np.min(gained) <= np.max(gained) < 0.75, "three years: 0.58"
        assert now.repeated.chi2_per_dof == pytest.approx(1.0, abs=0.3)
    pulls = [(np.log(one.c / true_c(scene, one)) + 0.5 * GAINS[k]) / (one.c_sigma_stat / one.c)
             for k, report in enumerate(together) for one in report.curves if scope == "antenna"]  # fmt: skip
    assert not pulls or np.sqrt(np.mean(np.square(pulls))) < 2.0


def test_over_a_step_c_changes_by_the_step_though_each_side_alone_knows_it_badly(scene, years, alone):
    """A gain of 10 % behind the amplifier, and receiver noise of another 10 %: ln C of a side alone is 2 % off."""
    behind = scene.n_rcu * scene.instrument.receiver_gain + scene.n_adc
    of_gain, of_noise = 1.1, 0.1 * scene.n_rcu * scene.instrument.receiver_gain
    power = (years[1].power - behind) * of_gain + behind + of_noise
    changed = fit_calibration(replace(years[1], power=power), scene.simulation)
    assert {one.repeated for one in changed.curves} == {None}
    before, after = (
        fit_calibration(spectra, scene.simulation, "antenna", beside([None, other], 0, is_same=False))
        for spectra, other in ((years[0], changed), (replace(years[1], power=power), alone["antenna"][0]))
    )
    step = -0.5 * (GAINS[1] + np.log(of_gain))
    by_itself, together = (
        [np.log(now.c / was.c) - step for was, now in zip(then.curves, of_now.curves, strict=True)]
        for then, of_now in ((alone["antenna"][0], changed), (before, after))
    )
    assert np.std(together) < 0.6 * np.std(by_itself)
    for then, now in zip(alone["antenna"][0].curves, before.curves, strict=True):
        assert now.repeated.windows == 2
        pull = np.log(now.c / true_c(scene, now)) * now.c / now.c_sigma_stat
        assert np.sqrt(np.mean(pull**2)) < 2.0
        assert np.mean(now.c_sigma_stat / then.c_sigma_stat) < 0.95


def test_another_antenna_lends_nothing_and_those_of_its_year_still_do(scene, years, alone):
    """A(nu) of another shape, 5 % along 20 MHz: no gain or noise explains it, and that hardware differs is no news."""
    wave = 1.0 + 0.05 * np.cos(2.0 * np.pi * scene.instrument.frequency_mhz / 20.0)
    other = fit_calibration(replace(years[1], power=years[1].power * wave), scene.simulation)
    apart = beside([None, other], 0, is_same=False)
    found = fit_calibration(years[0], scene.simulation, "antenna", apart)
    for by_itself, now in zip(alone["antenna"][0].curves, found.curves, strict=True):
        assert np.array_equal(by_itself.c, now.c)
        assert now.repeated is None
    same = beside([None, None, alone["antenna"][2]], 0)
    of_both, of_same = (fit_calibration(years[0], scene.simulation, "antenna", of) for of in ([*apart, *same], same))
    for expected, now in zip(of_same.curves, of_both.curves, strict=True):
        assert np.array_equal(expected.c, now.c)
        assert now.repeated.windows == 2


def test_a_year_that_does_not_repeat_is_fitted_by_itself_and_says_so(scene, years, alone):
    """Another noise of the receiver: no gain explains it."""
    louder = replace(years[1], power=years[1].power + 3.0 * scene.n_rcu * scene.instrument.receiver_gain)
    other = fit_calibration(louder, scene.simulation)
    found = fit_calibration(years[0], scene.simulation, "antenna", beside([None, other], 0))
    for by_itself, now in zip(alone["antenna"][0].curves, found.curves, strict=True):
        assert np.array_equal(by_itself.c, now.c)
        assert now.repeated.windows == 1
        assert now.repeated.chi2_per_dof > 1.5


def test_a_year_that_is_a_misfit_lends_nothing_to_others(scene, years, alone):
    """A clock of two hours; the noise constants that a wrong sky gives are no measurement of those of other years."""
    late = fit_calibration(replace(years[1], time_unix=years[1].time_unix + 7200.0), scene.simulation)
    assert {curve.status for curve in late.curves} == {"misfit"}
    found = fit_calibration(years[0], scene.simulation, "antenna", beside([None, late], 0))
    for by_itself, now in zip(alone["antenna"][0].curves, found.curves, strict=True):
        assert np.array_equal(by_itself.c, now.c)
        assert now.repeated is None


def test_a_window_too_small_for_a_fit_has_the_chain_of_another_through_its_own_cable_and_a_gain(scene, alone):
    few = draw_year(scene, 1, events=30, days=20.0)
    lonely = fit_calibration(few, scene.simulation)
    assert {curve.status for curve in lonely.curves} == {"too_few_events"}
    shorter = {name: loss * (1.21 if name == "50" else 1.0) for name, loss in scene.instrument.cables.items()}
    of_now = replace(scene.simulation, instrument=replace(scene.instrument, cables=shorter))
    with_cable = few.power * np.where(few.antenna % 2, 1.0, 1.21)[:, None]
    for simulation, spectra, ratio in ((scene.simulation, few, 1.0), (of_now, replace(few, power=with_cable), 1.1)):
        found = fit_calibration(spectra, simulation, "antenna", beside(alone["antenna"], 1, is_same=False)[:2])
        for then, now in zip(alone["antenna"][0].curves, found.curves, strict=True):
            own = np.log(now.c / then.c) + (0.0 if now.antenna % 2 else np.log(ratio))
            # 30 events of 4 %: 0.4 % in C
            assert (now.status, now.events) == ("converged", 30)
            assert np.mean(own) == pytest.approx(-0.5 * GAINS[1], abs=0.015)
            assert np.all(now.c_sigma_stat / now.c > 0.9 * then.c_sigma_stat / then.c)
    four = few.select(np.isin(few.event_id, np.unique(few.event_id)[:4]))
    found = fit_calibration(four, scene.simulation, "antenna", beside(alone["antenna"], 1, is_same=False))
    assert {curve.status for curve in found.curves} == {"too_few_events"}, "4 events know no gain"


@pytest.mark.parametrize("factor", [0.1, 0.25, 2.0, 4.0, 6.0])
def test_a_small_window_of_another_gain_takes_the_chain_of_others(scene, alone, factor):
    """The noise behind swung between two rounds for ever, and weights were those of the power of the other window."""
    few = draw_year(scene, 1, events=30, days=20.0)
    behind = scene.n_rcu * scene.instrument.receiver_gain + scene.n_adc
    strong = replace(few, power=(few.power - behind) * factor + behind)
    found = fit_calibration(strong, scene.simulation, "antenna", beside(alone["antenna"], 1, is_same=False))
    for then, now in zip(alone["antenna"][0].curves, found.curves, strict=True):
        assert now.status == "converged"
        assert np.mean(np.log(now.c / then.c)) == pytest.approx(-0.5 * (GAINS[1] + np.log(factor)), abs=0.03)


def test_a_path_that_is_dead_in_one_window_borrows_and_lends_nothing(scene, years, alone):
    """A gain of 1e-4 between two windows sent Gauss and Newton to infinity, and the whole station's refit failed."""
    few = draw_year(scene, 1, events=40, days=60.0)
    dead = replace(few, power=1e-4 * few.power)
    found = fit_calibration(dead, scene.simulation, "antenna", beside(alone["antenna"], 1, is_same=False))
    assert {curve.status for curve in found.curves} <= {"too_few_events", "not_identifiable"}
    whole = fit_calibration(replace(years[1], power=1e-4 * years[1].power), scene.simulation)
    now = fit_calibration(years[0], scene.simulation, "antenna", beside([None, whole], 0))
    for by_itself, curve in zip(alone["antenna"][0].curves, now.curves, strict=True):
        assert np.array_equal(by_itself.c, curve.c)


def test_later_events_continue_a_fit_of_several_years(scene, years, alone):
    number = np.array([int(name[-5:]) for name in years[0].event_id])
    before, new = (years[0].select(rows) for rows in (number < 290, number >= 290))
    others = beside(alone["antenna"], 0)
    kept = read_lines(write_lines(fit_calibration(before, scene.simulation, "antenna", others).lines))
    found = continue_fit(kept, new, scene.simulation, others)
    whole = fit_calibration(years[0], scene.simulation, "antenna", others)
    for curve in whole.curves:
        c, sigma, _ = found.curves[curve.path]
        assert np.max(np.abs(c - curve.c) / curve.c_sigma_stat) < 0.1
        np.testing.assert_allclose(sigma, curve.c_sigma_stat, rtol=0.1)
    assert continue_fit(kept, None, scene.simulation, others).curves.keys() == found.curves.keys()


def test_a_campaign_without_other_years_is_what_it_was(alone):
    assert {curve.repeated for report in alone["station"] for curve in report.curves} == {None}


@pytest.mark.parametrize("scope", ["station", "array"])
def test_an_antenna_that_is_away_for_a_year_stays_in_the_mean(scene, years, scope):
    """The mean of a station was that of other antennas while one was dead: C moved by its departure from them."""
    reports = [fit_calibration(one, scene.simulation, scope) for one in years]
    without = years[1].select(years[1].antenna != 1)
    whole = fit_calibration(years[1], scene.simulation, scope, beside(reports, 1))
    found = fit_calibration(without, scene.simulation, scope, beside(reports, 1))
    for curve, of_all, chain in zip(found.curves, whole.curves, found.chains, strict=True):
        assert [antenna for _, antenna in chain.members] == [0, 1]
        assert np.max(np.abs(np.log(curve.c / of_all.c))) < 0.004, "the gain of a year by one antenna of two"
    other = fit_calibration(without, scene.simulation, scope, beside(reports, 1, is_same=False))
    assert [antenna for _, antenna in other.chains[0].members] == [0], "of other hardware nothing is lent"
    moved = next(one for one in scene.instrument.antennas if one.antenna == 1 and one.station == "CS002")
    others = [one for one in scene.instrument.antennas if one is not moved]
    records = [
        replace(moved, until=years[2].time_unix.min()),
        replace(moved, since=years[2].time_unix.min(), cable="50"),
    ]
    instrument = replace(scene.instrument, antennas=(*others, *records))
    few = years[1].select((years[1].antenna != 1) | np.isin(years[1].event_id, np.unique(years[1].event_id)[:25]))
    changed = fit_calibration(few, replace(scene.simulation, instrument=instrument), scope, beside(reports, 1))
    assert [antenna for _, antenna in changed.chains[0].members] == [0], "nor what another cable has been to"
    lent = [read_lines(write_lines(found.lines))[0].members, found.lines[0].members]
    assert [one.is_away.tolist() for one in lent] == [[False, True]] * 2
    again = fit_calibration(without, scene.simulation, scope, [*beside([found], 1), *beside(reports, 1)])
    slopes = [one.lines[0].members.slope for one in (again, found)]
    np.testing.assert_allclose(*slopes, rtol=1e-12, err_msg="who is away in the nearest window lends nothing")
    gained = slopes[1][0] / reports[0].lines[0].members.slope[0]
    np.testing.assert_allclose(slopes[1][1], reports[0].lines[0].members.slope[1] * gained, rtol=1e-12)


def test_later_events_continue_a_mean_with_an_antenna_that_is_away(scene, years):
    report = fit_calibration(years[0], scene.simulation, "station")
    without = years[1].select(years[1].antenna != 1)
    first, last = (without.select(rows) for rows in (np.arange(len(without)) < 500, np.arange(len(without)) >= 500))
    early, late = (one.select(np.isin(one.event_id, first.event_id, invert=k)) for k, one in enumerate((without, last)))
    others = beside([report], 1)
    found = fit_calibration(early, scene.simulation, "station", others)
    continued = continue_fit(found.lines, late, scene.simulation, others)
    together = fit_calibration(without, scene.simulation, "station", others)
    for curve in together.curves:
        c, sigma, *_ = continued.curves[curve.station, None, curve.dipole]
        assert np.max(np.abs(c - curve.c) / sigma) < 0.25


def test_a_small_window_borrows_of_those_that_have_their_own_noise_levels_and_its_lines_are_named_by_them(
    scene, years, alone
):
    """C of two small windows depended on which of them had been fitted first, and the same name had two values."""
    half = [years[k].select(np.isin(years[k].event_id, np.unique(years[k].event_id)[:40])) for k in (1, 2)]
    large = beside(alone["antenna"], 1)[:2]
    lender = fit_calibration(half[0], scene.simulation, "antenna", large)
    assert {curve.status for curve in lender.curves} == {"converged"}
    of_both = [beside([lender], 2) + large, large + beside([lender], 2)]
    near, far = (fit_calibration(half[1], scene.simulation, "antenna", of) for of in of_both)
    for one, other in zip(near.lines, far.lines, strict=True):
        assert np.array_equal(one.slope, other.slope)
        assert np.array_equal(one.spectra, other.spectra)
    assert {curve.status for curve in fit_calibration(half[1], scene.simulation, "antenna", of_both[0][:2]).curves} == {
        "too_few_events"
    }
    other = fit_calibration(half[1], scene.simulation, "antenna", beside([alone["antenna"][1]], 2))
    assert not set(near.lines[0].spectra) & set(other.lines[0].spectra)


def test_each_small_path_borrows_of_the_nearest_window_that_has_it(scene, alone):
    """Who stood in another window than the first path that could borrow had no curve."""
    few = draw_year(scene, 1, events=30, days=20.0)
    of_both = beside(alone["antenna"], 1)
    parted = [replace(one, lines=one.lines.lend({one.lines.owners[k // 2]})) for k, one in enumerate(of_both)]
    found = fit_calibration(few, scene.simulation, "antenna", parted)
    assert {curve.status for curve in found.curves} == {"converged"}
    for curve in found.curves:
        own = [one for one in parted if (curve.path, True) in zip(one.lines.owners, one.lines.is_good, strict=True)]
        assert len(own) == 1
        by_itself = {one.path: one.c for one in fit_calibration(few, scene.simulation, "antenna", own).curves}
        # the gains of a batch are settled to 1e-4 together
        assert curve.c == pytest.approx(by_itself[curve.path], rel=1e-5)


def test_lines_of_a_mean_are_named_by_the_members_that_other_windows_lend(scene, years):
    """The same spectra with other members had the same name, and the fits beside it two values of C."""
    report = fit_calibration(years[0], scene.simulation, "station")
    without = years[1].select(years[1].antenna != 1)
    by_itself, found, again = (fit_calibration(without, scene.simulation, "station", of) for of in (
        [], beside([report], 1), beside([report], 1)
    ))  # fmt: skip
    names = [one.lines[0].spectra.tolist() for one in (by_itself, found, again)]
    assert names[0] != names[1] == names[2]
    assert names[0] == [without.digest("CS002", None, found.lines[0].owners[0][2])]


def test_who_is_away_in_a_mean_is_as_other_windows_have_it_now(scene, years):
    """What another year had changed of it was no news until all spectra were read again, for whatever reason."""
    without = years[1].select(years[1].antenna != 1)
    then, now = (fit_calibration(one, scene.simulation, "station") for one in (years[0], years[2]))
    found = fit_calibration(without, scene.simulation, "station", beside([then], 1))
    continued = continue_fit(found.lines, None, scene.simulation, beside([now], 1))
    for curve in fit_calibration(without, scene.simulation, "station", beside([now], 1)).curves:
        c, sigma, *_ = continued.curves[curve.path]
        assert np.max(np.abs(c - curve.c) / sigma) < 0.05


@pytest.mark.parametrize("lent", [False, True])
def test_others_who_are_away_from_a_mean_are_read_from_spectra(scene, years, lent):
    """A year that was a misfit for a night took an antenna from the others, which never got it back."""
    without = years[1].select(years[1].antenna != 1)
    other = beside([fit_calibration(years[0], scene.simulation, "station")], 1)
    found = fit_calibration(without, scene.simulation, "station", other if lent else ())
    owners = {curve.path for curve in found.curves}
    assert continue_fit(found.lines, None, scene.simulation, () if lent else other).undecided == owners
    assert continue_fit(found.lines, None, scene.simulation, other if lent else ()).curves.keys() == owners


@pytest.mark.parametrize(("here", "there"), [("0123", "0123"), ("012", "0123"), ("023", "012"), ("01", "0123")])
def test_two_means_differ_by_the_noise_of_the_members_that_both_have(here, there):
    """The lines of members are drawn 20,000 times, those of who is away joined, and the means compared."""
    rng = np.random.default_rng(1)
    level, scatter, events, draws = (
        np.array([1.0, 2.0, 1.5, 0.5]),
        np.array([0.05, 0.04, 0.06, 0.05]),
        (100, 300),
        20_000,
    )

    def draw(names, count):
        at = [int(one) for one in names]
        lines = level[at, None] * (1.0 + scatter[at, None] / np.sqrt(count) * rng.standard_normal((len(at), draws)))
        return MemberLines(np.full(len(at), "CS002"), np.array(at), lines, lines, level[at], scatter[at])

    own, other = (draw(names, count) for names, count in zip((here, there), events, strict=True))
    of_own, of_other = (join_away(a, [b]).slope.mean(axis=0) for a, b in ((own, other), (other, own)))
    lines = KeptLines(
        [("CS002", None, "X")], np.array([events[1]]), *[np.ones(1, dtype=bool)] * 2, *[np.ones((1, 1))] * 2,
        np.ones((1, 2, 2)), *[np.ones((1, 1))] * 5, np.array(["name"]), 100.0, members=other,
    )  # fmt: skip
    (weighed,), share = weigh_by_members([Beside(lines, np.ones(1, dtype=bool))], join_away(own, [other]), events[0])
    own_claimed = own.variance_of(own.present) / events[0] / share
    assert np.var(np.log(of_own)) == pytest.approx(own_claimed, rel=0.05)
    claimed = own_claimed + other.variance_of(other.present) / events[1] / weighed.lines.information[0, 0, 0]
    most = 0.08 if here == "01" else 0.05  # the means of unlike members have errors in common, and less of a difference
    assert (1.0 - most) * claimed < np.var(np.log(of_own / of_other)) < 1.05 * claimed
    weights = np.array([1.0 / own_claimed, 1.0 / (claimed - own_claimed)])
    both = np.average([np.log(of_own), np.log(of_other)], axis=0, weights=weights)
    assert np.var(both) * weights.sum() < 1.1, "of both together the error is no larger than claimed"


def test_a_mean_with_lent_members_is_no_misfit(scene):
    """Their errors were not counted: chi^2 per degree of freedom was 1.5, and some sound means were misfits."""
    found = []
    for seed in range(8):
        now, then = (scene.spectra(np.random.default_rng([seed, k]), 100, antennas=4, days=365.0) for k in range(2))
        then = replace(then, time_unix=then.time_unix + 365 * 86_400.0)
        other = fit_calibration(then, scene.simulation, "station")
        some = now.select(np.isin(now.antenna, [1, 3]))
        found += fit_calibration(some, scene.simulation, "station", beside([other], 1)).curves
    assert {curve.status for curve in found} == {"converged"}
    assert np.mean([curve.chi2_per_dof_profiled for curve in found]) == pytest.approx(1.0, abs=0.15)


def test_a_mean_without_a_common_member_lends_nothing():
    ones = np.ones((2, 3))
    some, others = (
        MemberLines(np.full(2, "CS002"), np.array(at), ones, ones, ones[:, 0], ones[:, 0]) for at in ([0, 1], [2, 3])
    )
    lines = KeptLines(
        [("CS002", None, "X")], np.array([9]), *[np.ones(1, dtype=bool)] * 2, *[np.ones((1, 1))] * 2,
        np.ones((1, 2, 2)), *[np.ones((1, 1))] * 5, np.array(["name"]), 100.0, members=others,
    )  # fmt: skip
    assert weigh_by_members([Beside(lines, np.ones(1, dtype=bool))], some, 9) == ([], 1.0)


@pytest.mark.parametrize(("events", "status"), [(30, "converged"), (4, "too_few_events")])
def test_the_mean_of_antennas_with_few_events_each_had_none_and_borrowed_nothing(scene, alone, events, status):
    """It said 0 events that see 0.0 h, while its antennas had C of what other windows lend."""
    few = draw_year(scene, 1, events=events, days=20.0)
    lonely = fit_calibration(few, scene.simulation, "station")
    assert {(one.status, one.events) for one in lonely.curves} == {("too_few_events", events if events > 4 else 0)}
    found = fit_calibration(few, scene.simulation, "station", beside(alone["station"], 1))
    for then, now in zip(alone["station"][0].curves, found.curves, strict=True):
        assert now.status == status
        if now.c is not None:
            assert np.mean(np.log(now.c / then.c)) == pytest.approx(-0.5 * GAINS[1], abs=0.015)


def test_a_mean_of_antennas_that_take_turns_is_not_taken_for_one_of_all_their_events(scene, alone):
    """The lines of each are of its few events, whose errors are not those of all."""
    year = draw_year(scene, 1, events=100)
    few = year.select(np.isin(year.event_id, np.unique(year.event_id)[::2]) == (year.antenna == 0))
    found = fit_calibration(few, scene.simulation, "station", beside(alone["station"], 0))
    assert {(one.status, one.events) for one in found.curves} == {("converged", 50)}
    assert all(one.repeated.windows > 1 for one in found.curves)
