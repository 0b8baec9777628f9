"""Sentences against the chain written out by hand, and every form against what it says of itself."""

import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from lbacal_core.causes.axes import list_axes
from lbacal_core.causes.cause import Template, signature
from lbacal_core.causes.grammar import (
    CHANNELS,
    COURSES,
    CURVE,
    LAWS,
    PLACES,
    PRODUCT,
    SERIES,
    SIDEREAL,
    SOLAR,
    WEEK,
    Sentence,
    as_equation,
    axis_of,
    columns_of,
    course_of,
    finer,
    in_words,
    is_of_dates,
    law_of,
    list_courses,
    list_laws,
    numbers_of,
    opposite,
    parts_of,
    require_sentence,
    sentence,
)
from lbacal_core.causes.model import AdoptedCause, Model, follows_date
from lbacal_core.causes.sky import SOURCE_KEYS
from lbacal_core.errors import BadInputError
from lbacal_core.grids import DAY_S

SENTENCE = Sentence()


def test_every_kind_has_forms_with_values_words_and_an_equation(conditions):
    laws, courses = list_laws(conditions), list_courses(conditions)
    assert {one[0] for one in laws} == set(LAWS) - {CURVE, CHANNELS}, "their numbers are estimated, not tried"
    assert {one[0] for one in courses} == set(COURSES) - {SERIES}
    laws += [(CURVE, 0.5, -0.3, 0.2), (CHANNELS, 38.0, 1.0, 51.0, 0.5)]
    courses += [(SERIES, clock, 0.5, -0.3, 0.2, 0.0) for clock in ("LST", "UTC", "year")]
    for law in laws:
        values = law_of(conditions, law)
        assert values.shape in [(1, 1, 51), (2, 1, 51)]
        assert np.ptp(values) > 0 or law == ("flat",)
    for course in courses:
        values = course_of(conditions, course)
        assert values.shape == (200,)
        assert np.all(np.isfinite(values))
        assert np.ptp(values) > 0 or course == ("always",)
    for place, law, course in [(one, laws[0], courses[0]) for one in PLACES] + [
        *(("sky", one, courses[0]) for one in laws),
        *(("sky", laws[0], one) for one in courses),
    ]:
        template = sentence(place, law, course)
        assert "{" not in in_words(template) + as_equation(template)


def test_interference_is_in_the_channels_that_a_grid_has(conditions):
    law = (CHANNELS, 38.0, 1.0, 51.2, 0.5, 95.0, 2.0)
    shown = law_of(conditions, law)[0, 0]
    assert dict(zip(conditions.frequency_mhz[shown != 0], shown[shown != 0], strict=True)) == {38.0: 1.0, 51.0: 0.5}
    told = sentence("antenna", law[:5], ("step", "2014-07-20T06:02:43Z"))
    require_sentence("a file", told.parameters)
    assert "as interference in single channels, at 38 and 51.2 MHz, from 2014-07-20" in in_words(told)
    for wrong in (("channels",), ("channels", 38.0), ("channels", 38.0, 0.0)):
        with pytest.raises(BadInputError):
            require_sentence("a file", sentence("antenna", wrong, ("always",)).parameters)


def test_a_band_without_a_channel_is_no_course_and_one_that_is_told_is_refused(conditions):
    keep = (conditions.frequency_mhz < 40) | (conditions.frequency_mhz > 68)
    sky = {dipole: power[:, keep] for dipole, power in conditions.sky_of.items()}
    gap = replace(conditions, frequency_mhz=conditions.frequency_mhz[keep], sky_of=sky)
    bands = [course for course in list_courses(gap) if course[0] == "sky"]
    assert bands == [("sky", 30.0, 80.0), ("sky", 30.0, 40.0), ("sky", 60.0, 70.0), ("sky", 70.0, 80.0)]
    assert all(np.all(np.isfinite(course_of(gap, one))) for one in bands)
    with pytest.raises(BadInputError, match=r"a band in which these data have a channel, found 50-60 MHz"):
        course_of(gap, ("sky", 50.0, 60.0))


