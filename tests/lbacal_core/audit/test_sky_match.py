from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.audit.sky_match import SkyMatch, is_summer_time, load_models
from lbacal_core.audit.station import (
    BAND_SPREAD,
    SHARE,
    SHARE_SPREAD,
    AnyReceiver,
    AuditedStation,
    Seen,
    SeriesLikelihood,
    make_series,
    mean_frequencies,
    split_stations,
    spread,
)
from lbacal_core.audit.verdict import Possibility, conclude, tell_drift
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.sky.differences import DifferenceModels
from lbacal_core.sky.power import compute_sky_power
from tests.lbacal_core.audit.conftest import HOURS

ALL = np.arange(6)


def match_of(station: AuditedStation, instrument: Instrument) -> SkyMatch:
    models = load_models(instrument, mean_frequencies(station.frequency_mhz), "gsm", "hamaker")
    return SkyMatch(station, instrument, lambda: models)


def tell(station: AuditedStation, instrument: Instrument) -> dict[str, tuple[str, float | None]]:
    lines = match_of(station, instrument).tell(ALL)
    return {line.check: (line.verdict, line.value) for line in lines}


def test_a_true_record_is_confirmed(station, low_band):
    said = tell(station, low_band)
    assert {check: verdict for check, (verdict, _) in said.items()} == {"clock": "right", "arms": "right"}


@pytest.mark.parametrize("hours", [-3.0, 1.75, 9.0])
def test_a_clock_that_is_off_is_measured(station, low_band, hours):
    late = replace(station, lst_hours=(station.lst_hours + hours) % 24)
    verdict, value = tell(late, low_band)["clock"]
    assert verdict == "wrong"
    assert value == pytest.approx(-hours, abs=1 / 60)


def test_a_clock_that_is_later_in_half_of_the_time_drifts_and_one_that_is_late_all_along_does_not(station, low_band):
    scatter = np.random.default_rng(3).normal(1.0, 0.05, (6, 2, 2 * HOURS, 1))
    power, time = scatter * np.tile(station.power, (1, 1, 2, 1)), np.append(station.time_unix, station.time_unix + 1e6)
    for later, drifts in ((3.5, True), (2.0, False)):
        lst = np.append(station.lst_hours - 2.0, station.lst_hours - later) % 24
        line, *_ = match_of(replace(station, power=power, time_unix=time, lst_hours=lst), low_band).tell(ALL)
        assert (line.check, "a clock that drifts or steps" in line.sentence) == ("clock", drifts)


def test_turned_arms_are_measured_and_a_right_angle_is_an_exchange(station, low_band):
    turned = replace(low_band, dipole_azimuth_deg={"X": 85.0, "Y": 175.0})
    verdict, value = tell(station, turned)["arms"]
    assert (verdict, value) == ("wrong", pytest.approx(-40.0, abs=1.0))
    exchanged = replace(low_band, dipole_azimuth_deg={"X": 135.0, "Y": 45.0})
    assert tell(station, exchanged)["exchange"][0] == "wrong"


@pytest.mark.parametrize("arm", ["X", "Y"])
def test_one_arm_that_is_turned_alone_is_named_and_measured(station, low_band, arm):
    """X at 65 deg on record instead of 45 was told as both arms turned by -11 +- 1 deg."""
    arms = low_band.dipole_azimuth_deg
    turned = replace(low_band, dipole_azimuth_deg={**arms, arm: arms[arm] + 40.0})
    (line,) = match_of(station, turned).tell(ALL)
    assert (line.check, line.verdict, line.dipole) == ("arms", "wrong", arm)
    assert line.value == pytest.approx(-40.0, abs=3.0 * line.sigma)
    assert f"the arm of {arm} alone is turned by -40 +- " in line.sentence


def test_a_latitude_of_the_other_hemisphere_is_named(station, low_band):
    assert tell(station, replace(low_band, latitude_deg=-low_band.latitude_deg))["place"][0] == "wrong"


def test_a_latitude_that_is_off_is_measured(station, low_band):
    """Fifteen degrees were "nothing wrong" where a fit called every path a misfit."""
    (line,) = match_of(station, replace(low_band, latitude_deg=low_band.latitude_deg - 15.0)).tell(ALL)
    assert (line.check, line.verdict, line.unit) == ("place", "wrong", "deg")
    assert line.value == pytest.approx(15.0, abs=3.0 * line.sigma)
    assert line.sentence == f"the latitude is {line.value:+.1f} +- {line.sigma:.1f} deg from the record"


