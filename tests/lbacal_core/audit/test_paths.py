from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.audit.antennas import (
    _fit_lines,
    compare_paths,
    compare_polarisations,
    find_copies,
    find_empty_channels,
    find_ill_paths,
    find_steps,
    find_wrong_cables,
    levels_of_cables,
    log_likelihood_of_unit,
    tell_exchanged,
)
from lbacal_core.audit.audit import audit
from lbacal_core.audit.station import AuditedStation
from tests.lbacal_core.audit.conftest import HOURS

ALL, EVERYBODY = np.arange(6), np.ones(6, dtype=bool)


@pytest.mark.parametrize(("antenna", "recorded"), [(0, "115"), (5, "50")])
def test_a_cable_on_record_that_is_not_there_is_named(station, low_band, antenna, recorded):
    true = str(station.cables[antenna])
    claimed = station.with_cables({antenna: recorded}, low_band)
    lines, found = find_wrong_cables(claimed, compare_paths(claimed), low_band)
    assert found == {antenna: true}
    assert f"antenna {antenna} has the cable {true}, not {recorded}" in lines[0].sentence


def test_one_ill_path_is_no_other_cable_of_its_antenna(station, low_band):
    """The mean of both dipoles was as through another cable, where one of them had lost twice as much."""
    own, other = (low_band.cables[name] for name in (str(station.cables[0]), "115"))
    power = station.power.copy()
    power[0, 1] *= (other / own) ** 2
    ill = replace(station, power=power)
    assert find_wrong_cables(ill, compare_paths(ill), low_band) == ([], {})
    power[0] = station.power[0] * other / own
    both = replace(station, power=power)
    assert find_wrong_cables(both, compare_paths(both), low_band)[1] == {0: "115"}


def test_of_one_cable_only_the_spectrum_tells_the_unit(station, low_band):
    one = station.with_cables(dict.fromkeys(range(6), "80"), low_band)
    seen = replace(one, power=one.power.mean() * np.exp(0.02 * np.log(one.power / one.power.mean())))
    power, volt = (log_likelihood_of_unit(one, ALL, unit, low_band) for unit in ("power", "volt"))
    assert power > volt
    assert log_likelihood_of_unit(seen, ALL, "power", low_band) < power


