from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.causes.cable import AntennaTemplate
from lbacal_core.discovery.antennas import Comparison, smooth_departures, typical_amounts
from lbacal_core.discovery.hypothesis import p_of
from lbacal_core.discovery.refit import fit_chain
from lbacal_core.discovery.report import describe_station, investigate
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.hardware import CableLength, CableReflection
from lbacal_twin.faults.sky import RfiLine
from lbacal_twin.gains import NOISES
from lbacal_twin.nuisances import Nuisances
from tests.lbacal_core.discovery.worlds import Look, look_at


@pytest.fixture(scope="module")
def alike(world):
    """Eight antennas of one cable name."""
    records = [r for r in world.instrument.antennas if r.station == "CS002"]
    names = [record.cable for record in records]
    common = max(set(names), key=names.count)
    chosen = [record for record in records if record.cable == common][:8]
    return replace(world, instrument=replace(world.instrument, antennas=chosen)).with_settings(antennas=None)


UNEQUAL = Nuisances(departures=0.01)


def best(look):
    return look.static_scores()[0]


def score_of(look, cause):
    return next(score for score in look.static_scores() if score.cause.identifier == cause)


def length_score(look):
    return score_of(look, "cable_length")


def reflection_score(look):
    return score_of(look, "cable_reflection")


@pytest.mark.long
def test_antennas_that_are_alike_show_no_departure(alike):
    p = [best(replace(alike, seed=seed).look()).p_value for seed in range(6)]
    assert min(p) > 0.01
    assert np.median(p) < 0.95, "what is never significant cannot be found either"


@pytest.mark.parametrize("metres", [3.0, -3.0])
def test_a_wrong_length_has_its_antenna_its_sign_and_its_size(metres, alike):
    antenna = int(alike.station.scene.antennas[3])
    score = best(alike.look(CableLength(size=metres, where=Where(antennas=(antenna,)))))
    assert (score.cause.identifier, score.target.label) == ("cable_length", f"antenna {antenna}")
    assert score.p_value < 1e-3
    # The answer is that of both static causes: each has the same right to a false alarm.
    assert score.p_value == pytest.approx(2 * p_of(abs(score.z), score.trials), rel=1e-3)
    assert score.size == pytest.approx(metres, abs=3 * score.sigma)
    assert np.sign(score.z) == np.sign(metres)
    assert score.sigma < 0.25 * abs(metres)


@pytest.mark.long
def test_the_size_of_a_length_scatters_no_more_than_its_error(alike):
    sizes, sigmas = [], []
    antenna = int(alike.station.scene.antennas[3])
    for seed in range(8):
        score = length_score(replace(alike, seed=seed).look(CableLength(size=2.0, where=Where(antennas=(antenna,)))))
        sizes.append(score.size)
        sigmas.append(score.sigma)
    assert np.mean(sizes) == pytest.approx(2.0, abs=3 * np.std(sizes) / 8**0.5)
    assert 0.4 < np.std(sizes) / np.mean(sigmas) < 1.8  # 1.0 +- 0.25 of 8 sizes


def test_a_reflection_is_named_with_its_delay_and_amplitude(alike):
    antenna = int(alike.station.scene.antennas[5])
    fault = CableReflection(size=0.04, delay_us=0.4, phase_rad=1.0, where=Where(antennas=(antenna,)))
    score = best(alike.look(fault))
    assert score.cause.identifier == "cable_reflection"
    assert score.target.label == f"antenna {antenna}"
    assert score.parameters["delay_us"] == pytest.approx(0.4, abs=0.01)
    assert score.size == pytest.approx(0.04, abs=3 * score.sigma)
    assert score.size > 0
    assert score.chi2_after < score.chi2_before
    assert score.chi2_before - score.chi2_after > 10
    assert score.dof == 49


def test_without_others_of_its_cable_an_antenna_is_compared_with_none(world):
    spectra = world.spectra()
    assert look_at(spectra.select(spectra.antenna == 1), world.simulation).static_scores() == []
    # Three antennas of one cable make two comparisons: three are needed.
    records = {r.antenna: r.cable for r in world.instrument.antennas if r.station == "CS002" and r.antenna < 3}
    assert len(set(records.values())) == 1
    assert world.look().static_scores() == []


def test_two_dipoles_know_the_departure_of_their_antenna_better_than_one_by_root_two(alike):
    spectra = alike.spectra()
    one = best(look_at(spectra.select(spectra.dipole == "X"), alike.simulation))
    both = best(look_at(spectra, alike.simulation))
    # X and Y have other noise in the weakest channels.
    assert np.median(one.error / both.error) == pytest.approx(2**0.5, rel=0.1)


