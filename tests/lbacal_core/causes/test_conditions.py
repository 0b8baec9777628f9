from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from lbacal_core.causes.antenna import DipoleSwap
from lbacal_core.causes.axes import AXES, _period, axis_named, list_axes
from lbacal_core.causes.cable import CableReflection
from lbacal_core.causes.sky import sky_ratios
from lbacal_core.sky.power import vary_sky_power


def seconds(date):
    return datetime.fromisoformat(date).replace(tzinfo=UTC).timestamp()


@pytest.fixture(scope="module")
def conditions(world):
    return world.look().data.conditions


@pytest.mark.parametrize(
    ("phase_deg", "warmest"), [(0.0, "2014-01-01"), (90.0, "2014-04-02"), (180.0, "2014-07-02"), (270.0, "2014-10-01")]
)
def test_a_season_is_highest_when_its_phase_says(phase_deg, warmest, conditions):
    days = seconds("2014-01-01") + 86_400.0 * np.arange(-90, 275)
    season = replace(conditions, time_unix=days).season(phase_deg)[:, 0]
    highest = days[np.argmax(season)]
    assert abs(highest - seconds(warmest)) < 3 * 86_400.0
    assert season.max() == pytest.approx(1.0, abs=1e-3)
    assert season.min() == pytest.approx(-1.0, abs=1e-3)


def test_of_three_dipoles_each_pair_of_letters_may_be_exchanged_and_the_third_keeps_its_sky(conditions):
    sky = np.stack([np.full((1, 1), level) for level in (1.0, 2.0, 3.0)])
    three = replace(conditions, dipoles=["A", "B", "C"], cables=["80"] * 3, sky_of=dict(zip("ABC", sky, strict=True)))
    assert three.dipole_pairs == [("A", "B"), ("A", "C"), ("B", "C")]
    assert three.across(sky, ("A", "C"))[:, 0, 0].tolist() == [3.0, 2.0, 1.0]
    named = [template.parameters for template in DipoleSwap().templates(three)]
    assert named == [{"between": "A B"}, {"between": "A C"}, {"between": "B C"}]
    lonely = replace(three, dipoles=["B"], cables=["80"])
    assert lonely.dipole_pairs == [("A", "B"), ("B", "C")]
    assert lonely.across(sky[1:2], ("A", "B"))[:, 0, 0].tolist() == [1.0]
    one = replace(three, dipoles=["A"], cables=["80"], sky_of={"A": np.ones((1, 1))})
    assert DipoleSwap().templates(one) == [], "it has no letter to be exchanged with"


def left_of(wave, basis):
    """Share of the mean square of a wave that functions of an axis and a constant do not describe."""
    columns = np.vstack([np.ones_like(wave), basis]).T
    rest = wave - columns @ np.linalg.lstsq(columns, wave, rcond=None)[0]
    return np.mean(rest**2) / np.var(wave)


def test_drifts_and_structure_of_five_weeks_are_smooth_functions_of_the_date_and_of_a_fortnight_are_not(conditions):
    """Waves of whole periods alone would bend a drift back at both ends, and leave 6 % of it."""
    date = axis_named("date")
    days = date.values(conditions)
    assert left_of(days, date.basis(conditions)) < 1e-3
    # Maxima 73 days apart: five weeks up and five weeks down.
    assert left_of(np.cos(2 * np.pi * days / 73.0), date.basis(conditions)) < 0.01
    assert left_of(np.cos(2 * np.pi * days / 28.0), date.basis(conditions)) > 0.5


@pytest.mark.parametrize("name", ["lst", "utc"])
def test_a_day_has_five_harmonics_and_no_more(name, conditions):
    axis = axis_named(name)
    hours, basis = axis.values(conditions), axis.basis(conditions)
    assert left_of(np.cos(2 * np.pi * 5 * hours / 24 + 1.0), basis) < 1e-6
    assert left_of(np.cos(2 * np.pi * 7 * hours / 24 + 1.0), basis) > 0.5


def test_a_period_of_dates_has_two_harmonics_and_no_more(conditions):
    days, tides = conditions.time_unix / 86_400.0, _period(14.77)
    left = [left_of(np.cos(2 * np.pi * k * days / 14.77 - 0.4), tides.basis(conditions)) for k in (1, 2, 3)]
    assert left == [pytest.approx(0.0, abs=1e-9), pytest.approx(0.0, abs=1e-9), pytest.approx(1.0, abs=0.1)]
    assert (tides.name, tides.label) == ("date, period 14.77 d", "day of a period of 14.77 days")