def test_a_place_acts_as_the_chain_written_out(conditions, terms):
    """eq. full_chain: P = (P_sky + N_LNA) s + N_RCU + N_ADC."""
    law, course = ("power", -2.0, 30.0), ("wave", "UTC", 2, 1 / 3)
    u = (
        0.07
        * (conditions.frequency_mhz / 30.0) ** -2
        * np.cos(2 * np.pi * (conditions.utc_hours - 8.0) / 12.0)[:, None]
    )
    sky, lna, s, rcu, adc = terms.sky, terms.n_lna, terms.front, terms.receiver_noise, terms.adc_noise
    mean = conditions.mean_sky[:, None]
    at_55 = np.array([np.interp(55.0, conditions.frequency_mhz, one) for one in conditions.mean_sky])[:, None, None]
    sign = np.where(np.array(conditions.dipoles) == "X", 1.0, -1.0)[:, None, None]
    rate = (conditions.later(sky, np.array([0.05])) - conditions.later(sky, np.array([-0.05]))) / 0.1
    total = ((sky + lna) * s + rcu).sum(axis=2, keepdims=True)
    expected = {
        "sky": (sky * (1 + u) + lna) * s + rcu + adc,
        "antenna": (sky + lna + u * mean) * s + rcu + adc,
        "front": (sky + lna) * s * (1 + u) + rcu + adc,
        "receiver": (sky + lna) * s + rcu * (1 + u) + adc,
        "behind": ((sky + lna) * s + rcu) * (1 + u) + adc,
        "converter": (sky + lna) * s + rcu + adc * (1 + u),
        "record": ((sky + lna) * s + rcu + adc) * (1 + u),
        "polarisation": (sky * (1 + u * sign) + lna) * s + rcu + adc,
        "letters": (sky + u * (conditions.across(sky, ("X", "Y")) - sky) + lna) * s + rcu + adc,
        "time": (sky + u * rate + lna) * s + rcu + adc,
        "level": ((sky + lna) * s + rcu) * (1 + u * (total / total.mean(axis=1, keepdims=True) - 1)) + adc,
        "Sun": (sky + u * at_55 * conditions.sun_response + lna) * s + rcu + adc,
        **{name: (sky * conditions.sky_ratio[name](u) + lna) * s + rcu + adc for name in SOURCE_KEYS},
    }
    assert set(expected) == set(PLACES)
    for place, power in expected.items():
        found = SENTENCE.apply(terms, conditions, sentence(place, law, course), 0.07).power()
        np.testing.assert_allclose(found, np.broadcast_to(power, found.shape), rtol=1e-9)


def test_sources_are_no_places_where_no_model_says_how_they_are_received(conditions, terms):
    blind = replace(conditions, sky_ratio={}, sun_response=None)
    assert {name for name, place in PLACES.items() if not place.is_there(blind)} == {"Sun", *SOURCE_KEYS}
    assert all(place.is_there(conditions) for place in PLACES.values())
    for place in ("Sun", "Cas A"):
        with pytest.raises(BadInputError, match=f"sentence: {place}: expected channels that"):
            SENTENCE.apply(terms, blind, sentence(place, ("flat",), ("always",)), 0.1)


@pytest.mark.parametrize("amount", [0.0, np.zeros((200, 1))])
def test_an_amount_of_nothing_changes_nothing(conditions, terms, amount):
    for place in PLACES:
        same = SENTENCE.act(terms, conditions, sentence(place, ("tilt",), ("always",)), amount)
        np.testing.assert_array_equal(np.broadcast_to(same.power(), terms.power().shape), terms.power())


def test_what_is_estimated_is_a_sum_over_its_largest_value(conditions):
    angle = 2 * np.pi * conditions.lst_hours / 24
    wave = 0.3 * np.cos(angle) - 0.4 * np.sin(angle)
    np.testing.assert_allclose(course_of(conditions, (SERIES, "LST", 0.3, -0.4)), wave / 0.5, rtol=1e-3)
    log = np.log(conditions.frequency_mhz)
    tilt = 2 * (log - log[0]) / (log[-1] - log[0]) - 1
    np.testing.assert_allclose(law_of(conditions, (CURVE, 1.0, -0.5))[0, 0], (1 - 0.5 * tilt) / 1.5)


