from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from lbacal_core.causes.axes import axis_named
from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.causes.cause import Template
from lbacal_core.causes.grammar import parts_of
from lbacal_core.causes.model import AdoptedCause, Model
from lbacal_core.discovery import search
from lbacal_core.discovery.describe import Description
from lbacal_core.discovery.findings import Finding, Grown, StationSearch, _idle
from lbacal_core.discovery.growth import grow
from lbacal_core.discovery.hypothesis import Hypothesis, Target
from lbacal_core.discovery.policy import Policy
from lbacal_core.discovery.refit import refit
from lbacal_core.discovery.residual_structure import ResidualStructure
from lbacal_core.discovery.search import _lives_there, _seen_beside, _standing, search_station
from lbacal_core.discovery.station import gather_stations, model_modes
from lbacal_core.sky.differences import compute_model_differences
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.composed import Composed
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.hardware import GainStep, GainTemperature
from lbacal_twin.faults.sky import DipoleAzimuth, LstOffset, RfiBroadband
from lbacal_twin.faults.uncatalogued import MainsHum
from tests.lbacal_core.discovery.conftest import SEED, SETTINGS


@pytest.mark.long
def test_every_number_of_a_finding_is_of_the_last_model(chain, sky, simulation):
    """Two effects: what each gains is against the model with the other alone, not against that of its step."""
    faults = [GainStep(size=0.03, where=Where(antennas=(2,)), date="2014-08-07"), LstOffset(size=0.1)]
    spectra = simulate_campaign(SETTINGS, chain, sky, np.random.default_rng(SEED), faults).spectra
    report = search_station(gather_stations(spectra, simulation)[0])
    assert {one.hypothesis.cause.identifier for one in report.findings} == {"gain_step", "lst_offset"}
    chi2, dof = report.last.linear.chi_squared()
    for finding in report.findings:
        assert (finding.chi2_after, finding.dof) == (chi2, dof)
        expected = (finding.hypothesis.size / finding.hypothesis.sigma) ** 2
        # Chi^2 is not quite quadratic in the size.
        assert finding.chi2_before - finding.chi2_after == pytest.approx(expected, rel=0.15)
    whole = report.first.linear.with_levels(report.last.linear.residuals.levels).chi_squared()[0]
    assert whole > max(finding.chi2_before for finding in report.findings)


@pytest.mark.long
def test_the_sizes_of_all_findings_are_those_of_the_last_fit(world):
    """A cause that is found second moves the size of the first: both are reported as fitted together."""
    report = world.look(GainTemperature(size=0.02), LstOffset(size=0.4)).investigate()
    found = {finding.hypothesis.cause.identifier: finding.hypothesis for finding in report.findings}
    assert set(found) == {"gain_temperature", "lst_offset"}
    together = {one.cause.identifier: one for one in report.last.hypotheses}
    for cause, size in (("gain_temperature", 0.02), ("lst_offset", 0.4)):
        assert (found[cause].size, found[cause].sigma) == (together[cause].size, together[cause].sigma)
        assert found[cause].size == pytest.approx(size, abs=3 * found[cause].uncertainty)


@pytest.mark.long
def test_beside_an_adopted_cause_only_what_is_left_is_found(world):
    """The adopted cause is no finding; its size is fitted with those that are found, each of which is of that model."""
    adopted = AdoptedCause("lst_offset", "CS002", "station", 0.3, 0.02)
    look = world.look(GainTemperature(size=0.02), LstOffset(size=0.4))
    report = look.investigate(model=Model((adopted,)))
    (found,) = report.findings
    assert found.hypothesis.cause.identifier == "gain_temperature"
    assert found.hypothesis.size == pytest.approx(0.02, abs=3 * found.hypothesis.uncertainty)
    assert [one.cause.identifier for one in report.first.hypotheses] == ["lst_offset"]
    assert [one.cause.identifier for one in report.last.hypotheses] == ["lst_offset", "gain_temperature"]
    (size,) = report.adopted
    assert size.value == pytest.approx(0.4, abs=4 * size.sigma)
    expected = (found.hypothesis.size / found.hypothesis.sigma) ** 2
    assert found.chi2_before - found.chi2_after == pytest.approx(expected, rel=0.15)


