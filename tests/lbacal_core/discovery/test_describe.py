"""Effects that no catalogue lists, planted by the twin, in words: place, law, course, and what is left of them."""

import json
from dataclasses import replace
from datetime import datetime

import numpy as np
import pytest

from lbacal_core.causes.catalogue import CAUSES, FORMAT, NamedSentence, catalogue_with
from lbacal_core.causes.cause import signature
from lbacal_core.causes.grammar import Sentence, course_of, law_of, parts_of, sentence
from lbacal_core.causes.model import Model
from lbacal_core.discovery import describe, sentences
from lbacal_core.discovery.describe import (
    CERTAIN,
    Description,
    _amounts,
    _count_events,
    _fit,
    _fit_likely,
    _without_idle,
    describe_structure,
)
from lbacal_core.discovery.hypothesis import Hypothesis, list_targets
from lbacal_core.discovery.policy import Policy
from lbacal_core.discovery.refit import fit_chain
from lbacal_core.discovery.report import _said, investigate
from lbacal_core.discovery.residual_structure import find_structure, strongest_structure
from lbacal_core.discovery.search import search_station
from lbacal_core.discovery.sentences import (
    SENTENCE,
    ScoredSentence,
    estimate_sentence,
    likeliest_sentences,
    refine_sentence,
    scatter_by_numbers,
    score_gated,
    score_interference,
)
from lbacal_core.discovery.station import gather_stations
from lbacal_core.foreign import write_instant
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.composed import Composed
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.hardware import Compression, GainStep
from lbacal_twin.faults.sky import DipoleSwap, IonosphericAbsorption, LstOffset, RfiBroadband
from lbacal_twin.faults.uncatalogued import AuroralAbsorption, FieldGradient, MainsHum, WorkingWeek
from lbacal_twin.settings import TwinSettings


@pytest.mark.long
def test_amounts_grow_with_the_number_of_the_antenna_or_do_not():
    def growth(*sizes):
        return Description(amounts={k: (size, 0.1) for k, size in enumerate(sizes)}).grows_with_number

    assert growth(1.0, 2.0, 3.0, 4.0) == pytest.approx(1.0)
    assert growth(4.0, 3.0, 2.0, 1.0) == pytest.approx(-1.0)
    assert growth(1.0, -1.0, -1.0, 1.0) == pytest.approx(0.0, abs=1e-9)
    assert growth(1.0, 2.0, 3.0) is None


def test_noise_is_not_put_into_words(station):
    """Not even where one asks for the structure that chance explains least."""
    model = fit_chain(station)
    structure = strongest_structure(model.linear, np.random.default_rng(0))
    assert describe_structure(model, structure, list_targets(station), Policy()) == Description()


def test_noise_of_receivers_on_working_days_is_said_so_and_adopted(spoil, simulation):
    spectra = spoil(WorkingWeek(size=0.08))
    report, (found,) = investigate(spectra, simulation)
    left = report["unexplained"]
    first = left["sentences"][0]
    said, targets = found.description.sentences[0], list_targets(found.last.station)
    amounts = _amounts(found.last.linear, said, targets)
    assert list(amounts) == list(range(8))
    for size, sigma in amounts.values():
        assert size == pytest.approx(0.08, abs=5 * sigma), "each shows it, to first order"
        assert sigma == pytest.approx(0.006, rel=0.3)
        assert size > 5 * sigma
    assert _amounts(found.last.linear, said, [one for one in targets if one.scope != "antenna"]) == {}
    assert (first["parameters"]["place"], first["parameters"]["course"]) == ("receiver", ("working days",))
    assert first["equation"].startswith("N_RCU -> N_RCU (1 + a ")
    assert abs(first["size"]["value"] - 0.08) < 4 * first["size"]["sigma"]
    assert first["log_odds"] > CERTAIN
    assert first["gain"]["held_out_log_likelihood_gain"] > 0.4 * first["gain"]["chi2"]
    law = first["picture"]["law"]
    observed, sigma, expected = (np.array(law[name]) for name in ("observed", "sigma", "expected"))
    scale = np.sum(observed * expected / sigma**2) / np.sum(expected**2 / sigma**2)
    assert scale == pytest.approx(1.0, abs=0.2), "the picture shows what the sentence says, though it is in no model"
    assert left["remains"] is None
    assert "from Monday to Friday" in left["in_words"]
    model = Model.from_report(json.loads(json.dumps(report)), "unexplained")
    again, _ = investigate(spectra, simulation.with_causes(model))
    assert again["verdict"] == "consistent"