@pytest.mark.parametrize("antenna", range(6))
def test_an_antenna_that_is_dead_for_nearly_half_of_the_time_moves_the_level_of_no_cable(station, antenna):
    """Its median over times and channels together was that of its weakest channels: decibels, or another cable."""
    _, before, _ = levels_of_cables(station, ALL, np.log(station.power))
    power = station.power.copy()
    power[antenna, :, HOURS // 2 + 1 :] *= 1e-3
    _, rest, _ = levels_of_cables(station, ALL, np.log(power))
    assert np.abs(rest - before).max() < 0.02  # gains scatter by 1 %


@pytest.mark.parametrize("unit", ["power", "dB", "volt"])
def test_cables_tell_power_from_decibels_and_volts(station, low_band, unit):
    recorded = {"power": station.power, "dB": 10 * np.log10(station.power) + 200, "volt": station.power**0.5}[unit]
    seen = replace(station, power=recorded)
    could_be = ("power", "volt", "dB") if unit == "dB" else ("power", "volt")
    likelihood = {name: log_likelihood_of_unit(seen, ALL, name, low_band) for name in could_be}
    assert max(likelihood, key=lambda name: likelihood[name]) == unit


def exchange(station: AuditedStation, *rows: int) -> AuditedStation:
    """A station in which some antennas' dipoles bear each other's letter."""
    power = station.power.copy()
    power[list(rows)] = power[list(rows), ::-1]
    return replace(station, power=power)


def test_an_exchanged_antenna_is_named_with_odds(station):
    changed = exchange(station, 2)
    lines = tell_exchanged(changed, compare_polarisations(changed, EVERYBODY))
    assert [(line.verdict, line.antennas) for line in lines] == [("wrong", (2,))]
    assert (lines[0].log_odds or 0.0) > 7


@pytest.mark.parametrize("is_since", [True, False])
@pytest.mark.parametrize("others", [(), (0,)])
def test_letters_exchanged_from_a_date_on_are_told_with_the_date(station, is_since, others):
    """An antenna exchanged in the second half of a year had nothing wrong: its changes cancelled each other."""
    changed = exchange(station, *others)
    power, split = changed.power.copy(), 14
    part = slice(split, None) if is_since else slice(None, split)
    power[3, :, part] = power[3, ::-1, part]
    changed = replace(changed, power=power)
    letters = compare_polarisations(changed, EVERYBODY)
    assert letters.exchanged().tolist() == list(others)
    line = next(line for line in tell_exchanged(changed, letters) if line.antennas == (3,))
    assert (line.check, line.verdict, line.kind) == ("exchange", "wrong", "exchange")
    assert f"exchanged at antenna 3 {'since' if is_since else 'until'} a date between 2014-05-" in line.sentence
    at, none = (line.since_unix, line.until_unix) if is_since else (line.until_unix, line.since_unix)
    assert station.time_unix[split - 1] < at < station.time_unix[split]
    assert none is None
    assert np.array_equal(line.is_during(station.time_unix), (np.arange(HOURS) >= split) == is_since)


def test_letters_exchanged_for_a_spell_are_told_with_both_dates(station):
    """For thirty days of a year an antenna was exchanged, and nothing was wrong."""
    long = replace(
        station, power=np.tile(station.power, (1, 1, 4, 1)), lst_hours=np.tile(station.lst_hours, 4),
        time_unix=np.concatenate([station.time_unix + 86_400.0 * day for day in range(4)]),
    )  # fmt: skip
    power = long.power * np.exp(0.03 * np.random.default_rng(2).standard_normal((*long.power.shape[:3], 1)))
    assert compare_polarisations(replace(long, power=power), EVERYBODY).dated == []
    power[3, :, 30:44] = power[3, ::-1, 30:44]
    changed = replace(long, power=power)
    letters = compare_polarisations(changed, EVERYBODY)
    (line,) = [line for line in tell_exchanged(changed, letters) if line.antennas == (3,)]
    assert line.verdict == "wrong"
    assert line.sentence.count("a date between 2014-05-") == 2
    assert np.sum(line.is_during(long.time_unix) != (np.abs(np.arange(96) - 36.5) < 7)) <= 6


def test_lines_through_the_first_values_are_those_of_least_squares():
    x, y = np.random.default_rng(3).normal(size=(2, 9))
    found = _fit_lines(x, y)
    for n in range(3, 10):
        (slope, level), (left,), *_ = np.polyfit(x[:n], y[:n], 1, full=True)
        np.testing.assert_allclose(found[:, n - 1], [slope, n * np.var(x[:n]), left])
        assert level == pytest.approx(y[:n].mean() - slope * x[:n].mean())


def test_an_antenna_whose_ratio_steps_or_that_mixes_its_dipoles_from_a_date_on_is_not_exchanged(station):
    power = station.power.copy()
    power[2, 0, 12:] *= 0.85
    power[3, :, 12:] = 0.45 * power[3, :, 12:] + 0.55 * power[3, ::-1, 12:]
    changed = replace(station, power=power)
    assert compare_polarisations(changed, EVERYBODY).dated == []


def test_a_field_is_told_from_single_antennas(station):
    changed = exchange(station, 1, 3, 5)
    letters = compare_polarisations(changed, EVERYBODY)
    letters = letters if set(letters.exchanged()) == {1, 3, 5} else letters.flipped()
    assert "all odd antennas" in tell_exchanged(changed, letters)[0].sentence


def test_one_instant_says_what_it_cannot(station):
    ratio = np.log(station.power[:, 0] / station.power[:, 1]).mean(axis=(0, 2))
    quiet = int(np.argmin(np.abs(ratio)))
    one = replace(
        station, power=station.power[:, :, [quiet]], time_unix=station.time_unix[[quiet]],
        lst_hours=station.lst_hours[[quiet]],
    )  # fmt: skip
    lines = tell_exchanged(one, compare_polarisations(one, EVERYBODY))
    assert [line.verdict for line in lines] == ["undecided"]
    assert "some hours would" in lines[0].sentence


def test_antennas_that_do_not_work_are_not_compared(station):
    assert compare_polarisations(station, np.zeros(6, dtype=bool)).rows.size == 0


def test_an_odd_gain_in_one_instant_is_no_exchange(station):
    """A drawn station of which one antenna's gains were off by 14 % was said to be exchanged there."""
    power = np.repeat(station.power[:, :1, :1], 2, axis=1)
    power[:, 0] *= np.exp(0.1 + np.array([0.01, -0.01, 0.02, -0.135, 0.0, -0.02]))[:, None, None]
    one = replace(station, power=power, time_unix=station.time_unix[:1], lst_hours=station.lst_hours[:1])
    odds = compare_polarisations(one, EVERYBODY)
    assert odds.exchanged().size == 0
    assert odds.odds[3] > odds.odds[[0, 1, 2, 4, 5]].max()


ANTENNA, DIPOLE = 3, 1


def spoil(station: AuditedStation, kind: str) -> AuditedStation:
    """A station of which one path does not work."""
    power = station.power.copy()
    path = power[ANTENNA, DIPOLE]
    if kind == "dead":
        path[:] = 1e-3 * path.mean()
    elif kind == "deaf":
        path[:] = path.mean() / 3
    elif kind == "oscillating":
        path[:, 20:23] *= 10.0
    elif kind == "clipped":
        path[:] = 5 * path.mean() * (path / path.mean()) ** 0.3
    else:
        path *= 1.8
    return replace(station, power=power)


@pytest.mark.parametrize("kind", ["dead", "deaf", "oscillating", "clipped", "outlying"])
def test_a_path_that_does_not_work_is_named_and_no_other(station, kind):
    spoilt = spoil(replace(station, cables=np.full(6, "80"), loss=station.loss[[1] * 6]), kind)
    spoilt = replace(spoilt, power=spoilt.power / (station.loss / spoilt.loss)[:, None, None, :])
    lines, is_ill = find_ill_paths(spoilt, compare_paths(spoilt))
    assert [(line.check, line.antennas, line.dipole) for line in lines] == [(kind, (ANTENNA,), "Y")]
    assert np.argwhere(is_ill).tolist() == [[ANTENNA, DIPOLE]]


@pytest.mark.parametrize(("begin", "end"), [(8, HOURS), (0, 16), (6, 18), (0, HOURS), (9, 16), (18, HOURS)])
def test_a_path_that_is_dead_in_a_part_of_the_time_is_told_with_its_dates(station, begin, end):
    """An antenna that had worked in 103 of 300 events was dead without a date, one dead for a month all right."""
    power = station.power.copy()
    power[ANTENNA, DIPOLE, begin:end] *= 1e-3
    dead = replace(station, power=power)
    ((line,), _), time = find_ill_paths(dead, compare_paths(dead)), station.time_unix
    since = time[begin - 1 : begin + 1].mean() if begin else None
    until = time[end - 1 : end + 1].mean() if end < HOURS else None
    assert (line.check, line.since_unix, line.until_unix) == ("dead", since, until)
    assert ("since a date between" in line.sentence, "until a date between" in line.sentence) == (
        begin > 0,
        end < HOURS,
    )


@pytest.mark.parametrize("noise", [0.0, 0.04])
def test_a_path_that_does_not_follow_the_sky_at_its_usual_level_is_insensitive_and_not_exchanged(station, noise):
    """A load in the place of an antenna, as loud as an antenna, was called an exchange of X and Y (ln odds 345)."""
    rng, power = np.random.default_rng(5), station.power.copy()
    path = power[ANTENNA, DIPOLE]
    path[:] = path.mean(axis=0) * np.exp(noise * rng.standard_normal(path.shape))
    loaded = replace(station, power=power)
    lines, is_ill = find_ill_paths(loaded, compare_paths(loaded))
    assert [(line.check, line.antennas, line.dipole) for line in lines] == [("deaf", (ANTENNA,), "Y")]
    assert not compare_polarisations(loaded, ~is_ill.any(axis=1)).exchanged().size
    exchanged = exchange(station, ANTENNA)
    assert find_ill_paths(exchanged, compare_paths(exchanged))[0] == []


@pytest.mark.parametrize("value", [1e-30, 7.0])
def test_channels_without_sky_in_any_path_are_told_by_number(station, value):
    """Five constant channels of 51 made all curves a misfit of units, clock or place; ten of 1e-30 all paths dead."""
    power = station.power.copy()
    power[..., 20:22] = value * (power.mean() if value > 1 else 1.0)
    (line,) = find_empty_channels(replace(station, power=power))
    assert (line.check, line.verdict) == ("channels", "wrong")
    assert line.sentence.startswith("2 of 51 channels hold no sky in any path")
    assert "50, 51 MHz" in line.sentence
    assert find_empty_channels(station) == []


def test_a_path_with_the_numbers_of_another_is_a_copy(station):
    power = station.power.copy()
    power[ANTENNA, 1] = power[ANTENNA, 0]
    (line,) = find_copies(replace(station, power=power))
    assert (line.check, line.verdict, line.antennas, line.dipole) == ("copy", "wrong", (ANTENNA,), "Y")
    assert find_copies(replace(station, power=np.where(np.arange(2)[:, None, None], 7.0, power))) == [], "constant"
    assert find_copies(station) == []


def test_spectra_copied_for_some_events_are_told_with_their_number_and_days(station):
    """Two months of one antenna under the number of another were a change of gain for 61 days."""
    power, time = station.power.copy(), station.time_unix
    power[ANTENNA, :, 5:9] = power[0, :, 5:9]
    lines = find_copies(replace(station, power=power))
    assert [(line.antennas, line.dipole) for line in lines] == [
        ((int(station.antennas[0]), int(station.antennas[ANTENNA])), letter) for letter in station.dipoles
    ]
    assert f" in 4 of {time.size} events, 2014" in lines[0].sentence
    assert np.flatnonzero(lines[0].is_during(time)).tolist() == [5, 6, 7, 8]


def test_coarse_or_constant_numbers_are_no_copies(station):
    power = np.round(np.log(station.power[..., :2]))  # of two channels, which other events hold as well
    assert np.all(power[0, 0, 0] == power[0, 0, 1])
    assert find_copies(replace(station, power=power)) == []
    power = station.power.copy()
    power[:2, :, 4:] = 7.0
    assert find_copies(replace(station, power=power)) == []


def test_a_rise_to_the_end_of_the_band_must_be_twice_as_tall_as_a_peak(station):
    nu = station.frequency_mhz
    for centre, factor, kinds in ((55.0, 2.5, ["oscillating"]), (30.0, 2.5, []), (80.0, 6.0, ["oscillating"])):
        power = station.power.copy()
        power[2, 0] *= factor ** np.exp(-0.5 * ((nu - centre) / 1.5) ** 2)
        spoiled = replace(station, power=power)
        assert [line.check for line in find_ill_paths(spoiled, compare_paths(spoiled))[0]] == kinds, (centre, factor)


@pytest.mark.parametrize(("sizes", "kinds"), [([0.02, 0.1, 0.13], []), ([0.02, 0.02, 0.13], ["outlying"] * 2)])
def test_a_path_is_odd_where_the_others_scatter_less_and_not_where_two_do_as_much(station, sizes, kinds):
    """Antennas that are unlike in one form have a median r.m.s. that is small beside that of some of them."""
    form = np.sqrt(2.0) * np.cos(np.linspace(0.0, 2 * np.pi, station.frequency_mhz.size))
    profile = np.outer([0.01, -0.01, 0.01, *sizes], form)[:, None, :].repeat(2, axis=1)
    alike = replace(station, cables=np.full(6, "80"))
    lines, _ = find_ill_paths(alike, replace(compare_paths(alike), profile=profile))
    assert [line.check for line in lines] == kinds


def test_a_working_path_follows_the_others_wholly(station):
    comparison = compare_paths(station)
    np.testing.assert_allclose(comparison.follows, 1.0, atol=1e-6)
    np.testing.assert_allclose(comparison.shares, 1.0, atol=0.05)


def step(station: AuditedStation, factor: float, rows: np.ndarray = ALL) -> AuditedStation:
    power = station.power.copy()
    power[rows, :, 10:] *= factor
    return replace(station, power=power)


@pytest.mark.parametrize("factor", [2.0, 0.25])
def test_a_step_is_found_with_size_and_date(station, factor):
    (line,) = find_steps(step(station, factor), ALL)
    assert (line.check, line.verdict) == ("stepped", "wrong")
    assert line.value == pytest.approx(10 * np.log10(factor), abs=0.3)
    assert "about 2014-05-14 02:2" in line.sentence


def test_a_small_step_that_of_a_few_antennas_and_a_slope_in_time_are_left_to_others(station):
    rising = replace(station, power=station.power * np.linspace(1.0, 4.0, 24)[:, None])
    for other in (step(station, 1.2), step(station, 4.0, np.array([0, 1])), rising):
        assert find_steps(other, ALL) == []


def test_the_sky_is_not_asked_of_two_chains(spectra, low_band):
    late = spectra.time_unix[:, None] > np.median(spectra.time_unix)
    report = audit(replace(spectra, power=np.where(late, 4.0, 1.0) * spectra.power), low_band, antenna="hamaker")
    assert [line.check for line in report.lines] == ["stepped"]