@pytest.mark.long
def test_an_adopted_cause_of_the_wrong_form_leaves_structure(world):
    """Interference from 8 to 20 h is not described by that from 6 to 18 h, and gets no second name."""
    hours = {"spectral_index": -2.0, "utc_h": [6, 18]}
    adopted = AdoptedCause("rfi_broadband", "CS002", "station", 0.05, 0.02, hours)
    fault = RfiBroadband(size=0.05, index=-2.0, hours=(8.0, 20.0))
    report = world.look(fault).investigate(model=Model((adopted,)))
    assert report.structure is not None
    assert "rfi_broadband" not in [one.hypothesis.cause.identifier for one in report.findings]


@pytest.mark.parametrize(
    ("scope", "in_means", "in_paths"), [("station", True, False), ("antenna", False, True), ("group", True, True)]
)
def test_a_finding_on_a_group_is_seen_in_the_means_and_in_paths(world, scope, in_means, in_paths):
    """A gradient over the field was seen along LST in single paths, and compression of one board named beside it."""
    conditions = world.look().data.conditions
    cause = next(cause for cause in CAUSES if cause.identifier == "compression")
    found = Hypothesis(cause, Template(), Target(scope, "some", np.ones(1, dtype=bool)), 0.2)
    for target, is_seen in (("station", in_means), ("antenna 3 X", in_paths)):
        for axis, lives in (("lst", is_seen), ("rain", False)):
            left = ResidualStructure(axis_named(axis), target, 1e-6, 117.0, 40, 13.0, np.ones(1), None)
            assert _lives_there(found, left, conditions) == lives
            # what paths show beside the means, or the means beside paths
            beside = replace(left, axis=axis_named("rain"), elsewhere=axis_named(axis).along)
            is_seen_beside = in_paths if target == "station" else in_means
            assert _lives_there(found, beside, conditions) == (is_seen_beside and axis == "lst")


def test_antennas_are_compared_beside_the_findings_that_stand(world):
    """A reflection was named in an antenna whose slope a withdrawn exchange of dipoles had bent, beside a gradient."""
    look = world.look()
    swap = look.fit_as_is("dipole_swap", look.template("dipole_swap"), "antenna 1")
    step = look.fit_as_is("gain_temperature", look.template("gain_temperature"))
    both = refit(swap.model, step.effect)
    of_swap, of_step = (SimpleNamespace(hypothesis=one.effect) for one in (swap, step))
    grown = Grown(both, [step.model, swap.model], [of_swap, of_step])
    assert _standing(look.model, grown, grown.findings) is both
    assert _standing(look.model, grown, []) is look.model
    left = _standing(look.model, grown, [of_step])
    assert [one.cause.identifier for one in left.hypotheses] == ["gain_temperature"]
    paths = look.data.antenna == 1
    bent = np.log(both.baseline.solution.x / left.baseline.solution.x)[paths]
    assert np.ptp(bent) > 1e-3


@dataclass(frozen=True)
class Put:
    """What `put_into_words` reads of a report."""

    findings: list
    structure: str = "some"
    similar: tuple = ()
    said: tuple = ()
    description: Description | None = None
    rest: object = None
    first: None = None
    station: None = None
    policy: None = None
    significant: None = None


def test_structure_is_described_again_without_a_name_that_its_sentence_takes_back(monkeypatch):
    """A notch since a date was noise of the converter in a course of 4 harmonics: the rest of a line's false name."""
    stands, goes = (SimpleNamespace(hypothesis=name) for name in ("stands", "goes"))
    station = Target("station", "station", np.ones(1, dtype=bool))
    said = SimpleNamespace(hypothesis=Hypothesis(None, Template(), station, 1.0))
    monkeypatch.setattr(search, "_with", lambda _, hypotheses: hypotheses)
    monkeypatch.setattr(search, "list_targets", lambda _: [station])
    monkeypatch.setattr(search, "describe_structure", lambda left, *_: Description([said], remains=left))
    monkeypatch.setattr(search, "_adds_beside", lambda finding, *_: finding is stands)
    monkeypatch.setattr(search, "_stand_against", lambda _, __, report: report.findings)
    report = search.put_into_words(Put([goes, stands]))
    assert (report.findings, report.similar) == ([stands], [goes])
    assert report.description.remains == ["stands"], "the model without the other"