def test_smooth_departures_of_antennas_leak_into_no_ripple(alike):
    """Departures of up to two periods in the band made ripples of 0.1 us in all antennas, and hid true ones."""

    def look(*faults):
        return look_at(alike.spectra(*faults, nuisances=UNEQUAL), alike.simulation)

    score = reflection_score(look())
    assert score.p_value > 0.01
    assert score.chi2_before < 2 * score.dof
    antenna = int(alike.station.scene.antennas[5])
    fault = CableReflection(size=0.02, delay_us=0.1, phase_rad=1.0, where=Where(antennas=(antenna,)))
    score = reflection_score(look(fault))
    assert (score.target.label, score.p_value < 1e-4) == (f"antenna {antenna}", True)
    assert score.parameters["delay_us"] == pytest.approx(0.1, abs=0.01)
    assert score.size == pytest.approx(0.02, abs=3 * score.sigma)
    assert np.abs(score.observed - score.size * score.departure).max() < 6 * score.error.max()


@pytest.mark.parametrize("seed", [1, 4, 5])
def test_a_length_is_weighed_by_the_smooth_departures_of_the_antennas(alike, seed):
    """In 6 of 16 drawn worlds the departures of the others hid a length that shows 10 sigma to who knows them."""

    world = replace(alike, seed=seed)

    def look(*faults):
        return look_at(world.spectra(*faults, nuisances=UNEQUAL), world.simulation)

    assert length_score(look()).p_value > 0.01
    antenna = int(alike.station.scene.antennas[3])
    score = length_score(look(CableLength(size=8.0, where=Where(antennas=(antenna,)))))
    assert (score.target.label, score.p_value < 1e-4) == (f"antenna {antenna}", True)
    assert score.size == pytest.approx(8.0, abs=3 * score.sigma)
    assert score.chi2_after < 1.5 * score.dof < score.chi2_before


def test_an_antenna_less_smooth_than_most_is_no_reflection(alike):
    """One that departed along one cosine more than the others was a reflection of 0.042 us, in 1 of 2,288 worlds."""
    spectra = alike.spectra(nuisances=UNEQUAL)
    # Most antennas of this world depart along four.
    wave = np.cos(np.pi * 5 * np.linspace(0, 1, spectra.frequency_mhz.size))
    is_one = spectra.antenna == alike.station.scene.antennas[5]
    bent = replace(spectra, power=spectra.power * np.where(is_one[:, None], 1 + 0.015 * wave, 1.0))
    score = reflection_score(look_at(bent, alike.simulation))
    assert score.p_value > 0.01


@pytest.mark.long
def test_what_a_finding_leaves_along_frequency_is_no_reflection(alike):
    """Half of a line of interference was left in its channel, and named a reflection of the same antenna."""
    antenna = int(alike.station.scene.antennas[5])
    line = RfiLine(size=0.3, line_mhz=45.0, width_mhz=0.5, where=Where(antennas=(antenna,)))
    look = alike.look(line)
    before = reflection_score(look)
    assert (before.target.label, before.p_value < 1e-5) == (f"antenna {antenna}", True)
    report = look.investigate()
    assert [finding.hypothesis.cause.identifier for finding in report.findings] == ["rfi_line"]
    assert report.antennas == []


def test_a_slow_ripple_is_named_where_antennas_are_alike(alike):
    """What is smooth in no other antenna is left free in none."""
    antenna = int(alike.station.scene.antennas[5])
    fault = CableReflection(size=0.015, delay_us=0.04, phase_rad=1.0, where=Where(antennas=(antenna,)))
    score = best(alike.look(fault))
    assert (score.cause.identifier, score.target.label) == ("cable_reflection", f"antenna {antenna}")
    assert (score.dof, score.p_value < 1e-4) == (49, True)


def bend(alike, departure):
    """The station with a factor along frequency in the gain in front of one antenna, and the number of that antenna."""
    data, terms = alike.look().data, alike.look().model.baseline.terms
    front = ((terms.sky + terms.n_lna) * terms.front / terms.power())[data.class_of]
    antenna = int(alike.station.scene.antennas[5])
    is_one = (data.antenna == antenna)[:, None, None]
    bent = replace(data, power=data.power * (1.0 + is_one * front * np.expm1(departure)))
    return Look(bent, fit_chain(bent), None), antenna


