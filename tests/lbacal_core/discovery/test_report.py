import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lbacal_core.causes.grammar import law_of, sentence, size_at_mhz
from lbacal_core.discovery.describe import Described, Description
from lbacal_core.discovery.hypothesis import Hypothesis, list_targets
from lbacal_core.discovery.policy import Policy
from lbacal_core.discovery.report import _place_of, _steps_together, _tell_sentence, investigate
from lbacal_core.discovery.sentences import SENTENCE
from lbacal_core.errors import LbacalError
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.differences import model_difference_modes
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.hardware import GainStep, GainTemperature
from lbacal_twin.faults.sky import RfiBroadband
from lbacal_twin.faults.uncatalogued import MainsHum
from tests.lbacal_core.discovery.worlds import MOVING, STATIC


def thresholds():
    """Probabilities by chance below which each question has an answer."""
    policy = Policy()
    return {"catalogue": policy.catalogue_alpha, "static": policy.antenna_alpha, "structure": policy.structure_alpha}


def ask(world, *faults, **options):
    return investigate(world.spectra(*faults), world.simulation, **options)


@pytest.fixture(scope="module")
def two(world):
    return world.with_settings(stations=("CS002", "CS003"), events_per_year=150)


@pytest.fixture(scope="module")
def pair(two):
    """CS002 and CS003, a step of the gain of one antenna of the second."""
    step = GainStep(size=0.08, date="2014-07-01", where=Where(stations=("CS003",), antennas=(1,)))
    return ask(two, step)


def said(station, law, course):
    """A report that says a sentence of antenna 3."""
    target = next(one for one in list_targets(station) if one.label == "antenna 3")
    one = Hypothesis(SENTENCE, sentence("record", law, course), target, -0.2, 0.002)
    return SimpleNamespace(station=station, description=Description([Described(one, 900.0, 30.0, 400.0)]))


def test_structure_is_where_the_sentence_that_describes_it_says(station):
    """The first line named dipole Y at 77-80 MHz, and the sentence below the antenna, alike at all frequencies."""
    weakest = np.eye(station.conditions.frequency_mhz.size)[-1]
    seen = SimpleNamespace(axis=None, axis_name="event", target="antenna 3 Y", channel_share=weakest)
    report = said(station, ("flat",), ("night",))
    assert _place_of(seen, report) == ("utc", "antenna 3", 30.0, 80.0)
    report = said(station, ("channels", 38.0, 1.0, 66.0, 0.8), ("step", "2014-07-20T06:02:43Z"))
    assert _place_of(seen, report) == ("date", "antenna 3", 38.0, 66.0)
    report.description = Description()
    assert _place_of(seen, report) == ("event", "antenna 3 Y", 80.0, 80.0)


@pytest.mark.parametrize(
    ("law", "at"),
    [
        (("flat",), None),
        (("power", -2.0, 30.0), 30.0),
        (("curve", 0.5, -0.5), 30.0),
        (("tilt",), 80.0),
        (("channels", 38.0, 0.8, 66.0, 1.0), 66.0),
        (("resonance",), None),
    ],
)
def test_a_size_comes_with_the_frequency_at_which_it_holds(law, at, station):
    """A gain that fell by 20 % at 30 MHz, by 10 at 55 and not at 80 was said to fall by 0.195 along a curve."""
    report = said(station, law, ("always",))
    (one,) = report.description.sentences
    assert size_at_mhz(station.conditions, one.hypothesis.template) == at
    words = _tell_sentence(one.hypothesis, report)
    assert words.count(" at 30 MHz") + words.count(" at 66 MHz") + words.count(" at 80 MHz") == (at is not None)
    if at is not None:
        assert law_of(station.conditions, law)[0, 0][station.conditions.frequency_mhz == at] == pytest.approx(1.0)


@pytest.mark.long
def test_of_two_stations_the_one_with_the_fault_is_named(pair):
    report, stations = pair
    assert report["verdict"] == "explained"
    (finding,) = report["findings"]
    where = finding["where"]
    assert (finding["cause"], where["station"], where["antennas"]) == ("gain_step", "CS003", [1])
    assert [one.station.name for one in stations] == ["CS002", "CS003"]
    json.dumps(report, allow_nan=False)