def test_what_two_antennas_show_is_said_once_if_both_sentences_are_of_one(monkeypatch):
    """A wave in antenna 3 was seen in antenna 0 as well, and said of antenna 3 twice."""
    one, other = (Target("antenna", f"antenna {k}", np.arange(2) == k) for k in range(2))
    said = {"first": one, "second": one, "third": other}

    def describe(_, structure, *__):
        return Description([SimpleNamespace(hypothesis=Hypothesis(None, Template(), said[structure], 1.0))])

    monkeypatch.setattr(search, "_with", lambda _, hypotheses: hypotheses)
    monkeypatch.setattr(search, "list_targets", lambda _: [one, other])
    monkeypatch.setattr(search, "describe_structure", describe)
    assert search.put_into_words(Put([], "first", rest=Put([], "second"))).rest is None
    assert search.put_into_words(Put([], "first", rest=Put([], "third"))).rest.description.sentences


@pytest.mark.long
def test_a_name_goes_that_describes_a_part_of_what_one_sentence_describes(chain, sky, simulation):
    """What follows temperature since a date was a step in autumn, and a square of temperature beside it."""
    courses = (("warm", (10.0, 10.0)), ("spell", (0.6, 145.0)))
    fault = Composed(size=0.05, place="gain", law=("level", ()), courses=courses)
    spectra = simulate_campaign(SETTINGS, chain, sky, np.random.default_rng(SEED), [fault]).spectra
    before = search_station(gather_stations(spectra, simulation)[0])
    (step,) = before.findings
    assert step.hypothesis.cause.identifier == "gain_step"
    report = search.put_into_words(before)
    assert (report.findings, report.similar) == ([], [step])
    _, law, course = parts_of(report.description.sentences[0].hypothesis.template)
    assert law == ("flat",)
    assert (course[0], course[1][:3], course[2][0]) == ("product", ("column", "temperature_c", 1), "step")


@pytest.mark.long
def test_two_steps_of_an_antenna_are_no_spell(chain, sky, simulation):
    """One sentence, a Gaussian since a date, gains more than either step alone."""
    steps = {"2014-04-11": 0.08, "2014-09-08": -0.05}
    faults = [GainStep(size=size, where=Where(antennas=(2,)), date=date) for date, size in steps.items()]
    spectra = simulate_campaign(SETTINGS, chain, sky, np.random.default_rng(SEED), faults).spectra
    report = search_station(gather_stations(spectra, simulation)[0])
    found = sorted((one.hypothesis for one in report.findings), key=lambda one: one.template.parameters["date_unix"])
    assert [(one.cause.identifier, one.target.label) for one in found] == [("gain_step", "antenna 2")] * 2
    for one, size in zip(found, (0.08, -0.05 / 1.08), strict=True):
        assert one.size == pytest.approx(size, abs=3 * one.uncertainty)
    assert report.structure is None
    rivals = [rival for one in report.findings for rival in one.rivals]
    assert rivals
    assert min(rival.delta_chi2 for rival in rivals) > -2.0 * report.policy.likelier, "a spell stood for one step alone"


@pytest.mark.long
def test_a_name_in_an_antenna_stays_beside_a_sentence_of_the_station(chain, sky, simulation):
    """Of the station the means alone tell where the sky is free: the step of an antenna gained nothing in them."""
    faults = [MainsHum(size=0.03), GainStep(size=0.025, where=Where(antennas=(2,)), date="2014-08-07")]
    spectra = simulate_campaign(SETTINGS, chain, sky, np.random.default_rng(SEED), faults).spectra
    (station,) = gather_stations(spectra, simulation)
    modes = model_modes(station, compute_model_differences(simulation.instrument))
    report = search.put_into_words(search_station(station, modes=modes))
    (found,) = report.findings
    assert (found.hypothesis.cause.identifier, found.hypothesis.target.label) == ("gain_step", "antenna 2")
    assert report.description.sentences[0].hypothesis.target.label == "station"