@pytest.mark.parametrize("slope", [-0.3, -0.08, 0.08, 0.3])
def test_another_slope_of_one_gain_has_no_name(alike, slope):
    """It was a reflection of 0.02 us, of 1.1 periods in the band, which left most of it."""
    departure = slope * (alike.instrument.frequency_mhz - 55.0) / 25.0
    look, antenna = bend(alike, departure)
    (reflection,) = [one for one in look.static_scores() if one.cause.identifier == "cable_reflection"]
    assert (reflection.target.label, reflection.p_value < 1e-4) == (f"antenna {antenna}", True)
    assert reflection.parameters["delay_us"] > 0.029, "1.5 periods"
    np.testing.assert_allclose(reflection.law.departure, departure - departure.mean(), atol=0.03 * abs(slope) + 0.006)


@pytest.mark.parametrize("metres", [8.0, -15.0])
def test_a_large_wrong_length_is_no_reflection(alike, metres):
    """The scatter of the others was smaller along a ripple of one period, which came first."""
    antenna = int(alike.station.scene.antennas[3])
    scores = alike.look(CableLength(size=metres, where=Where(antennas=(antenna,)))).static_scores()
    (named,) = [one for one in scores if one.p_value < 1e-4 and one.law is None]
    assert (named.cause.identifier, named.target.label) == ("cable_length", f"antenna {antenna}")


def test_a_slow_reflection_holds_against_a_smooth_law_with_its_delay(alike):
    """0.042 us were found of 0.035: the delays about the one that stood out did not reach it."""
    antenna = int(alike.station.scene.antennas[0])
    fault = CableReflection(size=0.03, delay_us=0.035, phase_rad=0.0, where=Where(antennas=(antenna,)))
    score = reflection_score(replace(alike, seed=0).look(fault))
    assert (score.target.label, score.law) == (f"antenna {antenna}", None)
    assert score.parameters["delay_us"] == pytest.approx(0.035, abs=0.003)


def test_what_departs_by_a_smooth_law_is_said_and_not_explained(alike):
    look, antenna = bend(alike, 0.3 * (alike.instrument.frequency_mhz - 55.0) / 25.0)
    report = look.investigate()
    content = describe_station(report).station
    assert (report.findings, report.antennas, report.structure) == ([], [], None)
    assert (content["verdict"], content["unexplained"]["where"]["target"]) == ("unexplained", f"antenna {antenna}")
    assert (
        "another slope along frequency than in the others of its cable: by +0.6 from"
        in content["unexplained"]["in_words"]
    )
    as_named = replace(report, antennas=[replace(report.departure, law=None)], departure=None)
    (named,) = describe_station(as_named).findings
    assert named["calibration_change"] == {"max_fraction": 0.0, "median_fraction": 0.0}, "as an adoption says"


SEEDS = 12


@pytest.fixture(scope="module")
def three_names(world):
    """Nine antennas of three cable names, 400 events: long enough to tell the names apart."""
    return with_names(world, ("50", "80", "115"))


def with_names(world, names):
    records = [r for r in world.instrument.antennas if r.station == "CS002"]
    chosen = [record for name in names for record in [r for r in records if r.cable == name][:3]]
    instrument = replace(world.instrument, antennas=chosen)
    return replace(world, instrument=instrument).with_settings(antennas=None, events_per_year=400)


def look_in(world, noise, seed, *faults):
    return look_at(replace(world, seed=seed).spectra(*faults, gains=NOISES[noise]), world.simulation)


@pytest.mark.long
@pytest.mark.parametrize("noise", ["behind", "front", "resonance"])
def test_gains_that_all_antennas_share_make_no_cable_name_longer(noise, three_names):
    """Errors of single antennas alone gave 5-13 sigma: a gain of an event moves the slopes of a name together."""
    scores = [look_in(three_names, noise, seed).cable_scores() for seed in range(SEEDS)]
    z = np.array([score.z for one in scores for score in one])
    # Three contrasts of which two are independent, in 12 data sets: the spread is known to 15 %.
    assert 0.6 < z.std() < 1.45
    assert min(score.p_value for one in scores for score in one) > 1e-3


@pytest.mark.parametrize("metres", [12.0, -12.0])
def test_a_wrong_length_of_a_cable_name_has_its_name_its_sign_and_its_size(metres, three_names):
    fault = CableLength(size=metres, where=Where(cables=("115",)))
    best = look_in(three_names, "front", 1, fault).cable_scores()[0]
    assert best.target.label == "cable 115"
    assert best.size == pytest.approx(metres, abs=3 * best.sigma)
    assert best.sigma < 0.25 * abs(metres)
    assert best.p_value < 1e-3