@pytest.mark.long
def test_every_station_has_its_verdict_its_structure_and_what_it_can_never_show(two):
    """A cause was once said to be found and to be impossible, and the structure of the second station was dropped."""
    spectra = two.spectra(MainsHum(size=0.03))
    bare = np.where(spectra.station == "CS003", np.nan, spectra.environment["temperature_c"])
    spectra = replace(spectra, environment={**spectra.environment, "temperature_c": bare})
    report, _ = investigate(spectra, two.simulation)
    first, second = report["stations"]
    assert [one["station"] for one in (first, second)] == ["CS002", "CS003"]
    assert [one["verdict"] for one in (first, second)] == ["unexplained", "unexplained"]
    assert [one["unexplained"]["where"]["station"] for one in (first, second)] == ["CS002", "CS003"]
    assert report["unexplained"] in (first["unexplained"], second["unexplained"])
    impossible = {(one["station"], one["cause"]) for one in report["unidentifiable"]}
    assert ("CS003", "gain_temperature") in impossible
    assert ("CS002", "gain_temperature") not in impossible
    assert len(report["unidentifiable"]) == len(first["unidentifiable"]) + len(second["unidentifiable"])


@pytest.mark.long
def test_the_findings_of_a_station_are_named_by_their_place_in_the_whole(pair):
    report, _ = pair
    assert [one["findings"] for one in report["stations"]] == [[], [0]]
    assert [one["verdict"] for one in report["stations"]] == ["consistent", "explained"]


@pytest.mark.long
def test_numbers_that_are_not_known_are_null(world):
    report, _ = ask(world, GainStep(size=0.08, date="2014-07-01", where=Where(antennas=(1,))))
    (named,) = report["findings"]
    assert named["where"]["lst_h"] is None
    assert named["where"]["utc_h"] is None
    assert named["evidence"]["events"] == named["gain"]["held_out_events"] == 200
    assert "from 2014-" in named["sentence"]


def test_rivals_are_told_with_their_odds_and_the_judge_with_them(pair):
    report, _ = pair
    (named,) = report["findings"]
    rivals = named["evidence"]["rivals"]
    assert rivals
    assert [one["odds"] for one in rivals] == sorted((one["odds"] for one in rivals), reverse=True)
    for one in rivals:
        assert one["odds"] == pytest.approx(np.exp(-0.5 * one["delta_chi2"]))
    assert report["provenance"]["judge"] == "compete"


def test_the_noise_and_the_scores_of_both_stations_are_reported(pair):
    report, _ = pair
    assert set(report["noise"]) == set(report["scores"]) == {"CS002", "CS003"}
    for noise in report["noise"].values():
        assert noise["radiometer_per_mhz"] == pytest.approx(512**-0.5, rel=0.1)
        assert noise["path_event_gain"] == pytest.approx(0.04, rel=0.25)
        assert noise["station_event_gain"] == pytest.approx(0.03, rel=0.35)
        assert len(noise["common_per_mhz"]) == 2
    asked = {score["cause"] for score in report["scores"]["CS002"]}
    assert asked <= {*MOVING, *STATIC}
    assert len(asked) >= 20


@pytest.mark.long
def test_the_false_alarm_rate_is_shared_by_all_stations(world):
    """A finding that one station alone would make must be k times rarer where k stations are asked."""
    look = world.look(GainTemperature(size=0.007))
    report = look.investigate()
    (finding,) = report.findings
    assert 1e-12 < finding.score.p_value < thresholds()["catalogue"]
    enough = int(thresholds()["catalogue"] / finding.score.p_value)
    assert len(look.investigate(stations=int(0.9 * enough)).findings) == 1
    assert look.investigate(stations=int(1.1 * enough) + 1).findings == []


def test_the_thresholds_of_the_questions_add_up_to_at_most_one_data_set_in_a_hundred():
    assert sum(thresholds().values()) <= 0.01