def test_minutes_determine_no_clock(station, low_band):
    short = replace(
        station, power=station.power[:, :, :1], time_unix=station.time_unix[:1], lst_hours=station.lst_hours[:1]
    )
    assert {verdict for verdict, _ in tell(short, low_band).values()} == {"undecided"}


def test_exchanged_letters_fit_better_exchanged(station, low_band):
    match = match_of(replace(station, power=station.power[:, ::-1]), low_band)
    assert match.gain_of_exchange(ALL) > 20


def test_a_longitude_beyond_90_deg_was_never_a_latitude_and_its_sign_is_a_shift_of_less_than_half_a_day(
    station, low_band
):
    """Decibels in Western Australia were told as an exchange of the two: at the pole that this gave no sky changes."""
    there = replace(low_band, longitude_deg=-116.6)
    shifted = replace(station, lst_hours=(station.lst_hours + 2 * -116.6 / 15) % 24)
    (line,) = match_of(shifted, there).tell(ALL)
    assert (line.check, line.verdict) == ("place", "wrong")
    assert "the longitude has the wrong sign (-507 min)" in line.sentence
    assert "exchanged" not in line.sentence


def test_summer_time_of_europe_begins_and_ends_on_the_last_sundays_of_march_and_october():
    edges = np.array(["2014-03-30T01", "2014-10-26T01", "2015-03-29T01", "2015-10-25T01"], dtype="datetime64[s]")
    at = edges.astype(float)
    assert is_summer_time(at).tolist() == [True, False, True, False]
    assert is_summer_time(at - 1.0).tolist() == [False, True, False, True]


FREQUENCY, LST = np.array([40.0, 60.0]), np.arange(24.0)


def test_what_is_seen_is_the_sky_power_over_its_mean(low_band):
    seen = load_models(low_band, FREQUENCY, "gsm", "hamaker").seen(LST, low_band.latitude_deg)
    power = compute_sky_power(low_band, antenna="hamaker")
    at = np.searchsorted(low_band.frequency_mhz, FREQUENCY)
    for d, dipole in enumerate(low_band.dipoles):
        expected = power.at(dipole, LST)[:, at].T
        np.testing.assert_allclose(seen.change[d], expected / expected.mean(axis=1, keepdims=True) - 1.0, atol=1e-6)


def test_a_difference_is_the_exchange_of_one_model(low_band):
    others = DifferenceModels(skies=("gsm", "lfsm"), antennas=("inverted-v",))
    known = load_models(low_band, FREQUENCY, "gsm", "hamaker", others)
    seen = known.seen(LST, low_band.latitude_deg)
    assert seen.differences.shape == (2, 2, 2, 24)
    of_lfsm = load_models(low_band, FREQUENCY, "lfsm", "hamaker", others).seen(LST, low_band.latitude_deg)
    np.testing.assert_allclose(seen.differences[0], of_lfsm.change - seen.change, atol=1e-9)


def test_arms_turned_by_a_right_angle_see_what_the_other_arm_saw(low_band):
    models = load_models(low_band, FREQUENCY, "gsm", "hamaker")
    plain, turned = (models.seen(LST, low_band.latitude_deg, angle).change for angle in (0.0, 90.0))
    np.testing.assert_allclose(turned, plain[::-1], atol=1e-9)


def test_spectra_are_laid_out_by_antenna_dipole_and_time(spectra, station):
    row = np.flatnonzero((spectra.antenna == 4) & (spectra.dipole == "Y"))[7]
    np.testing.assert_array_equal(station.power[4, 1, 7], spectra.power[row])
    assert station.hours == pytest.approx(24.0)


def test_hours_are_those_of_sidereal_time_that_is_covered(station):
    days = np.arange(24) * 86_164.09
    once = replace(station, time_unix=days, lst_hours=np.linspace(23.6, 24.4, 24) % 24)
    assert once.hours == pytest.approx(0.8)
    assert once.length == "48 min of sidereal time do"
    twice = replace(once, lst_hours=np.where(np.arange(24) % 2, once.lst_hours, (once.lst_hours + 12) % 24))
    assert twice.hours < 2.0