@pytest.mark.long
def test_where_the_likeliest_sentence_runs_away_the_next_is_said(spoil, simulation):
    """A slope of the LNA's noise that the catalogue lacked was said in no word in three of five data sets."""
    station = gather_stations(spoil(WorkingWeek(size=0.08)), simulation)[0]
    model = fit_chain(station)
    likely = likeliest_sentences(model.linear, list_targets(station)[-1], 1)[0]
    wild = replace(likely, size=50.0, z=2.0 * likely.z)
    ((said, _),) = _fit_likely(model, [wild, likely], 1)
    size = abs(said.hypothesis.size)  # on working days more, or on weekends less: rounding decides which is said
    assert abs(size - 0.08) < 4 * said.hypothesis.sigma


def test_where_a_noise_would_fall_below_nothing_the_next_of_its_place_is_said(spoil, simulation, monkeypatch):
    """A receiver lost 1.9 of its noise: behind it, a likely sentence of the same place was not fitted."""
    model = fit_chain(gather_stations(spoil(WorkingWeek(size=0.08)), simulation)[0])
    following = likeliest_sentences(model.linear, list_targets(model.station)[-1], 1)[0]
    place, _, course = parts_of(following.template)
    wild = replace(following, template=sentence(place, ("tilt",), course), size=-1.9, z=2.0 * following.z)
    negative = replace(wild, template=sentence("receiver", ("flat",), ("step", "2014-12-01")), size=-1.9)
    assert describe._best_physical(model.linear, [negative, following]) == [following]
    can_be = Sentence.is_physical
    monkeypatch.setattr(Sentence, "is_physical", lambda *a, **k: a[2] != wild.template and can_be(*a, **k))
    ((said, _),) = _fit_likely(model, [wild, following], 1)
    assert said.hypothesis.template == following.template