def finding_of(look, target):
    found = look.fit_as_is("gain_temperature", look.template("gain_temperature"), target)
    return SimpleNamespace(hypothesis=found.effect, score=SimpleNamespace(trials=20.0, causes=26))


def test_a_size_is_right_beside_an_antenna_in_which_structure_is_left(chain, sky, simulation):
    """What that antenna does was in the mean to which all antennas are held."""
    settings, planted = replace(SETTINGS, antennas=5, events_per_year=120), [(0, -0.1, "2014-07-20")]
    planted += [(3, 0.4, "2014-04-01"), (3, 0.35, "2014-09-01")]  # one more than is looked for
    faults = [GainStep(size=size, where=Where(antennas=(a,)), date=date) for a, size, date in planted]
    spectra = simulate_campaign(settings, chain, sky, np.random.default_rng(SEED), faults).spectra
    gain_step = [cause for cause in CAUSES if cause.identifier == "gain_step"]
    policy, (station,) = Policy(most_findings=1), gather_stations(spectra, simulation)
    report = search_station(station, policy=policy, catalogue=gain_step)
    assert report.structure.target.startswith("antenna 3")
    (found,) = report.findings
    assert found.hypothesis.target.label == "antenna 0"
    assert found.size[0] == pytest.approx(-0.1, abs=3 * found.size[1])
    assert report.last.hypotheses == [found.hypothesis]
    assert report.last.station.apart == {3}


def test_what_other_antennas_show_is_of_all_paths_of_the_station_with_its_sentences():
    """A step with a sentence nearly as likely, found without one antenna, could not be fitted with all."""
    few, every = (Target("antenna", "antenna 1", np.arange(paths) == 1) for paths in (2, 3))
    one = Hypothesis(CAUSES[0], Template(), few, 1.0)
    found = Finding(one, None, [], 2.0, 1.0, 1, 1.0, np.zeros(1), sentences=[one])
    ((joined,), _) = search._join([], [], SimpleNamespace(findings=[found]), SimpleNamespace(targets=[every]))
    assert (joined.hypothesis.target, joined.sentences[0].target) == (every, every)


@pytest.mark.parametrize(("findings", "ends"), [([1] * 5, True), ([1, 1, 2, 2, 3, 3, 4], False), ([1] * 4 + [9], True)])
def test_a_search_ends_with_five_findings_on_one_path(look, findings, ends):
    """Six steps in four antennas: the sixth was unsaid, and in the mean it made all sizes 5 to 12 % too small."""

    def told(_):
        raise InterruptedError

    antennas = look.data.antenna
    on = [Target("antenna", "", antennas == k if k < 9 else antennas >= 0) for k in findings]
    model = SimpleNamespace(hypotheses=[Hypothesis(None, Template(), target, 1.0) for target in on])
    search = StationSearch(look.data, [], Policy(), 1, 0, told)
    if ends:
        assert search.propose(model) == []
    else:
        with pytest.raises(InterruptedError):
            search.propose(model)


@pytest.mark.parametrize(("size", "stands"), [(0.006, False), (0.02, True)])
def test_a_name_beside_structure_in_single_events_needs_what_a_name_beside_an_axis_needs(world, size, stands):
    """Storms in summer were `cable_temperature` of 4.7 standard deviations beside structure in single events."""
    look = world.look(GainTemperature(size=size))
    finding = finding_of(look, "station")
    events = np.zeros_like(look.model.linear.residuals.mean)[None]
    events[..., ::7, :10] = 1.0
    left = ResidualStructure(None, "station", 1e-9, 60.0, 351, None, np.ones(1), events)
    assert abs(finding.hypothesis.size / finding.hypothesis.sigma) > 4
    assert _seen_beside(look.model.linear, [finding], left, Policy()) == [stands]
    in_paths = replace(left, target="antenna 2 X", vectors=None)
    assert _seen_beside(look.model.linear, [finding], in_paths, Policy()) == [True]