def test_missing_spectra_are_nan_and_nothing_else_is(spectra, low_band):
    kept = np.ones(len(spectra), dtype=bool)
    kept[np.flatnonzero((spectra.antenna == 2) & (spectra.dipole == "X"))[3]] = False
    station = next(split_stations(spectra.select(kept), low_band))
    assert np.argwhere(np.isnan(station.power[..., 0])).tolist() == [[2, 0, 3]]


def test_other_cables_change_what_is_before_them(station, low_band):
    changed = station.with_cables({1: "50"}, low_band)
    assert changed.cables[1] == "50"
    difference = changed.before_cable() - station.before_cable()
    np.testing.assert_allclose(difference[1, 0, 0], np.log(low_band.cables["80"] / low_band.cables["50"]))
    assert not difference[[0, 2, 3, 4, 5]].any()


def test_spread_is_that_of_a_normal_distribution_and_ignores_outliers():
    values = np.random.default_rng(1).normal(0.0, 2.0, 4001)
    values[:100] = 1e6
    assert spread(values) == pytest.approx(2.0, rel=0.1)


def test_other_channels_than_the_instruments_are_refused(spectra, low_band):
    with pytest.raises(BadInputError, match="frequency_mhz"):
        list(split_stations(replace(spectra, frequency_mhz=spectra.frequency_mhz + 0.5), low_band))


def test_clocks_of_antennas_that_differ_within_an_event_do_not_tear_it_apart(spectra, low_band):
    late = replace(spectra, time_unix=spectra.time_unix + 0.01 * spectra.antenna)
    station = next(split_stations(late, low_band))
    assert station.time_unix.size == 24
    assert np.isfinite(station.power).all()


def draw_sky(likelihood: SeriesLikelihood, seed: int) -> Seen:
    """Some change of the sky with time in every band, and three models that differ in it."""
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * likelihood.series.lst_hours / 24
    shape = likelihood.series.power.shape[:2]
    change = 0.2 * np.cos(angle - rng.uniform(0, 6, (*shape, 1)))
    return Seen(change, 0.02 * np.cos(angle - rng.uniform(0, 6, (3, *shape, 1))))


def test_series_has_mean_one_and_keeps_the_order_of_instants(station):
    series = make_series(station, np.arange(6))
    np.testing.assert_allclose(series.power.mean(axis=-1), 1.0)
    np.testing.assert_allclose(series.lst_hours, station.lst_hours)


def test_likelihood_is_that_of_the_dense_normal_distribution(station):
    likelihood = SeriesLikelihood(make_series(station, np.arange(6)))
    covariance = likelihood.covariance
    values = likelihood.series.power.ravel() - 1.0

    def dense(seen: Seen) -> float:
        change = seen.change.reshape(8, -1)
        columns = np.zeros((values.size, 8))
        for k in range(8):
            columns[k * change.shape[1] : (k + 1) * change.shape[1], k] = change[k]
        whole = covariance + columns @ (BAND_SPREAD**2 * np.eye(8) + SHARE_SPREAD**2) @ columns.T
        differences = SHARE * (seen.differences * likelihood.follows.reshape(2, 4, 1)).reshape(3, -1).T
        whole += differences @ differences.T
        rest = values - SHARE * columns.sum(axis=1)
        return float(-rest @ np.linalg.solve(whole, rest) / 2 - np.linalg.slogdet(whole)[1] / 2)

    one, other = draw_sky(likelihood, 1), draw_sky(likelihood, 2)
    expected = dense(one) - dense(other)
    assert likelihood.log_likelihood(one) - likelihood.log_likelihood(other) == pytest.approx(expected, rel=1e-6)


def test_bands_follow_the_common_change_by_their_share_of_the_sky(station):
    series = make_series(station, np.arange(6))
    power = series.power.copy()
    power[:, 3] = 1.0 + 0.5 * (power[:, 0] - 1.0)
    follows = SeriesLikelihood(replace(series, power=power)).follows.reshape(2, 4)
    np.testing.assert_allclose(follows[:, 3], 0.5 * follows[:, 0])


def test_share_of_the_sky_is_found_beside_what_models_differ_by(station):
    likelihood = SeriesLikelihood(make_series(station, np.arange(6)))
    sky = draw_sky(likelihood, 3)
    seen = 0.4 * sky.change + SHARE * sky.differences[1] * likelihood.follows.reshape(2, 4, 1)
    likelihood.rest = likelihood.whiten @ seen.ravel()
    assert likelihood.share(sky)[0] == pytest.approx(0.4, abs=0.01)