@pytest.mark.long
@pytest.mark.parametrize("nights", [False, True])
def test_spectra_of_a_dead_path_are_left_out(nights, clean, simulation):
    """A month was a gain with four harmonics a year, 0.973 +- 0.00089; single nights power that is added in three."""
    month = np.abs(clean.time_unix - 1402000000.0) < 15 * 86400.0
    during = np.isin(clean.time_unix // 86400 % 47, (5, 18)) if nights else month
    during &= (clean.antenna == 3) & (clean.dipole == "X")
    dead = replace(clean, power=clean.power * np.where(during, 0.03, 1.0)[:, None])
    report, (found,) = investigate(dead, simulation)
    assert (report["verdict"], found.deaf) == ("consistent", [])
    told = f"left out with less than a tenth of the usual power: {during.sum()} of CS002 antenna 3 X"
    assert report["provenance"]["notes"]["dead spectra"] == told


@pytest.mark.long
def test_a_single_event_is_put_into_no_course(clean, simulation):
    """One burst was the square of the height of the Sun near a day of its rotation, times 135."""
    burst = np.where(clean.event_id == clean.event_id[40], 8.0, 1.0)[:, None] ** (clean.frequency_mhz / 80.0)
    model = fit_chain(gather_stations(replace(clean, power=clean.power * burst), simulation)[0])
    structure = strongest_structure(model.linear, np.random.default_rng(0))
    assert describe_structure(model, structure, list_targets(model.station), Policy()) == Description()


def describe_power(spectra, power, simulation):
    """The likeliest sentence of what was done to the power, shape (row, freq)."""
    model = fit_chain(gather_stations(replace(spectra, power=power), simulation)[0])
    structure = strongest_structure(model.linear, np.random.default_rng(0))
    return describe_structure(model, structure, list_targets(model.station), Policy()).sentences[0].hypothesis


@pytest.mark.long
def test_an_attenuator_on_one_day_of_the_week_is_said_so(clean, simulation):
    """It was a Gaussian of 9 h, on working days, since a date: of another size."""
    on = (clean.antenna == 3) & (clean.time_unix // 86400 % 7 == 4)  # 1970-01-01 was a Thursday
    said = describe_power(clean, clean.power * np.where(on, 0.5, 1.0)[:, None], simulation)
    assert (said.target.label, parts_of(said.template)[2]) == ("antenna 3", ("weekday", "Monday"))
    assert said.size == pytest.approx(-0.5, abs=0.02)


@pytest.mark.long
def test_dipoles_that_are_exchanged_for_some_months_are_said_to_be(clean, simulation):
    """The cause of the catalogue acts at all times: its size was the share of the year."""
    during = (clean.antenna == 2) & (np.abs(clean.time_unix - 1402000000.0) < 45 * 86400.0)
    partner = {
        (e, a, d): k for k, (e, a, d) in enumerate(zip(clean.event_id, clean.antenna, clean.dipole, strict=True))
    }
    other = [partner[e, a, "Y" if d == "X" else "X"] for e, a, d in partner]
    said = describe_power(clean, np.where(during[:, None], clean.power[other], clean.power), simulation)
    place, _, course = parts_of(said.template)
    assert (said.target.label, place, course[0]) == ("antenna 2", "letters", "between")
    assert said.size == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("is_real", [False, True])
def test_a_condition_that_a_few_bursts_meet_by_chance_is_not_said(is_real, clean, simulation):
    """Bursts in a quarter of the events by day were those near a day of the lunation on working days, four of 27."""
    rng, events = np.random.default_rng(1), np.unique(clean.event_id, return_index=True)
    week, hours = clean.time_unix[events[1]] // 86400 % 7, clean.time_unix[events[1]] / 3600.0 % 24.0
    size = 0.1 * ~np.isin(week, (2, 3)) if is_real else 0.4 * (rng.uniform(size=week.size) < 0.25)
    burst = dict(zip(events[0], size * ((hours > 7.5) & (hours < 16.5)), strict=True))
    change = np.array([burst[one] for one in clean.event_id])[:, None] * clean.frequency_mhz[0] / clean.frequency_mhz
    model = fit_chain(gather_stations(replace(clean, power=clean.power * (1.0 + change)), simulation)[0])
    target = list_targets(model.station)[-1]
    plain = ScoredSentence(sentence("sky", ("power", -1.0, 30.0), ("hours", 7.5, 9.0)), target, 1.0, 1.0, 0.0)
    best = max(score_gated(model.linear, [target], plain), key=lambda one: one.gain)
    assert parts_of(best.template)[2][0] == "product", "by its score it has one"
    kept = parts_of(_without_idle(model, best, 1).template)[2]
    assert (kept[0] == "product") == is_real


@pytest.mark.parametrize("factor", [0.5, 1.5])
def test_the_size_of_a_curve_that_is_estimated_has_the_sign_of_the_change(factor, clean, simulation):
    """Half of the power for two months was said as +0.498, along a curve of -0.99 P0."""
    during = (clean.antenna == 3) & (np.abs(clean.time_unix - 1404000000.0) < 30 * 86400.0)
    power = clean.power * np.where(during, factor, 1.0)[:, None]
    (station,) = gather_stations(replace(clean, power=power), simulation)
    target = next(one for one in list_targets(station) if one.label == "antenna 3")
    said = sentence("front", ("flat",), ("between", "2014-05-30T00:00:00Z", 60.0))
    first, *_ = estimate_sentence(fit_chain(station).linear, ScoredSentence(said, target, 1.0, 1.0, 0.0), 1)
    assert parts_of(first.template)[1][:1] == ("curve",)
    assert np.sign(first.size) == np.sign(factor - 1.0)
    assert law_of(station.conditions, parts_of(first.template)[1]).mean() > 0.0


def test_the_curve_of_a_large_change_is_that_of_the_change_and_not_of_its_logarithm(clean, simulation):
    """To first order it differs less along the band: 0.9 to 0.2 was 1.03 to 0.33."""
    nu, is_late = clean.frequency_mhz, (clean.antenna == 3) & (clean.time_unix > 1404000000.0)
    power = clean.power * (1.0 + is_late[:, None] * np.interp(nu, nu[[0, -1]], [0.9, 0.2]))
    model = fit_chain(gather_stations(replace(clean, power=power), simulation)[0])
    target = next(one for one in list_targets(model.station) if one.label == "antenna 3")
    said = sentence("record", ("flat",), ("step", "2014-06-29T00:00:00Z"))
    first = estimate_sentence(model.linear, ScoredSentence(said, target, 1.0, 1.0, 0.0), 1)[0]
    own = _fit(model, first)[0].hypothesis
    shown = own.size * law_of(model.station.conditions, parts_of(own.template)[1])[0, 0]
    assert own.size == pytest.approx(0.9, abs=3 * own.uncertainty)
    np.testing.assert_allclose(shown[[0, -1]], [0.9, 0.2], atol=0.02)


@pytest.mark.parametrize(("of", "lines"), [("station", (38, 51, 66, 74)), ("antenna 3", (63, 64))])
def test_interference_since_a_date_is_said_with_its_channels(of, lines, clean, simulation):
    """It was noise of the receiver that changes as a ripple, of the wrong sign, in channels that have none."""
    during = (clean.time_unix > 1406000000.0) & ((of == "station") | (clean.antenna == 3))  # 2014-07-22
    added = 0.15 * clean.power.mean(axis=0) * np.isin(clean.frequency_mhz, lines)
    model = fit_chain(gather_stations(replace(clean, power=clean.power + during[:, None] * added), simulation)[0])
    target = next(one for one in list_targets(model.station) if one.label == of)
    first = refine_sentence(model.linear, likeliest_sentences(model.linear, target)[0])
    place, law, course = parts_of(first.template)
    assert (place, law[0], sorted(law[1::2]), course[0]) == ("antenna", "channels", [*map(float, lines)], "step")
    assert datetime.fromisoformat(course[1]).timestamp() == pytest.approx(1406000000.0, abs=3 * 86400.0)
    assert first.size > 0.0


def test_channels_of_noise_are_no_interference(model):
    for target in list_targets(model.station)[-2:]:
        assert all(one.gain < 0.0 for one in score_interference(model, target))


def test_noise_that_one_antenna_adds_may_be_many_times_that_of_the_converters_of_all(station):
    """White noise behind one receiver, at night, of 7.5 times N_ADC was power in front along a curve of seven terms."""
    targets = {one.label: one for one in list_targets(station)}
    at_night = sentence("converter", ("flat",), ("night",))

    def can_be(target, size):
        hypothesis = Hypothesis(SENTENCE, at_night, targets[target], size, 0.01)
        return describe._is_physical_to_first_order(station.conditions, hypothesis)

    assert can_be("antenna 3", 7.5)
    assert not can_be("station", 7.5), "noise constants are of the station, and would have taken up half of that"
    assert not can_be("antenna 3", -2.5), "no noise is negative"


@pytest.mark.long
def test_absorption_in_some_nights_of_a_solar_rotation_is_a_product_of_two_courses(spoil, simulation):
    """Sky times (30 MHz / nu)^2, half way through a rotation of 27.275 days, at night."""
    _, (found,) = investigate(spoil(AuroralAbsorption(size=0.15)), simulation)
    place, law, course = parts_of(found.description.sentences[0].hypothesis.template)
    assert place in ("sky", "front")
    assert law[0] == "power"
    assert law[1] == pytest.approx(-2.0, abs=0.5)
    assert course[0] == "product"
    near = next(one for one in course[1:] if one[0] == "near")
    assert near[1] == "solar rotation"
    assert near[2] % 1.0 == pytest.approx(0.5, abs=0.06)
    assert ("night",) in course[1:]


@pytest.mark.long
def test_a_slope_since_a_date_is_said_at_once_and_not_as_five_causes(clean, simulation):
    """It was two steps, two changes of the converter's noise and a filter that moves, which left nothing."""
    late = np.clip((clean.time_unix - 1410000000.0) / 31557600.0, 0.0, None)  # 2014-09-06
    fades = np.where(clean.antenna == 3, 1.0 - 0.4 * late, 1.0)[:, None]
    report, (found,) = investigate(replace(clean, power=clean.power * fades), simulation)
    assert (report["verdict"], report["findings"]) == ("unexplained", [])
    first = report["unexplained"]["sentences"][0]
    assert (first["target"], first["parameters"]["course"][0]) == ("antenna 3", "since")
    assert first["size"]["value"] == pytest.approx(-0.4, abs=0.06)
    assert len(found.similar) > 1


@pytest.mark.long
def test_the_error_of_a_size_holds_what_the_numbers_of_its_sentence_leave_open(clean, simulation):
    """A slope since a date, against a fit of its size and its date together."""
    at = 1406000000.0  # 2014-07-22
    fades = np.where(clean.antenna == 5, 1.0 - 0.3 * np.clip((clean.time_unix - at) / 31557600.0, 0.0, None), 1.0)
    model = fit_chain(gather_stations(replace(clean, power=clean.power * fades[:, None]), simulation)[0]).linear
    target = next(one for one in list_targets(model.station) if one.label == "antenna 5")
    days = np.arange(-40, 41, 5) * 86400.0
    dated = [sentence("record", ("flat",), ("since", write_instant(at + own))) for own in days]
    shown = [signature(SENTENCE, model.terms, model.station.conditions, one) for one in dated]
    score, information = model.products(shown, [target] * len(dated))
    best = int(np.argmax(score**2 / np.diag(information)))
    moved = [shown[best], shown[best + 2] - shown[best - 2]]
    _, together = model.products(moved, [target, target])
    alone, by_both = together[0, 0] ** -0.5, np.linalg.inv(together)[0, 0] ** 0.5
    assert by_both > 1.3 * alone
    size = score[best] / information[best, best]
    scatter = scatter_by_numbers(model, ScoredSentence(dated[best], target, size / alone, size, 0.0))
    assert np.hypot(alone, scatter * size) == pytest.approx(by_both, rel=0.25)


@pytest.mark.long
def test_a_wave_of_a_period_that_no_clock_has_is_said_with_it(spoil, simulation):
    """6 % in waves of 47 days in one antenna were 23 days in February, and structure of another antenna."""
    wave = Composed(
        size=0.06, place="gain", law=("level", ()), courses=(("wave", (47.0, 0.3)),), where=Where(antennas=(3,))
    )
    report, (found,) = investigate(spoil(wave), simulation)
    first = report["unexplained"]["sentences"][0]
    name, days, _ = first["parameters"]["course"]
    assert (name, first["target"]) == ("cycle", "antenna 3")
    assert days == pytest.approx(47.0, abs=0.5)
    assert abs(abs(first["size"]["value"]) - 0.06) < 4 * first["size"]["sigma"]
    assert found.rest is None
    assert "a wave of 4" in report["unexplained"]["in_words"]


@pytest.mark.long
def test_a_shadow_that_grows_from_antenna_to_antenna_is_said_to(chain, sky, simulation):
    settings = TwinSettings(stations=("CS002",), antennas=4, events_per_year=300)
    shadow = [FieldGradient(size=0.25)]
    spectra = simulate_campaign(settings, chain, sky, np.random.default_rng(20140101), shadow).spectra
    report, (found,) = investigate(spectra, simulation)
    assert abs(found.description.grows_with_number) > 0.9
    assert "grows with their number" in report["unexplained"]["in_words"]
    assert report["unexplained"]["sentences"][0]["parameters"]["course"][:3] == ("wave", "LST", 1)


@pytest.mark.long
def test_rivals_come_with_odds_and_with_what_would_decide(spoil, simulation, monkeypatch):
    """A gain that swings with two waves a day: at this size the data tell its course, and hardly its place."""
    report, (found,) = investigate(spoil(MainsHum(size=0.006)), simulation)
    left = report["unexplained"]
    odds = [one["odds_to_first"] for one in left["sentences"]]
    assert odds[0] == 1.0
    assert len(odds) > 1
    assert all(0.05 < one <= 1.0 for one in odds)
    assert "The data hardly tell this from" in left["in_words"]
    assert "course" in left["in_words"].split("Known:")[1]
    assert "more events" in left["would_decide"]
    assert found.description.decider.times > 1.0
    monkeypatch.setattr(describe, "MOST_TIMES", 0)  # 547,813 events were asked for where there were 300
    decider = describe._what_decides(found.last.linear, *found.description.sentences[:2])
    said = _said(replace(found.description, decider=decider), found)["would_decide"]
    assert said.startswith("no more events tell the first two apart: ")


@pytest.mark.long
def test_a_cause_that_an_installation_named_is_found_by_its_name(spoil, clean, simulation, tmp_path):
    path = tmp_path / "causes.json"
    workshop = {"name": "workshop", "place": "receiver", "law": ["flat"], "course": ["working days"]}
    path.write_text(json.dumps({"format": FORMAT, "causes": [workshop]}))
    named = replace(simulation, catalogue=catalogue_with(path))
    reports = [investigate(spectra, named)[0] for spectra in (spoil(WorkingWeek(size=0.08)), clean)]
    for report, found in zip(reports, (["workshop"], []), strict=True):
        assert [one["cause"] for one in report["findings"]] == found
        assert report["verdict"] == ("explained" if found else "consistent")
        assert report["provenance"]["settings"]["own_causes"][0].startswith("workshop: the noise of the receiver")
    (adopted,) = Model.from_report(json.loads(json.dumps(reports[0]))).causes
    assert adopted.cause == "sentence"
    assert abs(adopted.size - 0.08) < 4 * adopted.sigma


def test_a_cause_of_a_column_waits_for_data_that_have_it(station):
    windy = NamedSentence.of("windy", {"place": "front", "law": ["flat"], "course": ["over", "wind_m_s", 9.0]})
    assert windy.templates(station.conditions) == []
    speed = np.linspace(0.0, 20.0, station.conditions.time_unix.size)
    conditions = station.conditions.with_covariates(wind_m_s=speed)
    (named,) = windy.templates(conditions)
    assert parts_of(named) == ("front", ("flat",), ("over", "wind_m_s", 9.0))
    assert windy.finer_templates(conditions, named) == [named], "whoever named it said its numbers"


@pytest.mark.long
def test_a_cause_that_a_sentence_explains_better_is_not_named(spoil, simulation):
    """A catalogue without absorption in the ionosphere has neighbours of it, and no sentence is one of them."""
    known = replace(simulation, catalogue=[one for one in CAUSES if one.identifier != "ionospheric_absorption"])
    report, _ = investigate(spoil(IonosphericAbsorption(size=0.04)), known)
    assert report["findings"] == []
    assert report["verdict"] == "unexplained"
    assert "the power of the sky" in report["unexplained"]["in_words"]


@pytest.mark.long
def test_a_cause_whose_hours_a_sentence_tells_more_exactly_is_named(spoil, simulation):
    """Interference between whole hours in the catalogue: a sentence with the minutes fits better, and says the same."""
    report, _ = investigate(spoil(RfiBroadband(size=0.06, index=0.0, hours=(17.6, 22.4))), simulation)
    assert [one["cause"] for one in report["findings"]] == ["rfi_broadband"]
    (adopted,) = Model.from_report(json.loads(json.dumps(report))).causes
    assert adopted.parameters["utc_h"] == pytest.approx([17.6, 22.4], abs=0.25)


@pytest.mark.long
def test_what_the_test_along_axes_is_too_wide_for_is_said_by_a_sentence(spoil, clean, simulation):
    """Absorption in some nights of a solar rotation was consistent: its axis has 24 functions, a gate none."""
    (spoilt,), (quiet,) = (gather_stations(one, simulation) for one in (spoil(AuroralAbsorption(size=0.06)), clean))
    assert find_structure(fit_chain(spoilt).linear, np.random.default_rng(0), 0.002) is None
    report = search_station(spoilt)
    assert report.findings == []
    assert report.structure.axis_name in {"date, period 27.3 d", "utc"}  # by night, in some nights
    assert search_station(quiet).structure is None


@pytest.mark.long
@pytest.mark.parametrize(
    ("fault", "without", "place"),
    [
        (DipoleSwap(size=0.15), "dipole_swap", "letters"),
        (LstOffset(size=0.2), "lst_offset", "time"),
        (Compression(size=0.3), "compression", "level"),
    ],
)
def test_what_a_shorter_catalogue_lacks_is_said(spoil, simulation, fault, without, place):
    """Polarisations exchanged, a clock that is off, a gain that falls with the total power: no separable course."""
    known = replace(simulation, catalogue=[one for one in CAUSES if one.identifier != without])
    _, (found,) = investigate(spoil(fault), known)
    assert parts_of(found.description.sentences[0].hypothesis.template)[0] == place


@pytest.mark.long
def test_an_effect_on_a_cable_is_not_said_of_one_of_its_paths(spoil, simulation):
    fault = GainStep(size=0.04, date="2014-05-20", where=Where(cables=("115",)))
    known = replace(simulation, catalogue=[one for one in CAUSES if one.identifier != "gain_step"])
    _, (found,) = investigate(spoil(fault), known)
    first = found.description.sentences[0].hypothesis
    assert first.target.label == "cable 115"
    assert parts_of(first.template)[2][0] == "step"
    assert abs(first.size - 0.04) < 4 * first.sigma


@pytest.mark.long
def test_a_ripple_that_starts_on_a_date_was_named_a_wide_resonance_that_follows_season(clean, simulation):
    """No law by which sentences were noticed looks like a ripple: 3 % in one antenna were explained by two causes."""
    since = clean.time_unix >= np.quantile(clean.time_unix, 0.55)
    ripple = 0.03 * np.cos(2.0 * np.pi * 0.085 * clean.frequency_mhz)
    is_there = (clean.antenna == 1) & since
    report, _ = investigate(replace(clean, power=clean.power * (1.0 + ripple * is_there[:, None])), simulation)
    assert report["findings"] == []
    first = report["unexplained"]["sentences"][0]
    assert first["target"] == "antenna 1"
    assert [first["parameters"][part][0] for part in ("law", "course")] == ["ripple", "step"]
    assert abs(first["size"]["value"]) == pytest.approx(0.03, abs=5 * first["size"]["sigma"])


def test_a_delay_has_the_digits_that_the_data_support(monkeypatch):
    """It was given to the steps of its grid, 8.875 h, where a delay of 8.3 h was as likely."""
    late = ScoredSentence(sentence("behind", ("flat",), ("late", 8.875)), None, 1.0, 1.0, 0.0)

    def score_with(error):
        def score(_, one, templates):
            delays = [parts_of(template)[2][1] for template in templates]
            return [replace(one, z=(900.0 - ((hours - 8.875) / error) ** 2) ** 0.5) for hours in delays]

        return score

    for error, told in ((0.6, 8.9), (2.0, 9.0), (0.05, 8.88)):
        monkeypatch.setattr(sentences, "_score_alike", score_with(error))
        assert parts_of(sentences._round_delay(None, late).template)[2] == ("late", told)


def test_the_number_of_events_on_which_a_course_hardly_acts_is_one(station):
    """A product of two that nearly exclude each other: the squares of its squares were 0, and their ratio no number."""
    conditions = station.conditions
    at = ("near", "UTC", float(conditions.time_unix[0] / 86400 % 1), 0.001)
    far = ("product", at, ("near", "UTC", float((conditions.time_unix[0] / 86400 + 0.03) % 1), 0.001))
    assert course_of(conditions, far).max() < 1e-90
    assert _count_events(conditions, sentence("sky", ("flat",), far)) >= 1.0