def test_no_gain_and_no_noise_falls_below_nothing(conditions):
    """A converter's noise fell by 56 of itself, where the sky was absorbed in a band."""
    wave, tilted = sentence("converter", ("flat",), ("wave", SOLAR, 1, 0.0)), sentence("sky", ("tilt",), ("always",))
    for template in (wave, tilted):
        assert SENTENCE.is_physical(conditions, template, 0.9, 0.01)
        assert not SENTENCE.is_physical(conditions, template, 1.9, 0.01)
        assert SENTENCE.is_physical(conditions, template, 1.9, 0.4), "the error may have carried it"
    since = sentence("converter", ("flat",), next(one for one in list_courses(conditions)[10:] if one[0] == "step"))
    assert SENTENCE.is_physical(conditions, since, 35.0, 0.1), "noise grows without an end"
    assert not SENTENCE.is_physical(conditions, since, -1.1, 0.01)
    assert SENTENCE.is_physical(conditions, since, -1.1, 0.01, is_first_order=True), "relative to a mean that fell"


@pytest.mark.parametrize("course", [["series", "UTC", 1.0], ["series", "moon", 1.0, 0.0], ["series", "LST", 0.0, 0.0]])
def test_a_series_without_pairs_of_numbers_or_a_clock_is_refused(course):
    with pytest.raises(BadInputError, match="a place of sky, antenna, front"):
        require_sentence("here", {"place": "front", "law": ["flat"], "course": course})


def test_a_ripple_with_another_delay_keeps_its_phase_in_the_middle_of_the_band(conditions):
    moved = [one for one in finer(LAWS, ("ripple", 0.2, 0.25), conditions) if one[1] != 0.2]
    middle = np.argmin(np.abs(conditions.frequency_mhz - 55.0))
    values = [law_of(conditions, one)[0, 0, middle] for one in moved]
    np.testing.assert_allclose(values, law_of(conditions, ("ripple", 0.2, 0.25))[0, 0, middle], atol=1e-6)


def test_no_ripple_falls_between_those_that_are_tried(conditions):
    """One of 0.24 µs was said in no word: 0.2 and 0.3 µs were tried, and showed a tenth of it."""
    tried = np.array([law_of(conditions, one)[0, 0] for one in list_laws(conditions) if one[0] == "ripple"])
    tried /= np.linalg.norm(tried, axis=1)[:, None]
    nu = conditions.frequency_mhz
    delays = np.linspace(2.0, 20.0, 100) / np.ptp(nu)
    angles = 2 * np.pi * (delays[:, None, None] * nu + np.arange(0.0, 0.5, 0.125)[:, None])
    ripples = np.cos(angles) / np.linalg.norm(np.cos(angles), axis=-1)[..., None]
    assert np.abs(ripples @ tried.T).max(axis=-1).min() > 0.2


def test_courses_are_what_they_say(conditions):
    utc, time = conditions.utc_hours, conditions.time_unix
    day = np.array([datetime.fromtimestamp(one, UTC).weekday() for one in time])
    np.testing.assert_array_equal(course_of(conditions, ("working days",)), day < 5)
    np.testing.assert_array_equal(course_of(conditions, ("hours", 22.0, 4.0)), (utc >= 22) | (utc < 2))
    np.testing.assert_array_equal(
        course_of(conditions, (PRODUCT, ("day",), ("working days",))), (conditions.sun_altitude > 0) & (day < 5)
    )
    warm = conditions.covariates["temperature_c"]
    np.testing.assert_allclose(course_of(conditions, ("column", "temperature_c", 2, 9.0, 5.0)), ((warm - 9) / 5) ** 2)
    at = "2014-07-01T00:00:00Z"
    after = np.array([datetime.fromtimestamp(one, UTC) >= datetime(2014, 7, 1, tzinfo=UTC) for one in time])
    np.testing.assert_array_equal(course_of(conditions, ("step", at)), after)
    np.testing.assert_array_equal(course_of(conditions, ("step", at.removesuffix("Z"))), after)  # on any machine
    every = course_of(conditions, ("every", 5, 2))[np.argsort(time)]
    np.testing.assert_array_equal(np.flatnonzero(every), np.arange(2, 200, 5))
    away = np.abs((time / 86400 / 27.275 % 1.0) - 0.5)
    np.testing.assert_allclose(
        course_of(conditions, ("near", "solar rotation", 0.5, 0.08)), np.exp(-0.5 * (away / 0.08) ** 2)
    )


