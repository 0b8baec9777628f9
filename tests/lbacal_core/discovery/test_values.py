"""Numbers and small decisions of a search, each asked by itself: what a whole search would show in a minute."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from lbacal_core.causes.axes import AXES
from lbacal_core.causes.cause import Template
from lbacal_core.discovery import findings, scan
from lbacal_core.discovery.antennas import Comparison, smooth_departures
from lbacal_core.discovery.findings import Candidate, Finding, StationSearch
from lbacal_core.discovery.hypothesis import Hypothesis, Rival, Target
from lbacal_core.discovery.noise import split_residuals
from lbacal_core.discovery.policy import Policy
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.report import _noise
from lbacal_core.discovery.residual_structure import _in_paths, _see_in_paths
from lbacal_core.discovery.station import gather_stations
from lbacal_core.sky.sources import response_towards

STATION = Target("station", "station", np.ones(2, dtype=bool))
EMPTY = np.empty(0)
NAMED = {axis.name: axis for axis in AXES}


def test_the_error_of_a_size_holds_the_scatter_among_templates():
    hypothesis = Hypothesis(None, Template(), STATION, 2.0, sigma=0.3, template_sigma=0.2)
    assert hypothesis.uncertainty == pytest.approx(0.5)  # 0.3 and 0.2 of 2
    assert Finding(hypothesis, None, [], 1.0, 1.0, 1, 1.0, EMPTY).size == (2.0, pytest.approx(0.5))


def test_false_alarms_are_shared_by_stations_and_are_one_in_300():
    policy = Policy()
    search = StationSearch(SimpleNamespace(name="CS002"), [], policy, 4, 0, print)
    assert search.alpha == pytest.approx(policy.catalogue_alpha / 4)
    assert policy.catalogue_alpha + policy.antenna_alpha + policy.structure_alpha < 1 / 300
    assert policy.indistinguishable == 3.0**2


def test_the_axes_of_dates_are_half_waves_and_the_periods_of_week_sun_and_moon(station):
    conditions = station.conditions
    periods = {float(name.split()[2]) for name in NAMED if name.startswith("date, period")}
    assert periods == {7.0, 27.3, 29.53}
    ramp = np.linspace(-1, 1, conditions.time_unix.size)
    slowest = NAMED["date"].basis(conditions)[0]
    order = np.argsort(conditions.time_unix)
    # the slowest wave goes half a period over the data, so that it follows a drift
    assert abs(np.corrcoef(slowest[order], ramp)[0, 1]) > 0.9


class FineCause:
    """A cause with three templates of which a scan tried one."""

    spectral_parameters = ()

    def finer_templates(self, _conditions, _template):
        return [Template({"at": k}) for k in range(3)]

    def known_events(self, _conditions, _template):
        return None


@pytest.mark.parametrize(
    ("z", "size", "best", "scatter"),
    [
        ([10.0, 9.9, 1.0], [-1.0, 0.9, 0.1], 1, 0.0),  # power missing at the other hours fits a little better
        ([10.0, 9.0, 1.0], [-1.0, 0.9, 0.1], 0, 0.0),  # ... or much
        ([10.0, np.sqrt(99.0), 1.0], [1.0, 1.2, 9.0], 0, np.sqrt(np.exp(-0.5) * 0.04 / (1 + np.exp(-0.5)))),
    ],
)
def test_the_best_template_has_a_positive_size_and_its_scatter_is_weighed(z, size, best, scatter, monkeypatch):
    family = SimpleNamespace(profiles=np.ones((3, 4)), templates=[Template({"at": k}) for k in range(3)])
    scores = [([family], np.reshape(z, (1, 1, 3)), np.reshape(size, (1, 1, 3)))]
    monkeypatch.setattr(scan, "group_templates", lambda *_: None)
    monkeypatch.setattr(scan, "score_families", lambda *_: scores)
    model = SimpleNamespace(station=SimpleNamespace(conditions=None), on_events=lambda _: None)
    score = SimpleNamespace(cause=FineCause(), template=Template({"at": 0}), target=STATION)
    found = scan.refine(model, score, Policy())
    assert found.template.parameters == {"at": best}
    assert found.size == size[best]
    assert found.template_sigma == pytest.approx(scatter, abs=1e-8)


def test_a_finding_is_told_by_its_own_hypothesis(monkeypatch):
    asked = []
    for name, value in (("find_indistinguishable", []), ("gain_of", 5.0), ("change_of_c", EMPTY)):
        monkeypatch.setattr(findings, name, lambda *a, value=value, name=name: asked.append((name, a)) or value)
    monkeypatch.setattr(findings, "chi_squared_of", lambda *_: (3.0, 2.0, 1))
    monkeypatch.setattr(findings, "average_size", lambda _last, number: number)
    hypotheses = [Hypothesis(None, Template({"k": k}), STATION, float(k)) for k in range(3)]
    without, last = SimpleNamespace(linear="linear"), SimpleNamespace(hypotheses=hypotheses)
    search = SimpleNamespace(policy=Policy(), catalogue=())
    rivals = (Rival("gain_drift", "station", 4.0),)
    sentences = (hypotheses[0], hypotheses[2])
    named = SimpleNamespace(score=None, rivals=rivals, sentences=sentences)
    beside = SimpleNamespace(hypotheses=[replace(sentences[0], size=-0.08)])
    monkeypatch.setattr(findings, "refit", lambda _, one: beside if one is sentences[0] else None)
    found = findings._finding(without, last, 1, named, search)
    assert found.rivals == rivals
    assert found.sentences == [beside.hypotheses[0], sentences[1]], "fitted beside what else stands"
    assert (found.chi2_before, found.chi2_after, found.dof) == (3.0, 2.0, 1)
    assert (found.hypothesis, found.over_noise, found.held_out_gain) == (hypotheses[1], 1, 5.0)
    assert all(hypotheses[1] in a or STATION in a for _, a in asked)


def test_a_finding_that_adds_nothing_is_taken_out_unless_a_cause_came_again(monkeypatch):
    step = SimpleNamespace(candidate=SimpleNamespace(model="grown", score="its score"))
    monkeypatch.setattr(findings, "grow", lambda *_: [step, step])
    monkeypatch.setattr(findings, "_models_without", lambda models, number, _adopted: [*models[:number], "without"])
    monkeypatch.setattr(findings, "_finding", lambda *a: a[2])
    monkeypatch.setattr(findings, "_idle", lambda found, _without: 0 if len(found) == 2 else None)
    search = SimpleNamespace(policy=Policy(), adopted=3, again=None)
    assert findings.grow_findings("first", search).findings == [3]
    search.again = "a cause once more"
    assert findings.grow_findings("first", search).findings == [3, 4]


def test_departures_that_most_antennas_show_are_told_apart_from_noise():
    """Of two cosines with four errors each, three are smooth enough; of noise none is."""
    rng, frequency = np.random.default_rng(4), np.arange(30.0, 81.0)
    place = (frequency - 30.0) / 50.0
    shown = rng.standard_normal((12, 2)) * 4.0 @ np.cos(np.pi * np.outer([1, 2], place))

    def compared(size):
        noise = rng.standard_normal((12, 2, 51))
        root = np.eye(51) * (51 / 2) ** 0.5  # one unit of a cosine is one error
        return [
            Comparison(root, size * shown[k] + noise[k] * (51 / 2) ** 0.5, np.empty((0, 51)), np.empty(0))
            for k in range(12)
        ]

    cable = np.array(["50"] * 12)
    assert len(smooth_departures(compared(1.0), cable, frequency)) == 3
    assert len(smooth_departures(compared(0.0), cable, frequency)) == 0


def test_the_noise_of_a_report_is_the_root_of_the_mean_variance_of_a_channel():
    channels = 4
    levels = SimpleNamespace(
        vectors=np.eye(channels)[:2], path_channel=0.04, mean_path_shared="path", common_sum="sum",
        of_all=lambda which: {"path": np.diag([0.08, 0.08]), "sum": np.diag([0.4, 0.4])}[which] * np.ones(1),
        common_channel=np.zeros(1), path_scale=np.array([1.0, 3.0]),
    )  # fmt: skip
    linear = SimpleNamespace(residuals=SimpleNamespace(levels=levels, polarisations=["X", "Y"]))
    station = SimpleNamespace(antenna=np.array([1, 2]), dipole=np.array(["X", "Y"]))
    told = _noise(SimpleNamespace(station=station, last=SimpleNamespace(linear=linear), taken={}))
    assert told["path_event_gain"] == pytest.approx((0.16 / 4) ** 0.5)
    assert told["station_event_gain"] == pytest.approx((0.8 / 2 / 4) ** 0.5)
    assert told["noisy_paths"] == [{"antenna": 2, "dipole": "Y", "scale": 3.0}]


def test_the_sun_stands_where_the_pattern_is_asked(clean, simulation):
    (station,) = gather_stations(clean.select(clean.antenna < clean.antenna.max()), simulation)
    conditions = station.conditions
    own = simulation.at_station("CS002").instrument
    for k, letter in enumerate(conditions.dipoles):
        towards = response_towards(own, letter, np.pi / 2 - conditions.sun_altitude, conditions.sun_azimuth)
        np.testing.assert_allclose(conditions.sun_response[k], towards, rtol=1e-9)


def test_the_strongest_path_of_a_clean_station_is_nothing_rare(model):
    axis = NAMED["utc"]
    basis = axis.basis(model.station.conditions)
    found = _in_paths(model, _see_in_paths(model), axis, basis)
    assert found.p_value > 0.005, "nothing is hidden; one path of 16 is at 1 % by chance in one of six"
    assert found.target.startswith("antenna ")


def along_utc(station, model, residual):
    """Structure of the paths along UTC, of residuals of a station."""
    linear = LinearModel(station, split_residuals(station, residual, model.residuals.seeds), model.terms, None)
    return _in_paths(linear, _see_in_paths(linear), NAMED["utc"], NAMED["utc"].basis(station.conditions))


def test_the_path_that_shows_most_is_judged_as_one_of_16_in_one_of_two_tests(station, model, noise):
    wave = np.cos(2 * np.pi * station.conditions.utc_hours / 24)
    tilt = 0.012 * wave[:, None] * np.linspace(-1, 1, noise.shape[2])
    one = along_utc(station, model, noise + tilt * (np.arange(16) == 3)[:, None, None])
    assert one.target == f"antenna {station.antenna[3]} {station.dipole[3]}"
    assert one.p_value == pytest.approx(2 * 16 * chi2.sf(one.gain, one.dof), rel=0.05, abs=0.0)
    together = along_utc(station, model, noise + 0.25 * tilt * np.linspace(-1, 1, 16)[:, None, None])
    assert len(together.places) == 16, "no path shows it alone"


def test_a_sentence_that_was_fitted_and_lost_has_the_odds_of_its_fit(monkeypatch):
    """By its score it was 10^11 times as likely as the cause that was named beside it."""

    def candidate(cause, gain):
        hypothesis = Hypothesis(SimpleNamespace(identifier=cause), Template(), STATION, 1.0)
        model = SimpleNamespace(hypotheses=[hypothesis], linear=None)
        return Candidate(SimpleNamespace(cause=hypothesis.cause, target=STATION), model, gain)

    likely = [
        SimpleNamespace(gain=gain, target=STATION, hypothesis=Hypothesis(None, Template({"k": gain}), STATION, 1.0))
        for gain in (580.0, 573.0, 560.0)
    ]
    search = StationSearch(SimpleNamespace(name="CS002"), [STATION], Policy(), 1, 0, lambda _: None)
    search.hidden = []
    monkeypatch.setattr(findings, "scan", lambda *_: [])
    monkeypatch.setattr(search, "_score_sentences", lambda *_: likely)
    monkeypatch.setattr(search, "_name", lambda *_: [candidate("lst_offset", 500.0)])
    monkeypatch.setattr(search, "_say", lambda *_: (candidate("sentence", 502.0), likely))
    (named,) = search.propose(SimpleNamespace(linear=None, hypotheses=[]))
    assert named.score.cause.identifier == "lst_offset"
    assert [(one.cause, one.delta_chi2) for one in named.rivals] == [("sentence", -2.0)]
    assert [one.template.parameters.get("k") for one in named.sentences] == [None, 573.0]  # 560 is 18 behind
    # A resonance stood with odds of 3e+37 to 1 against it, of a sentence that no size fits.
    monkeypatch.setattr(search, "_say", lambda *_: (None, []))
    (named,) = search.propose(SimpleNamespace(linear=None, hypotheses=[]))
    assert named.rivals == []
    # A cause that a sentence beats by far does not take the place of one that unseen events refuse.
    weak = candidate("gain_drift", 480.0)
    monkeypatch.setattr(search, "_name", lambda *_: [candidate("lst_offset", 600.0), weak])
    monkeypatch.setattr(search, "_say", lambda *_: (None, likely))
    assert [one.score.cause.identifier for one in search.propose(SimpleNamespace(linear=None, hypotheses=[]))] == [
        "lst_offset"
    ]
    # Nor does one that the refused cause beats by far: bursts of noise were a resonance that moves.
    monkeypatch.setattr(search, "_say", lambda *_: (None, likely[3:]))
    assert len(search.propose(SimpleNamespace(linear=None, hypotheses=[]))) == 1
    monkeypatch.setattr(search, "_name", lambda *_: [candidate("lst_offset", 600.0), candidate("gain_drift", 596.0)])
    assert len(search.propose(SimpleNamespace(linear=None, hypotheses=[]))) == 2
