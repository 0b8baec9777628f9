import json
from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.drift.follow import History, _fit_line, follow
from lbacal_core.drift.report import SILENT_EVENTS, _drop_noise, _silent, describe_followed, list_changes
from validation.drift_world import DAY, START, YEAR, World, draw_history

WORLD = World(years=3.0, stations=3, antennas=4, events_per_year=400)


def test_a_trend_of_all_is_of_the_whole_and_of_no_path():
    found = follow(draw_history(replace(WORLD, trend=0.03, yearly=0.0), np.random.default_rng(1)))
    assert found.whole is not None
    assert found.stations is not None
    assert abs(found.whole.slope[0] - 0.03) < 3 * found.whole.sigma[0] + 0.003
    assert found.paths.slope_significance.max() < found.paths.threshold
    assert found.stations.slope_significance.max() < found.stations.threshold


def test_a_slope_of_a_station_is_of_no_path_of_it():
    history = draw_history(WORLD, np.random.default_rng(2))
    rows = np.flatnonzero(history.station == "CS003")
    history.ln_c[rows, :, 0] += (0.02 * (history.time_unix - START) / YEAR).astype(np.float32)
    found = follow(history)
    assert found.stations is not None
    is_found = found.stations.slope_significance > found.stations.threshold
    assert {station for (station, _), yes in zip(found.groups, is_found, strict=True) if yes} == {"CS003"}
    assert found.paths.slope_significance.max() < found.paths.threshold


def test_two_stations_are_not_compared_and_still_have_a_whole():
    found = follow(draw_history(replace(WORLD, stations=2), np.random.default_rng(3)))
    assert found.stations is None
    assert found.whole is not None
    assert found.whole.years == 3


def test_two_antennas_are_compared_over_both_polarisations_and_one_with_nothing():
    """A station of two antennas has no three paths of one polarisation, and its steps were not looked for."""
    history = draw_history(replace(WORLD, stations=1, antennas=2), np.random.default_rng(4))
    history.ln_c[1, np.flatnonzero(history.time_unix >= START + 1.5 * YEAR), 0] += 0.06
    found = follow(history)
    assert found.groups == (("CS002", "XY"),)
    assert np.isfinite(found.paths.terms.dates).sum(axis=1).tolist() == [0, 1, 0, 0]
    alone = follow(draw_history(replace(WORLD, stations=1, antennas=1), np.random.default_rng(5)))
    assert not np.any(np.isfinite(alone.paths.terms.dates))
    assert alone.paths.events.tolist() == [0, 0]
    assert alone.whole is None


def test_a_station_of_one_antenna_hides_no_step_of_another():
    """All polarisations had to have three stations, that of its two paths as well: none was compared."""
    history = draw_history(WORLD, np.random.default_rng(4))
    single = draw_history(replace(WORLD, stations=1, antennas=1), np.random.default_rng(5))
    at = np.linspace(0, single.time_unix.size - 1, history.time_unix.size).astype(int)
    history.ln_c[np.ix_(history.station == "CS003", history.time_unix >= START + 1.5 * YEAR, [0])] += 0.06
    found = follow(
        replace(
            history,
            station=np.append(history.station, ["RS106", "RS106"]),
            antenna=np.append(history.antenna, single.antenna),
            dipole=np.append(history.dipole, single.dipole),
            ln_c=np.concatenate([history.ln_c, single.ln_c[:, at]]),
            known_unix=np.full((len(history.station) + 2, 0), np.inf),
        )
    )
    assert found.stations is not None
    stepped = np.any(np.isfinite(found.stations.terms.dates), axis=1)
    assert {of for of, yes in zip(found.groups, stepped, strict=True) if yes} == {("CS003", "X"), ("CS003", "Y")}