@pytest.fixture(scope="module")
def wrong_sky(world):
    """Data under a sky that differs from the own by one of the shapes in which models differ."""
    modes = model_difference_modes(world.instrument, world.sky.lst_hours)
    power = {d: world.sky.power[d] * np.exp(modes[d][1]) for d in "XY"}
    return replace(world, sky=replace(world.sky, power=power)).spectra()


@pytest.mark.long
def test_a_sky_like_another_model_is_seen_and_not_misnamed_where_the_sky_is_taken_at_its_word(wrong_sky, world):
    report, _ = investigate(wrong_sky, world.simulation)
    assert report["verdict"] == "unexplained"
    assert report["findings"] == []
    assert report["unexplained"]["p_value"] < 1e-6


@pytest.mark.long
def test_a_sky_like_another_model_is_consistent_where_models_may_differ(wrong_sky, world):
    report, _ = investigate(wrong_sky, Simulation(world.instrument, world.sky, is_own_sky=True))
    assert report["verdict"] == "consistent"
    assert report["provenance"]["settings"]["own_sky"] is True


@pytest.fixture(scope="module")
def found(world):
    """A finding with an open template: hours and spectral index of interference."""
    return ask(world, RfiBroadband(size=0.008, index=-2.0, hours=(6.0, 18.0)))


@pytest.mark.long
def test_a_finding_reports_the_error_with_the_open_template(found):
    report, (station,) = found
    named = next(one for one in report["findings"] if one["cause"] == "rfi_broadband")
    effect = next(one.hypothesis for one in station.findings if one.hypothesis.cause.identifier == "rfi_broadband")
    size = named["size"]
    assert size["sigma"] == pytest.approx(np.hypot(effect.sigma, effect.template_sigma * effect.size))
    assert size["sigma"] >= named["evidence"]["sigma_for_this_template"]
    assert size["value"] == pytest.approx(0.008, abs=3 * size["sigma"])


def test_a_finding_says_where_when_and_what_it_gains(found):
    report, (station,) = found
    named = report["findings"][0]
    where, gain = named["where"], named["gain"]
    assert where["utc_h"] == [float(h) for h in named["parameters"]["utc_h"]]
    assert where["antennas"] == [0, 1, 2]
    assert where["dipoles"] == ["X", "Y"]
    assert where["frequency_mhz"] == [30.0, 80.0]
    assert gain["chi2_after"] < gain["chi2_before"]
    assert gain["residual_variance_explained"] == pytest.approx(1 - gain["chi2_after"] / gain["chi2_before"])
    assert gain["held_out_log_likelihood_gain"] > 0
    # What a finding gains in chi^2 is about the square of its score.
    score = named["evidence"]["score_sigma"]
    assert gain["chi2_before"] - gain["chi2_after"] == pytest.approx(score**2, rel=0.35)
    assert gain["chi2_after"] / gain["dof"] == pytest.approx(1.0, abs=0.05)
    change = np.abs(station.findings[0].calibration_change)
    assert named["calibration_change"] == pytest.approx(
        {"max_fraction": change.max(), "median_fraction": np.median(change)}
    )
    assert 3 < named["significance_sigma"] < abs(score)
    for word in ("CS002", "interference", "±"):
        assert word in named["sentence"]


def test_channels_that_differ_are_refused(world):
    other = replace(world.instrument, frequency_mhz=world.instrument.frequency_mhz + 0.5)
    with pytest.raises(LbacalError):
        investigate(world.spectra(), Simulation(other, world.sky))


def test_steps_of_several_antennas_ask_whether_these_change_places():
    """Three steps that explain everything were named, beside an audit that told who stands where."""

    def report(*found):
        return SimpleNamespace(
            findings=[
                SimpleNamespace(
                    hypothesis=SimpleNamespace(
                        cause=SimpleNamespace(identifier=cause), target=SimpleNamespace(label=target)
                    )
                )
                for cause, target in found
            ]
        )

    assert _steps_together(report(("gain_step", "antenna 1"), ("gain_step", "antenna 2")))
    assert not _steps_together(report(("gain_step", "antenna 1"), ("gain_step", "antenna 1")))
    assert not _steps_together(report(("gain_step", "antenna 1"), ("adc_noise_step", "antenna 2")))