def test_every_column_of_env_that_varies_is_an_axis_by_its_name(conditions):
    events = conditions.time_unix.size
    wave = np.cos(np.arange(events) / 7.0)
    scarce = np.where(np.arange(events) < 20, wave, np.nan)
    columns = {"humidity": wave, "dead_clock": np.full(events, 3.0), "scarce": scarce, "lst": wave}
    names = [axis.name for axis in list_axes(conditions.with_covariates(**columns))]
    assert names == [*(axis.name for axis in AXES), "humidity", "env/lst"]
    humidity = list_axes(conditions.with_covariates(humidity=wave))[-1]
    assert left_of(wave**2, humidity.basis(conditions.with_covariates(humidity=wave))) < 0.01


FREQUENCY = np.arange(30.0, 81.0)


def test_a_ripple_is_the_mean_of_the_wave_over_each_channel():
    """Against the plain mean of the monochromatic wave over 1 MHz."""
    fine = (np.arange(400) + 0.5) / 400 - 0.5
    for shape in CableReflection().templates(FREQUENCY, None)[::17]:
        delay, phase = shape.parameters["delay_us"], np.radians(shape.parameters["phase_deg"])
        wave = np.cos(2 * np.pi * delay * (FREQUENCY[:, None] + fine) - phase)
        np.testing.assert_allclose(shape.departure, wave.mean(axis=1), atol=1e-5)


def test_no_ripple_falls_between_those_that_are_tried():
    tried = np.stack([shape.departure for shape in CableReflection().templates(FREQUENCY, None)])
    tried /= np.linalg.norm(tried, axis=1, keepdims=True)
    rng = np.random.default_rng(1)
    for delay, phase in zip(rng.uniform(0.05, 0.95, 60), rng.uniform(0, 6.3, 60), strict=True):
        ripple = np.cos(2 * np.pi * delay * FREQUENCY + phase)
        # Half a step in delay and in phase off: sinc(0.005 us x 51 MHz) cos(22.5 deg) = 0.83.
        assert np.abs(tried @ ripple).max() > 0.8 * np.linalg.norm(ripple)


def test_the_note_names_the_delay_that_looks_the_same_with_its_amplitude():
    cause = CableReflection()
    (shape,) = (
        s
        for s in cause.templates(FREQUENCY, None)
        if s.parameters == pytest.approx({"delay_us": 0.35, "phase_deg": 0.0, "or_delay_us": 0.65})
    )
    note = cause.note(shape.parameters, 0.01)
    assert "0.65 us" in note
    assert f"{0.01 * np.sinc(0.35) / np.sinc(0.65):.2g}" in note
    about = cause.finer_templates(shape, FREQUENCY)
    assert any(np.allclose(one.departure, -shape.departure) for one in about)


def test_two_channels_close_to_each_other_asked_for_50_000_delays_and_9_gigabytes():
    uneven = np.sort(np.r_[np.random.default_rng(1).uniform(40.0, 117.0, 150), 60.0, 60.0001])
    tried = CableReflection().templates(uneven, None)
    assert len(tried) < 4 * 2 * uneven.size
    longest = max(template.parameters["delay_us"] for template in tried)
    assert longest < 1.0 / np.median(np.diff(uneven))


def test_finer_channels_reach_longer_delays():
    """With channels of 0.39 MHz an echo of 0.85 us was named 0.026 us."""
    fine = np.arange(50.0, 70.0, 0.39)
    delays = {template.parameters["delay_us"] for template in CableReflection().templates(fine, None)}
    assert min(abs(delay - 0.85) for delay in delays) < 0.5 / np.ptp(fine)


def test_a_ripple_that_is_zero_in_every_channel_was_named_with_an_amplitude_of_3e11():
    """A sine of half a period a channel is a rounding error in each, and every antenna has some multiple of it."""
    cause = CableReflection()
    tried = cause.templates(FREQUENCY, None)
    longest = [one for one in tried if one.parameters["delay_us"] == pytest.approx(0.5)]
    assert {one.parameters["phase_deg"] for one in longest} == {0.0, 45.0, 135.0}
    about = cause.finer_templates(longest[0], FREQUENCY)
    assert min(np.abs(one.departure).max() for one in [*tried, *about]) > 0.1