def test_four_days_of_a_year_try_no_wave_of_many_days(conditions):
    """Own gains of four days were a wave of the Sun's rotation, near a day of the lunation, at 60 sigma."""
    days = (np.array([20.0, 110.0, 111.0, 250.0])[np.arange(conditions.time_unix.size) % 4] + 16_000.0) * DAY_S
    few = replace(conditions, time_unix=days + conditions.time_unix % DAY_S)
    assert {clock for clock, *_ in COURSES["wave"].grid(few)} == {SIDEREAL, SOLAR}
    assert {clock for clock, *_ in COURSES["wave"].grid(conditions)} > {SIDEREAL, SOLAR, WEEK}


def test_no_period_falls_between_those_that_are_tried(conditions):
    """6 % in waves of 47 days were said of no course: only clocks had waves."""
    year = replace(conditions, time_unix=np.sort(conditions.time_unix))
    span_d = np.ptp(year.time_unix) / DAY_S
    tried = np.array([course_of(year, ("cycle", *one)) for one in COURSES["cycle"].grid(year)])
    tried /= np.linalg.norm(tried, axis=1)[:, None]
    periods = span_d / np.linspace(2.5, 39.5, 200)
    turns = year.time_unix / DAY_S / periods[:, None]
    waves = np.cos(2 * np.pi * (turns - np.arange(0.0, 0.5, 0.125)[:, None, None]))
    waves /= np.linalg.norm(waves, axis=-1)[..., None]
    assert np.abs(waves @ tried.T).max(axis=-1).min() > 0.6
    assert COURSES["cycle"].grid(replace(year, time_unix=np.full(200, np.nan))) == []


def test_a_wave_of_another_period_keeps_its_phase_in_the_middle_of_the_data(conditions):
    one = ("cycle", 47.0, 0.3)
    middle = replace(conditions, time_unix=np.full(200, conditions.time_unix.mean()))
    moved = [form for form in finer(COURSES, one, conditions) if form[1] != 47.0]
    assert len(moved) == 6
    for form in moved:
        np.testing.assert_allclose(course_of(middle, form), course_of(middle, one), atol=1e-6)
    turned = parts_of(opposite(sentence("front", ("flat",), one)))[2]
    np.testing.assert_allclose(course_of(conditions, turned), -course_of(conditions, one), atol=1e-9)
    assert in_words(sentence("front", ("flat",), one)).endswith(
        "in a wave of 47 days, highest at day 14.1 of it (days since 1970-01-01 modulo 47)"
    )


def test_an_unknown_column_counts_as_nothing(conditions):
    warm = conditions.covariates["temperature_c"].copy()
    warm[:7] = np.nan
    gaps = conditions.with_covariates(temperature_c=warm)
    for course in [("column", "temperature_c", 1, 9.0, 5.0), ("over", "temperature_c", 5.0), ("late", 0.0)]:
        assert np.all(course_of(gaps, course)[:7] == 0.0)
        assert columns_of(course) == ("temperature_c",)
        template = sentence("front", ("flat",), (PRODUCT, course, ("day",)))
        np.testing.assert_array_equal(SENTENCE.known_events(gaps, template), np.arange(200) >= 7)


def test_finer_forms_lie_about_the_one_found(conditions):
    for kinds, forms in ((LAWS, list_laws(conditions)), (COURSES, list_courses(conditions))):
        for form in forms:
            about = finer(kinds, form, conditions)
            assert about[0] == form
            assert len(set(about)) == len(about)
            assert {one[0] for one in about} == {form[0]}
    assert ("power", -1.25, 30.0) in finer(LAWS, ("power", -2.0, 30.0), conditions)
    both = finer(COURSES, (PRODUCT, ("hours", 6.0, 6.0), ("near", "UTC", 0.5, 0.1)), conditions)
    assert {one[1][0] for one in both} == {"hours"}
    assert len(both) > 10