def test_years_are_as_correlated_as_the_integral_over_all_lines_says():
    """Over level and slope, flat, and over the scatter s, 1/s: what is left of s^-n exp(-Q / 2 s^2) is Q^(-n/2)."""
    year, rng = np.array([0, 1, 3, 4, 6]), np.random.default_rng(4)
    when, level = year - year.mean(), 0.05 * rng.standard_normal((5, 1))
    turn = np.linspace(-np.pi / 2, np.pi / 2, 801)[1:-1]
    start, slope = np.meshgrid(0.05 * np.tan(turn), 0.03 * np.tan(turn))
    volume = 1.0 / np.cos(turn[:, None]) ** 2 / np.cos(turn) ** 2
    told, integral = [], []
    for correlation in (0.0, 0.2, 0.5):
        told.append(_fit_line(year, when, level, correlation)[0].log_likelihood)
        covariance = np.where(np.eye(5) > 0, 1.0, correlation ** np.abs(year[:, None] - year))
        left = level[:, 0] - start[..., None] - slope[..., None] * when
        q = np.einsum("abi,ij,abj->ab", left, np.linalg.inv(covariance), left, optimize=True)
        integral.append(np.log(np.sum(q**-2.5 * volume)) - 0.5 * np.log(np.linalg.det(covariance)))
    assert np.diff(told) == pytest.approx(np.diff(integral), abs=0.005)