LST = np.arange(32) * 0.75
OPTION = {
    "dipole_azimuth": "azimuth_deg",
    "zenith_weighting": "zenith_exponent",
    "pattern_width": "zenith_gain_fraction",
}
BETWEEN = [
    # A Fourier series of 8 angles: the beam has nothing above six times the azimuth.
    ("dipole_azimuth", 33.0, 1e-6),
    ("dipole_azimuth", -2.0, 1e-6),
    # A polynomial through four powers; the effect itself is 20 %.
    ("zenith_weighting", 0.8, 1e-4),
    ("zenith_weighting", 0.02, 2e-6),
    # Linear in its size.
    ("pattern_width", 0.3, 1e-6),
    ("pattern_width", -0.1, 1e-6),
]


@pytest.fixture(scope="module")
def ratios(world):
    return {name: ratio.at("XY", LST) for name, ratio in sky_ratios(world.instrument).items()}


def relative(power):
    """Shape (dipole, lst, freq) over its mean over LST."""
    return power / power.mean(axis=1, keepdims=True)


@pytest.fixture(scope="module")
def own(world):
    return vary_sky_power(world.instrument, lst_hours=LST)


@pytest.mark.parametrize(("name", "size", "tolerance"), BETWEEN)
def test_between_the_sizes_computed_the_ratio_is_the_exact_one(name, size, tolerance, ratios, own, world):
    exact = vary_sky_power(world.instrument, lst_hours=LST, **{OPTION[name]: size})
    expected = np.stack([exact.power[d] / own.power[d] for d in "XY"])
    sky = np.stack([own.power[d] for d in "XY"])
    assert relative(sky * ratios[name](np.array(size))) == pytest.approx(relative(sky * expected), rel=tolerance)


def test_a_power_of_the_cosine_is_taken_out_by_the_inverse(ratios):
    ratio = ratios["zenith_weighting"]
    np.testing.assert_allclose(ratio(np.array(-0.8)) * ratio(np.array(0.8)), 1.0, rtol=1e-12)


def test_every_event_may_have_an_amount_of_its_own(ratios):
    amounts = np.linspace(-0.3, 0.3, LST.size)
    for name, ratio in ratios.items():
        scale = 30.0 if name == "dipole_azimuth" else 1.0
        together = ratio(scale * amounts[:, None])
        apart = np.stack([ratio(np.array(scale * a))[:, k] for k, a in enumerate(amounts)], axis=1)
        np.testing.assert_allclose(together, apart, rtol=1e-12)


def test_no_size_is_no_change(ratios):
    for ratio in ratios.values():
        np.testing.assert_allclose(ratio(np.array(0.0)) * np.ones((2, 32, 51)), 1.0, rtol=1e-12)


def test_a_source_adds_its_share(ratios):
    for source in ("Cas A", "Cyg A", "Tau A", "Vir A"):
        share = ratios[source](np.array(1.0)) - 1.0
        assert np.all(share >= -1e-12)
        assert 1e-4 < share.max() < 0.5


def test_channels_that_the_own_models_do_not_cover_have_no_ratios(world):
    outside = replace(world.instrument, frequency_mhz=world.instrument.frequency_mhz + 300.0)
    assert sky_ratios(outside) == {}


@pytest.mark.parametrize("size", [-1e3, 1e3])
def test_a_power_of_the_cosine_far_outside_those_computed_stays_finite(size, world):
    """The step of a fit went there where the LST of the sky was wrong, and warned of an overflow."""
    ratio = sky_ratios(world.instrument)["zenith_weighting"].at("XY", LST)
    assert np.all(np.isfinite(ratio(np.array(size))))


def test_ratios_are_those_of_the_place_the_arms_and_the_antenna_that_are_asked_for(world):
    """They are computed once for each."""
    here = sky_ratios(world.instrument)
    arms = {"X": 60.0, "Y": 150.0}
    others = [replace(world.instrument, latitude_deg=45.0), replace(world.instrument, dipole_azimuth_deg=arms)]
    for other in [*others, replace(world.instrument, antenna="short-dipole")]:
        assert np.abs(sky_ratios(other)["Cas A"].terms["X"] - here["Cas A"].terms["X"]).max() > 1e-4
    again = sky_ratios(replace(world.instrument, name="the same elsewhere"))
    assert all(again[name] is one for name, one in here.items())