def test_a_beginning_moves_while_its_end_stays(conditions):
    moved = finer(COURSES, ("between", "2014-07-01T00:00:00Z", 40.0), conditions, 0.5)
    ends = [datetime.fromisoformat(begin) + timedelta(days=length) for _, begin, length in moved]
    assert sum(abs(end - datetime(2014, 8, 10, tzinfo=UTC)) < timedelta(days=1.5) for end in ends) > 2
    hours = finer(COURSES, ("hours", 6.0, 9.0), conditions)
    assert {("hours", 5.25, 9.5), ("hours", 5.25, 9.0), ("hours", 6.0, 9.5)} <= {*hours}


def test_a_date_lies_in_the_middle_between_two_events(conditions):
    """An effect begins anywhere between two events: its first event is the latest of all dates."""
    moved = finer(COURSES, ("step", "2014-07-01T00:00:00Z"), conditions)[1:]
    dates = [datetime.fromisoformat(at).timestamp() for _, at in moved]
    times = np.sort(conditions.time_unix)
    k = np.searchsorted(times, dates)
    np.testing.assert_allclose(dates, 0.5 * (times[k - 1] + times[k]), atol=1.0)


def test_a_slope_may_begin_at_a_date(conditions):
    """A gain that faded in autumn was two steps, each of them named."""
    begins = [one for one in list_courses(conditions) if one[0] == "since"]
    assert len(begins) == 40
    slope, step = (course_of(conditions, (name, begins[20][1])) for name in ("since", "step"))
    times = conditions.time_unix / DAY_S / 365.25
    later = step > 0
    np.testing.assert_allclose(np.diff(slope[later]), np.diff(times[later]), atol=1e-9)
    assert not np.any(slope[~later])
    moved = finer(COURSES, begins[20], conditions)
    assert [one[1] for one in moved] == [one[1] for one in finer(COURSES, ("step", begins[20][1]), conditions)]


def test_a_sentence_and_its_opposite_say_the_same_with_the_other_sign(conditions, terms):
    template = sentence("front", ("flat",), ("wave", "UTC", 2, 1 / 3))
    turned = opposite(template)
    np.testing.assert_allclose(
        signature(SENTENCE, terms, conditions, template), -signature(SENTENCE, terms, conditions, turned), atol=1e-12
    )
    assert opposite(sentence("front", ("flat",), ("sun",))) is None
    for course, other in (("day",), ("night",)), (("over", "temperature_c", 9.0), ("under", "temperature_c", 9.0)):
        turned = opposite(sentence("front", ("flat",), course))
        assert parts_of(turned)[2] == other
        np.testing.assert_allclose(course_of(conditions, course) + course_of(conditions, other), 1.0)


def test_words_are_those_of_a_colleague():
    template = sentence("receiver", ("flat",), ("working days",))
    assert in_words(template) == "the noise of the receiver changes, alike at all frequencies, from Monday to Friday"
    assert as_equation(template) == "N_RCU -> N_RCU (1 + a Monday-Friday)"
    wave = sentence("front", ("power", -2.0, 30.0), ("wave", "UTC", 2, 1 / 3))
    assert in_words(wave).endswith(
        "as frequency to the power -2 (size at 30 MHz), in 2 waves a UTC day, highest at 8.0 h UTC"
    )


def test_a_model_carries_a_sentence_as_text_and_back(conditions, terms):
    template = sentence("front", ("band", 58.0, 5.0, 4), (PRODUCT, ("step", "2014-07-01T12:34:56Z"), ("night",)))
    adopted = AdoptedCause("sentence", "CS002", "station", 0.02, 0.001, template.parameters)
    model = Model.from_text(Model((adopted,)).to_text())
    assert model.id == Model((adopted,)).id
    read = Template(json.loads(model.to_text())["causes"][0]["parameters"])
    assert parts_of(read) == parts_of(template)
    np.testing.assert_array_equal(
        signature(SENTENCE, terms, conditions, read), signature(SENTENCE, terms, conditions, template)
    )
    assert "in 5 MHz about 58 MHz" in model.causes[0].sentence
    assert numbers_of(read) == 3  # of the band
    assert numbers_of(sentence("front", ("flat",), (PRODUCT, ("hours", 6.0, 3.0), ("night",)))) == 2