def test_an_instant_in_which_one_band_departs_is_noise(station):
    quiet = make_series(station, np.arange(6)).noise
    power = station.power.copy()
    power[..., :13] *= np.random.default_rng(1).normal(1.0, 0.03, (station.power.shape[2], 1))
    noise = make_series(replace(station, power=power), np.arange(6)).noise
    assert noise[:, 0].min() > 0.01 > quiet.max()


def test_a_receiver_whose_colour_changes_is_described_and_another_sky_is_not(station):
    series = make_series(station, np.arange(6))
    sky = draw_sky(SeriesLikelihood(series), 4)
    drift = 0.03 * np.cos(4 * np.pi / 24 * series.lst_hours) * np.array([-1.0, -0.3, 0.3, 1.0])[:, None]
    seen = replace(series, power=1.0 + SHARE * sky.change + drift)
    gain = [one.log_likelihood(sky) for one in (AnyReceiver(seen, 6), SeriesLikelihood(seen))]
    assert gain[0] > gain[1] + 50
    assert AnyReceiver(seen, 6).fits(sky)
    noisy = replace(seen, power=seen.power + np.random.default_rng(1).normal(0.0, 0.1, seen.power.shape))
    assert not AnyReceiver(noisy, 6).fits(sky)


def test_a_record_that_nothing_beats_is_confirmed_where_the_data_determine_it():
    lines = conclude("CS002", 0.0, [Possibility("clock", -3.0, 0.01, 0.02), Possibility("arms", -3.0, 1.0, 30.0)])
    assert [(line.check, line.verdict) for line in lines] == [("clock", "right"), ("arms", "undecided")]


def test_possibilities_that_are_as_likely_are_all_named_and_none_is_chosen():
    (line,) = conclude("CS002", 0.0, [Possibility("clock", 40.0, 6.2, 0.3), Possibility("exchange", 38.0)])
    assert (line.check, line.verdict, line.candidates) == ("record", "wrong", ("clock", "exchange"))
    assert "a sidereal day would" in line.sentence


def test_arms_that_may_be_turned_together_or_one_alone_have_an_error_that_covers_both():
    told = [Possibility("arms", 41.0, -7.0, 0.6), Possibility("arm", 39.0, -11.0, 1.0, dipole="X")]
    (line,) = conclude("CS002", 0.0, told)
    assert (line.check, line.dipole, line.value, line.candidates) == ("arms", None, -7.0, ())
    assert line.sigma == pytest.approx(4.0, abs=0.1)
    assert "both arms are turned by -7 +- 1 deg" in line.sentence
    assert "or the arm of X alone is turned by -11 +- 1 deg" in line.sentence


def test_one_arm_along_the_other_may_be_mixed_power_and_no_arm_is_named():
    """X and Y that are mixed by halves see the same, as with one arm turned by a right angle."""
    (line,) = conclude("CS002", 0.0, [Possibility("arm", 41.0, -88.0, 3.0, dipole="Y"), Possibility("arms", 2.0, 3.0)])
    assert (line.check, line.candidates, line.kind) == ("record", ("exchange", "arms"), "")
    assert "power of X and Y is mixed, or the arm of Y alone is turned by -88 +- 3 deg" in line.sentence


def test_arms_turned_by_about_a_right_angle_are_an_exchange_of_letters():
    (line,) = conclude("CS002", 0.0, [Possibility("arms", 41.0, -80.0, 6.0), Possibility("exchange", 40.0)])
    assert line.check == "exchange"


def test_a_shift_of_just_what_a_wrong_sign_of_the_longitude_makes_is_this_sign_or_a_clock_in_one_statement():
    (line,) = conclude(
        "CS002", 0.0, [Possibility("clock", 41.0, -0.92, 0.02), Possibility("longitude sign", 44.0, -0.916)]
    )
    assert (line.check, line.value) == ("place", -0.92)
    assert "the longitude has the wrong sign (-55 min); or a clock that is 55 min ahead" in line.sentence


def test_an_hour_late_is_no_longitude_of_the_wrong_sign_where_that_is_five_minutes_less():
    """At 6.9 deg a wrong sign shifts sidereal time by 55 min: a year of local winter time was told as this sign."""
    (line,) = conclude(
        "CS002", 0.0, [Possibility("clock", 90.0, -1.0, 0.03), Possibility("longitude sign", 92.0, -0.916)]
    )
    assert line.check == "clock"
    assert "UTC+1 instead of UTC (-60 min); or the longitude has the wrong sign (-55 min)" in line.sentence