def test_a_path_that_is_measured_no_longer_while_its_station_is_was_silent_to_the_end():
    history = draw_history(replace(WORLD, years=0.2), np.random.default_rng(6))
    events = history.time_unix.size
    history.ln_c[...] = 0.0
    history.ln_c[3, -SILENT_EVENTS:] = np.nan
    history.ln_c[4, -SILENT_EVENTS + 1 :] = np.nan  # too few to tell
    history.ln_c[5, : events // 2] = np.nan  # it came back
    history.ln_c[6] = np.nan  # never measured
    history.ln_c[history.station == "CS003", -2 * SILENT_EVENTS :] = np.nan  # the whole station rests
    assert list(_silent(history)) == [
        {"station": "CS002", "antenna": 1, "dipole": "Y", "last_unix": history.time_unix[-SILENT_EVENTS - 1]}
    ]


MHZ = np.arange(30.0, 81.0)


def test_a_report_tells_changes_slopes_and_the_trend_in_frequency():
    world = World(years=3.0, stations=3, antennas=4, events_per_year=400, yearly=0.01)
    history = draw_history(replace(world, trend=0.05), np.random.default_rng(1))
    after = np.flatnonzero(history.time_unix >= START + 1.5 * YEAR)
    history.ln_c[5, after, 0] += np.log(1.08)
    history.ln_c[..., 1] += (0.01 * (history.time_unix - START) / YEAR).astype(np.float32)
    report = describe_followed(history, follow(history), MHZ)
    json.dumps(report, allow_nan=False)
    (change,) = report["changes"]
    assert [(m["antenna"], m["dipole"]) for m in change["members"]] == [(2, "Y")]
    assert change["size"] == pytest.approx(0.08, abs=4 * change["sigma"])
    assert abs(change["date_unix"] - START - 1.5 * YEAR) < 5 * DAY
    assert len(report["slopes"]) == 24 + 6
    assert not any(one["is_found"] for one in report["slopes"])
    assert set(report["trends"]) == {"array", "CS002", "CS003", "CS004"}
    whole = report["trends"]["array"]
    assert whole["slope"] == pytest.approx(0.05, abs=whole["limit_95"])
    # a tilt of 0.01 a year: half of what lies between the lowest and the highest channel
    ends = np.array(whole["frequency"]["slope"])[[0, -1]]
    assert np.diff(ends) / 2 == pytest.approx([0.01], abs=0.001)


def test_a_season_that_was_seen_once_may_as_well_be_a_step():
    for years in (1.0, 2.0):
        history = draw_history(replace(WORLD, years=years), np.random.default_rng(7))
        history.ln_c[5, :, 0] += 0.08 * np.cos(2 * np.pi * (history.time_unix - START) / YEAR)
        slopes = describe_followed(history, follow(history), MHZ)["slopes"]
        assert any(one["season_is_found"] for one in slopes) == (years > 1.0)


TWO_YEARS = World(years=2.0, stations=1, antennas=12, events_per_year=500, yearly=0.03)


def _history(seed: int) -> History:
    return draw_history(TWO_YEARS, np.random.default_rng(seed))


def test_paths_that_step_together_are_one_change_with_its_members():
    history = _history(1)
    after = np.flatnonzero(history.time_unix >= START + 0.9 * YEAR)
    for path in (2, 3, 8):
        history.ln_c[path, after, 0] += 0.04
    changes = list_changes(history, follow(history))
    assert len(changes) == 1
    assert {(m.antenna, m.dipole) for m in changes[0].members} == {(1, "X"), (1, "Y"), (4, "X")}
    assert changes[0].date_unix == pytest.approx(START + 0.9 * YEAR, abs=5 * DAY)
    assert changes[0].members[0].size[0] == pytest.approx(0.04, abs=4 * changes[0].members[0].sigma[0])


def test_steps_at_two_dates_are_two_changes():
    history = _history(2)
    for path, year in ((2, 0.7), (9, 1.3)):
        history.ln_c[path, np.flatnonzero(history.time_unix >= START + year * YEAR), 0] += 0.04
    changes = list_changes(history, follow(history))
    assert sorted(len(change.members) for change in changes) == [1, 1]


def test_two_steps_of_a_path_are_two_changes_however_near():
    """A failure known to ten days and its repair were one change, of two sizes at the date of the repair."""
    history = _history(2)
    at = (history.time_unix >= START + 0.9 * YEAR) & (history.time_unix < START + 0.98 * YEAR)
    history.ln_c[2, np.flatnonzero(at), 0] -= 0.08
    followed = follow(history)
    sigma = np.where(np.isfinite(followed.paths.step_sigma_s), 20 * DAY, np.nan)
    changes = list_changes(history, replace(followed, paths=replace(followed.paths, step_sigma_s=sigma)))
    assert sorted(len(change.members) for change in changes) == [1, 1]


def test_a_date_known_to_weeks_agrees_with_that_of_another_antenna_by_chance():
    """A step of 1 % got the date of a cable of another antenna, a fortnight off, with an error of a day."""
    history = _history(2)
    for path, year in ((2, 0.9), (3, 0.9), (8, 0.94)):
        history.ln_c[path, np.flatnonzero(history.time_unix >= START + year * YEAR), 0] += 0.04
    followed = follow(history)
    sigma = followed.paths.step_sigma_s.copy()
    sigma[8] = 25 * DAY
    changes = list_changes(history, replace(followed, paths=replace(followed.paths, step_sigma_s=sigma)))
    members = [{(m.antenna, m.dipole) for m in change.members} for change in changes]
    assert sorted(members, key=len) == [{(4, "X")}, {(1, "X"), (1, "Y")}]


def test_a_known_change_says_so_and_has_no_error_of_its_date():
    history = _history(3)
    known = np.full((24, 1), np.inf)
    known[5] = START + 1.1 * YEAR
    told = History(history.station, history.antenna, history.dipole, history.time_unix, history.ln_c, known)
    changes = list_changes(told, follow(told))
    assert [(change.is_known, change.date_sigma_s) for change in changes] == [(True, 0.0)]
    assert changes[0].date_unix == pytest.approx(START + 1.1 * YEAR)


def test_noise_beside_a_step_was_told_as_a_step_and_cut_the_windows_of_a_sound_antenna() -> None:
    """Among three antennas a step of 51 sigma made another one step by 0.17 ± 0.14 %."""
    members = [{"antenna": a, "dipole": "Y", "significance": sigma} for a, sigma in ((1, 51.4), (2, 2.5), (0, 4.1))]
    for is_known, kept in ((False, [1, 0]), (True, [1, 2, 0])):
        report = {"threshold_sigma": 3.9, "changes": [{"is_known": is_known, "members": list(members)}]}
        assert [one["antenna"] for one in _drop_noise(report)["changes"][0]["members"]] == kept


def test_an_alarm_named_a_path_twice_that_stepped_twice_within_the_error_of_the_date():
    """It read "3 together (antenna 6 X, antenna 6 Y, antenna 6 Y)"."""
    members = [
        {"antenna": 6, "dipole": dipole, "significance": found} for dipole, found in zip("XYY", (10, 8, 6), strict=True)
    ]
    report = {"threshold_sigma": 5.0, "changes": [{"is_known": False, "members": members}]}
    assert _drop_noise(report)["changes"][0]["members"] == members[:2]