@pytest.mark.parametrize(("size", "stands"), [(0.008, False), (0.03, True)])
def test_a_name_on_an_antenna_beside_structure_in_paths_needs_as_much(world, size, stands):
    """A gain step of 5.7 standard deviations was named in one path beside a gradient over the field."""
    look = world.look(GainTemperature(size=size, where=Where(antennas=(1,))))
    finding = finding_of(look, "antenna 1")
    left = ResidualStructure(axis_named("lst"), "antenna 2 X", 1e-9, 60.0, 16, 20.0, np.ones(1), None)
    assert _seen_beside(look.model.linear, [finding], left, Policy()) == [stands]


class Letters:
    """Models are words: every letter but those refused may be added, in the order of the alphabet given."""

    def __init__(self, alphabet, refused=""):
        self.alphabet, self.refused, self.tested = alphabet, refused, []

    def propose(self, before):
        return [before + letter for letter in self.alphabet if letter not in before]

    def model_of(self, candidate):
        return candidate

    def held_out_gain(self, before, candidate):
        self.tested.append((before, candidate))
        return 0.0 if candidate[-1] in self.refused else 1.5


def test_a_model_grows_by_the_best_candidate_until_nothing_is_proposed():
    steps = grow("", Letters("ab"), 5)
    assert [step.candidate for step in steps] == ["a", "ab"]
    assert [step.held_out_gain for step in steps] == [1.5, 1.5]


def test_a_candidate_that_held_out_data_refuse_gives_way_to_the_next_one():
    search = Letters("abc", refused="a")
    assert [step.candidate for step in grow("", search, 5)] == ["b", "bc"]
    # Those behind the one accepted are not tested, and what is refused is asked again of the larger model.
    assert search.tested == [("", "a"), ("", "b"), ("b", "ba"), ("b", "bc"), ("bc", "bca")]


def test_a_model_takes_no_more_causes_than_are_allowed():
    assert [step.candidate for step in grow("", Letters("abcd"), 2)] == ["a", "ab"]


@pytest.mark.long
@pytest.mark.parametrize("antenna", [0, 1])
def test_a_finding_that_adds_nothing_beside_a_later_one_is_taken_out(world, antenna):
    """Arms that stand 57 degrees off were an exchange of dipoles first, and an azimuth beside it."""
    report = world.look(DipoleAzimuth(size=57.0, where=Where(antennas=(antenna,)))).investigate()
    assert [one.hypothesis.cause.identifier for one in report.findings] == ["dipole_azimuth"]
    found = report.findings[0]
    assert [one.cause.identifier for one in report.last.hypotheses] == ["dipole_azimuth"]
    assert found.hypothesis.size == pytest.approx(57.0, abs=3 * found.hypothesis.uncertainty)
    assert found.held_out_gain > 0
    assert found.chi2_before > found.chi2_after


@pytest.mark.parametrize(
    ("gains", "fitted_beside", "number"),
    [([], 0, None), ([3.0, 1.0], 1, None), ([-1.0, 1.0], 1, 0), ([3.0, -2.0, -1.0], 1, 1), ([-1.0, 1.0], 0, None)],
)
def test_the_finding_that_adds_least_goes_first_where_the_others_could_be_fitted(gains, fitted_beside, number):
    """A model that lacks a later finding as well does not tell what an earlier one adds."""
    findings = [SimpleNamespace(held_out_gain=gain) for gain in gains]
    chains = []
    for k in range(len(gains)):
        before = [SimpleNamespace(hypotheses=[None] * n) for n in range(k + 1)]
        after = [SimpleNamespace(hypotheses=[None] * (k + fitted_beside * (n + 1))) for n in range(len(gains) - k - 1)]
        chains.append([*before, *after])
    assert _idle(findings, chains) == number