def test_a_shift_that_is_no_whole_hour_is_a_clock_or_a_longitude_and_what_decides_is_said():
    (line,) = conclude(
        "CS002", 0.0, [Possibility("clock", 90.0, 1.4, 0.03), Possibility("longitude sign", 9.0, -0.916)]
    )
    assert (line.check, line.value) == ("clock", 1.4)
    assert ": a clock that is 84 min behind, or a longitude that is 21.0 deg too far west, or masts" in line.sentence
    assert "UTC" not in line.sentence


def test_a_clock_that_is_off_by_a_whole_hour_is_that_of_a_time_zone():
    (line,) = conclude("CS002", 0.0, [Possibility("clock", 90.0, -2.01, 0.02)])
    assert "the times are of UTC+2 instead of UTC (-120 min); or a clock" in line.sentence
    assert line.unit == "h"


def test_a_clock_that_differs_between_halves_of_the_time_drifts():
    """A clock that ran from 0 to 60 min in a year was told as 35 +- 2 min all along."""
    (line,) = conclude("CS002", 0.0, [Possibility("clock", 90.0, 0.59, 0.03)])
    first, later, same = (Possibility("clock", 90.0, value, 0.05) for value in (0.35, 0.74, 0.5))
    drifts = tell_drift(line, first, later, "2014-07-02")
    assert "is +21 +- 3 min before 2014-07-02 and +44 +- 3 min after" in drifts.sentence
    assert drifts.sigma == pytest.approx(0.2, abs=0.01)
    assert tell_drift(line, first, same, "2014-07-02") is line


def test_a_unit_that_is_likelier_but_not_certain_is_said_beside_what_is_confirmed():
    lines = conclude("S1", 0.0, [Possibility("clock", -3.0, 0.01, 0.02), Possibility("dB", 7.0)])
    assert [(line.check, line.verdict) for line in lines] == [("clock", "right"), ("unit", "undecided")]
    assert "perhaps the power is in decibels" in lines[1].sentence


def test_a_unit_that_is_likelier_is_said_where_something_else_is_likelier_still_and_not_certain():
    lines = conclude("S1", 0.0, [Possibility("dB", 7.0), Possibility("latitude", 8.0, 36.0, 5.0)])
    assert [(line.check, line.verdict, line.log_odds) for line in lines] == [("unit", "undecided", 7.0)]


def test_an_hour_lists_what_a_day_would_leave_out():
    """In drawn hours the truth was up to 6 below the best: an hour named a latitude where arms were turned."""
    told = [Possibility("latitude sign", 40.0, 0.0), Possibility("arms", 34.0, -57.0, 9.0)]
    assert [conclude("S1", 0.0, told, hours)[0].check for hours in (1.0, 23.9)] == ["record", "place"]


def test_a_clock_that_fits_better_than_a_place_of_the_same_shift_is_not_left_out():
    told = [Possibility("clock", 40.0, 3.47, 0.185), Possibility("latitude for longitude", 36.0, 3.07)]
    assert conclude("S1", 0.0, told)[0].candidates == ("clock", "place")


def test_a_possibility_that_does_not_describe_the_data_either_is_not_named():
    told = [Possibility("clock", 400.0, 7.1, 0.1, fits=False), Possibility("arms", 3.0, 4.0, 2.0)]
    lines = conclude("S1", 0.0, told, base_fits=False)
    assert [(line.check, line.verdict) for line in lines] == [("clock", "undecided"), ("arms", "undecided")]
    assert "neither the record nor anything else" in lines[0].sentence


def test_a_record_that_does_not_describe_the_data_is_not_confirmed():
    (line,) = conclude("S1", 0.0, [Possibility("clock", -3.0, 0.01, 0.02)], base_fits=False)
    assert line.verdict == "undecided"


def test_a_clock_far_from_the_record_confirms_nothing():
    """`right clock: +460 +- 44 min` stood in a report."""
    (line,) = conclude("S1", 0.0, [Possibility("clock", 1.1, 460 / 60, 0.73)])
    assert line.verdict == "undecided"
    assert "not confirmed, and not enough to call it wrong: sidereal time is +460 +- 44 min" in line.sentence