@pytest.mark.parametrize(
    ("course", "is_expected"),
    [
        (("step", "2014-07-01T00:00:00Z"), True),
        (("ramp", "2014-07-01T00:00:00Z"), True),
        (("since", "2014-07-01T00:00:00Z"), True),
        (("wave", "year", 1, 0.2), True),
        ((PRODUCT, ("day",), ("step", "2014-07-01T00:00:00Z")), True),
        (("wave", "week", 1, 0.2), False),
        (("day",), False),
        (("every", 5, 2), True),
    ],
)
def test_what_follows_dates_is_a_change_and_no_part_of_a_model_of_one_c(course, is_expected):
    assert is_of_dates(course) == is_expected
    template = sentence("front", ("flat",), course)
    assert follows_date("sentence", template.parameters) == is_expected
    model = Model((AdoptedCause("sentence", "CS002", "station", 0.02, 0.001, template.parameters),))
    if is_expected:
        with pytest.raises(BadInputError, match="does not follow the date"):
            model.require_one_c("model")
    else:
        model.require_one_c("model")


@pytest.mark.parametrize(
    "wrong",
    [
        {"place": "moon"},
        {"law": ["colour"]},
        {"course": ["wave", "UTC"]},
        {"course": ["hours", "six", 6.0]},
        {"course": []},
        {"law": None},
        {"law": ["flat", 3.0]},
        {"course": ["step", "yesterday"]},
        {"course": ["wet", "damp"]},
        {"course": ["cycle", 0.0, 0.2]},
        {"course": ["product", ["day"]]},
    ],
)
def test_what_is_no_sentence_is_refused_with_what_one_is(wrong):
    right = {"place": "front", "law": ["flat"], "course": ["day"]}
    require_sentence("model", right)
    with pytest.raises(BadInputError, match="a place of sky, antenna, front"):
        AdoptedCause("sentence", "CS002", "station", 0.02, 0.001, right | wrong)


def test_a_law_of_the_chain_is_the_derivative_of_its_curve(conditions, terms):
    """A resonance lower by c changes ln G by c d ln G / d nu."""
    template = sentence("front", ("resonance",), ("always",))
    moved = np.interp(conditions.frequency_mhz + 0.01, conditions.frequency_mhz, np.log(conditions.antenna_gain))
    front = terms.front * np.exp(moved - np.log(conditions.antenna_gain))
    found = SENTENCE.apply(terms, conditions, template, 0.01).front
    np.testing.assert_allclose(found[0, 0, 2:-2], front[0, 0, 2:-2], rtol=2e-3)


def test_words_have_the_sign_of_what_happens(conditions, terms):
    """A gain that fell "rises with time, as the cable's loss in dB: 1.3"."""
    template = sentence("behind", ("cable",), ("ramp", "2014-07-01"))
    assert in_words(template).endswith(
        "as if the cable's loss in dB grew by this share, linearly with time (size per year)"
    )
    lossy = replace(conditions, cable_log_loss=-np.abs(conditions.cable_log_loss) - 0.01)
    assert np.all(SENTENCE.apply(terms, lossy, sentence("behind", ("cable",), ("always",)), 0.5).front < terms.front)


def test_every_course_varies_along_an_axis_of_the_data(conditions):
    wind = conditions.with_covariates(wind_m_s=np.linspace(0.0, 20.0, 200))
    known = {name for axis in list_axes(wind) for name in (axis.name, axis.column)}
    named = {axis_of(course) for course in list_courses(wind)}
    assert named <= known
    assert {"lst", "utc", "date", "date, period 7 d", "date, period 27.3 d", "temperature_c", "wind_m_s"} <= named
    assert axis_of((PRODUCT, ("wave", "week", 1, 0.0), ("night",))) == "date, period 7 d"


def test_a_day_of_the_week_is_a_course(conditions):
    at = np.array(
        ["2014-05-04T23:59", "2014-05-05T00:01", "2014-05-05T23:59", "2014-05-06T00:01"], dtype="datetime64[s]"
    )
    week = replace(conditions, time_unix=at.astype(float))
    assert course_of(week, ("weekday", "Monday")).tolist() == [0.0, 1.0, 1.0, 0.0]
    assert in_words(sentence("sky", ("flat",), ("weekday", "Monday"))).endswith("on Mondays")