def test_of_two_cable_names_either_may_be_the_wrong_one(world):
    two = with_names(world, ("50", "115"))
    first, second = look_in(two, "behind", 1, CableLength(size=12.0, where=Where(cables=("115",)))).cable_scores()
    assert first.size == pytest.approx(-second.size, rel=1e-6)
    assert first.p_value == pytest.approx(second.p_value, rel=1e-6)
    assert "the other one would look the same" in first.cause.note(first.parameters, first.size)


def test_names_that_are_no_lengths_and_names_of_one_antenna_are_not_compared(world, three_names):
    assert look_in(with_names(world, ("80",)), "behind", 1).cable_scores() == []
    records = [replace(r, cable=f"coil {r.cable}") for r in three_names.instrument.antennas]
    cables = {f"coil {name}": loss for name, loss in three_names.instrument.cables.items()}
    coils = replace(three_names, instrument=replace(three_names.instrument, antennas=records, cables=cables))
    assert look_in(coils, "behind", 1).cable_scores() == []


@pytest.mark.long
def test_a_wrong_cable_table_is_a_finding_for_all_antennas_of_the_name(three_names):
    fault = CableLength(size=25.0, where=Where(cables=("115",)))
    report, _ = investigate(replace(three_names, seed=1).spectra(fault), three_names.simulation)
    (finding,) = report["findings"]
    assert finding["cause"] == "cable_length"
    members = sorted(r.antenna for r in three_names.instrument.antennas if r.cable == "115")
    assert finding["where"]["antennas"] == members
    assert finding["where"]["dipoles"] == ["X", "Y"]
    assert finding["size"]["value"] == pytest.approx(25.0, abs=3 * finding["size"]["sigma"])
    assert finding["evidence"]["target"] == "cable 115"


CHANNELS = 40
PLACE = np.linspace(0.0, 1.0, CHANNELS)
COSINES = np.cos(np.pi * np.outer([1, 2, 3], PLACE))


@pytest.fixture
def rng():
    return np.random.default_rng(20261123)


def draw(rng, amounts, count=200, error=1e-3):
    """Antennas that depart along three cosines by normal amounts, beside a gain that is flat and the noise of a fit."""
    root = error * np.diag(1.0 + PLACE)
    found = []
    for _ in range(count):
        smooth = rng.normal(size=(2, 3)) * amounts @ COSINES
        departure = rng.normal(size=(2, 1)) + smooth + rng.normal(size=(2, CHANNELS)) @ root
        found.append(Comparison(root, departure, np.empty((0, CHANNELS)), np.empty(0)))
    return found


def test_typical_amounts_are_the_scatter_of_the_antennas(rng):
    amounts = np.array([0.1, 0.03, 0.01])
    # 400 values: the median is known to 6 %.
    assert typical_amounts(draw(rng, amounts), COSINES) == pytest.approx(amounts, rel=0.25)
    far = draw(rng, np.zeros(3), count=1)[0]
    far = Comparison(far.root, far.departure + 10 * COSINES[0], far.smooth, far.typical)
    assert typical_amounts([*draw(rng, amounts), far], COSINES) == pytest.approx(amounts, rel=0.25)


def test_antennas_that_are_alike_have_no_typical_departures(rng):
    alike = draw(rng, np.zeros(3), count=10)
    smooth = smooth_departures(alike, np.array(["80"] * 10), 30.0 + 50 * PLACE)
    assert (len(smooth), len(typical_amounts(alike, smooth))) == (0, 0)


@pytest.mark.parametrize("typical", [np.array([0.1, 0.03, 0.01]), np.array([0.05, np.inf, 1e-6])])
def test_beside_departures_of_typical_amounts_a_template_is_weighed_by_their_covariance(rng, typical):
    """As by hand: noise of the fit, a flat gain without limit, and each departure with its variance."""
    one = draw(rng, np.array([0.1, 0.03, 0.01]), count=1)[0]
    template = AntennaTemplate({}, np.sqrt(0.3 + PLACE))
    beside = one.beside(COSINES, typical)
    variance = np.where(np.isinf(typical), 10.0, typical) ** 2
    covariance = one.root @ one.root.T + (COSINES.T * variance) @ COSINES + 100.0 * np.ones((CHANNELS, CHANNELS))
    weighed = np.linalg.solve(covariance, template.departure)
    expected = one.departure @ weighed / np.sqrt(template.departure @ weighed)
    assert beside.amplitudes([template])[:, 0] == pytest.approx(expected, rel=1e-3)
    before, after = beside.chi_squared(template, 0.0)
    assert before == after == pytest.approx(one.departure[0] @ np.linalg.solve(covariance, one.departure[0]), rel=1e-3)
