"""The model as a value: its text is canonical, its id is the hash of the text, and it is made from a report."""

import json
from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.calibration.chain_form import FORM_OF_CHAIN
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.causes.model import PLAIN, AdoptedCause, Model
from lbacal_core.curves.curves import CONVERGED, NOT_CONVERGED, TOO_FEW_EVENTS, parse_curve
from lbacal_core.discovery.calibrate import fit_causes
from lbacal_core.errors import BadInputError
from lbacal_core.simulation.simulation import Simulation
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.hardware import GainTemperature
from lbacal_twin.faults.sky import LstOffset
from lbacal_twin.settings import TwinSettings

SWAP = AdoptedCause("dipole_swap", "CS002", "station", 0.0123456789, 0.00123456789, since_unix=1_420_070_400)
STEP = AdoptedCause(
    "gain_step", "CS002", "antenna 17 X", 0.04, 0.002, {"date_unix": 1_425_268_801.7}, until_unix=1_430_000_000
)
FINDING = {
    "cause": "rfi_line",
    "size": {"value": 0.0421234567, "sigma": 0.0031, "unit": "fraction"},
    "parameters": {"frequency_mhz": 45.25, "width_mhz": 2.0, "utc_h": [22, 4]},
    "where": {"station": "CS003", "dates": ["2015-01-01T03:04:05Z", "2015-12-31T00:00:00Z"]},
    "evidence": {"target": "antenna 4"},
}
REPORT = {"verdict": "explained", "findings": [FINDING]}


def test_a_text_is_read_back_as_the_same_model():
    model = Model((SWAP, STEP, replace(SWAP, station="CS003", is_free=False)))
    again = Model.from_text(model.to_text())
    assert again == model
    assert again.id == model.id
    assert again.to_text() == model.to_text()


def test_numbers_have_six_significant_digits_and_instants_whole_seconds():
    text = json.loads(Model((SWAP, STEP)).to_text())
    of = {one["cause"]: one for one in text["causes"]}
    assert of["dipole_swap"]["size"] == 0.0123457
    assert of["dipole_swap"]["sigma"] == 0.00123457
    assert of["gain_step"]["parameters"] == {"date": "2015-03-02T04:00:01Z"}
    assert of["dipole_swap"]["since"] == "2015-01-01T00:00:00Z"


def test_neither_the_last_bits_of_a_size_nor_the_order_of_adoption_change_the_id():
    moved = replace(SWAP, size=SWAP.size * (1 + 1e-9), sigma=SWAP.sigma * (1 - 1e-9))
    assert Model((moved,)).id == Model((SWAP,)).id
    assert Model((STEP, SWAP)).id == Model((SWAP, STEP)).id
    assert Model((STEP, SWAP)).causes[0].cause == "dipole_swap", "causes act from the sky to the digitiser"


@pytest.mark.parametrize(
    "changed",
    [{"size": 0.0124}, {"sigma": 0.0013}, {"is_free": False}, {"since_unix": 1}, {"until_unix": 1_500_000_000},
     {"station": "CS003"}, {"target": "antenna 3"}],
)  # fmt: skip
def test_whatever_differs_in_a_cause_changes_the_id(changed):
    assert Model((replace(SWAP, **changed),)).id != Model((SWAP,)).id


def test_a_finding_is_adopted_from_the_first_event_of_its_report_on():
    (adopted,) = Model.from_report(REPORT, 0).causes
    assert adopted.cause == "rfi_line"
    assert (adopted.station, adopted.target) == ("CS003", "antenna 4")
    assert adopted.parameters == {"frequency_mhz": 45.25, "utc_h": [22, 4], "width_mhz": 2}
    assert adopted.is_free
    assert adopted.since_unix == 1_420_081_445
    assert adopted.until_unix is None


def test_a_report_made_with_a_model_extends_it():
    """`--with` of a second report means everything that was adopted before, too."""
    second = {**REPORT, "model": Model((SWAP,)).to_text()}
    assert [one.cause for one in Model.from_report(second).causes] == ["dipole_swap", "rfi_line"]


def test_a_step_keeps_its_instant_and_loses_the_words_for_it():
    finding = {**FINDING, "cause": "gain_step", "parameters": {"date_unix": 1.5e9 + 0.7, "date": "2017-07-14T02:40Z"}}
    (adopted,) = Model.from_report({"findings": [finding]}).causes
    assert adopted.parameters == {"date_unix": 1_500_000_000}


@pytest.mark.parametrize(
    ("cause", "parameters", "found"),
    [
        ("gain_step", {"date_unix": 1.5e9}, "gain_step on 2017-07-14 in antenna 4 of CS003"),
        ("adc_noise_step", {"date_unix": 1.5e9}, "adc_noise_step on 2017-07-14"),
        ("filter_shift", {"date_unix": 1.5e9}, "filter_shift on 2017-07-14"),
        ("gain_drift", {}, "gain_drift in antenna 4"),
        ("resonance_shift", {"follows": "season", "phase_deg": 0.0, "model": "curve"}, "resonance_shift in antenna 4"),
    ],
)
def test_one_c_stood_for_the_time_before_and_after_a_step(cause, parameters, found):
    """C of a fit with a step of 15 % was that before it, 7.3 % off for the rest of the window."""
    model = Model.from_report({"findings": [{**FINDING, "cause": cause, "parameters": parameters}]})
    with pytest.raises(BadInputError, match=f"put it in force by `lbacal changes`.*found {found}"):
        model.require_one_c("finding 0")


@pytest.mark.parametrize(
    ("cause", "parameters"), [("filter_shift", {"follows": "temperature"}), ("rfi_line", FINDING["parameters"])]
)
def test_what_recurs_leaves_one_c(cause, parameters):
    Model.from_report({"findings": [{**FINDING, "cause": cause, "parameters": parameters}]}).require_one_c("finding 0")


@pytest.mark.parametrize(
    ("report", "message"),
    [
        ({"verdict": "consistent", "findings": []}, "a finding to adopt, found none: its verdict is 'consistent'$"),
        ({"verdict": "unexplained", "findings": [], "unexplained": {"x": 1}}, "give unexplained in place of a number"),
        ({"findings": [{**FINDING, "cause": "cable_length"}]}, "is in A\\(nu\\), and C is right"),
        ({"findings": [{**FINDING, "where": {"axis": "lst"}}]}, "one of an LST curve"),
        ({"findings": [{**FINDING, "size": {"value": 1.0, "sigma": None}}]}, "a size with an error"),
        ({"findings": [{"cause": "lst_offset"}]}, "the fields of a finding"),
    ],
)
def test_what_cannot_be_adopted_says_why(report, message):
    with pytest.raises(BadInputError, match=message):
        Model.from_report(report)
    with pytest.raises(BadInputError, match="a number from 0 to 0"):
        Model.from_report(REPORT, 3)


WORDS = {"place": "receiver", "law": ["flat"], "course": ["working days"]}
SAID = {"cause": "sentence", "target": "antenna 4", "size": {"value": 0.08, "sigma": 0.01}, "parameters": WORDS}
LEFT = {
    "gain": {"chi2": 400.0, "terms": 100},
    "term": {"axis": "utc", "X": [[0.01, 0.02]]},
    "where": {"station": "CS003", "axis": "utc", "target": "station", "dates": ["2015-01-01T03:04:05Z"]},
    "sentences": [],
}


def test_structure_is_adopted_in_words_and_without_as_its_term_less_the_noise_in_it():
    def adopt(**changes):
        (adopted,) = Model.from_report({"findings": [], "unexplained": {**LEFT, **changes}}, "unexplained").causes
        assert (adopted.station, adopted.since_unix) == ("CS003", 1_420_081_445)
        return adopted

    said, term = adopt(sentences=[SAID]), adopt()
    assert (said.cause, said.target, said.size, said.sigma) == ("sentence", "antenna 4", 0.08, 0.01)
    assert said.parameters == WORDS
    assert (term.cause, term.target, term.size, term.sigma) == ("residual_structure", "station", 0.75, 0.05)
    assert term.parameters == LEFT["term"]
    with pytest.raises(BadInputError, match=r"an axis that recurs, .*found structure along utc in station$"):
        adopt(term=None)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"format": "lbacal-model-2", "causes": []}', "null"])
def test_another_text_is_no_model(text):
    with pytest.raises(BadInputError, match="model"):
        Model.from_text(text)


def test_a_cause_is_adopted_once():
    with pytest.raises(BadInputError, match="one size"):
        Model((SWAP, replace(SWAP, size=0.02)))


def test_a_model_is_cut_to_a_window_and_to_stations():
    model = Model((SWAP, STEP, replace(SWAP, station="CS003")))
    assert [one.cause for one in model.during(0, 1_420_070_400).causes] == ["gain_step"]
    assert {one.cause for one in model.during(1_430_000_000, 1_440_000_000).causes} == {"dipole_swap"}
    assert model.of_stations(["CS003"]).causes == (replace(SWAP, station="CS003"),)
    assert model.during(0, 1).of_stations(["CS003"]).is_plain
    assert Model().is_plain
    assert Model((SWAP, STEP)).without(1).id == Model((SWAP,)).id, "a withdrawn cause leaves it as it was"


SETTINGS = TwinSettings(stations=("CS002", "CS003"), antennas=4, events_per_year=300)
LATE = AdoptedCause("lst_offset", "CS002", "station", 0.25, 0.02)
HERE = Where(stations=("CS002",))


@pytest.fixture(scope="module")
def record(chain, sky):
    return lambda *faults: simulate_campaign(SETTINGS, chain, sky, np.random.default_rng(5), faults).spectra


@pytest.fixture(scope="module")
def late(record):
    """CS002 has a clock that is 0.3 h off, CS003 is right."""
    return record(LstOffset(size=0.3, where=HERE))


@pytest.fixture(scope="module")
def fitted(late, simulation):
    return fit_causes(late, simulation.with_causes(Model((LATE,))))


@pytest.fixture(scope="module")
def report(fitted):
    return fitted.fit("station")


def test_a_plain_model_gives_the_bytes_of_the_plain_fit(late, simulation, chain, sky):
    plain = fit_causes(late, simulation.with_causes(PLAIN))
    assert plain.spectra is late
    ours, theirs = plain.fit("antenna"), fit_calibration(late, Simulation(chain, sky), "antenna")
    told = ours.provenance.notes.pop(FORM_OF_CHAIN)
    assert told.startswith("noise enters in front of the antenna's resonance, as published")
    assert json.dumps(ours.as_dict()) == json.dumps(theirs.as_dict())


@pytest.mark.long
def test_c_is_that_of_the_same_data_without_the_fault(report, record, late, simulation):
    healthy = fit_calibration(record(), simulation, "station").curves
    without = fit_calibration(late, simulation, "station").curves
    for curve, right, wrong in zip(report.curves[:2], healthy[:2], without[:2], strict=True):
        assert curve.status == CONVERGED
        # The size is right to 4 %, and with it what the fault did to C.
        assert np.all(np.abs(curve.c - right.c) < 0.3 * right.c_sigma_stat)
        assert np.abs(wrong.c - right.c).max() > 2.0 * right.c_sigma_stat.min()


def test_a_station_without_the_cause_keeps_its_numbers(report, late, chain, sky):
    plain = fit_calibration(late, Simulation(chain, sky), "station").curves
    for ours, theirs in zip(report.curves[2:], plain[2:], strict=True):
        assert ours.station == "CS003"
        np.testing.assert_array_equal(ours.c, theirs.c)
        np.testing.assert_array_equal(ours.c_sigma_stat, theirs.c_sigma_stat)
        assert ours.covariance.common is None


@pytest.mark.long
def test_the_error_of_the_size_is_in_the_covariance_of_c(late, simulation):
    """Moved by its sigma, a fixed size changes ln C by the vector that its error adds."""
    fixed = replace(LATE, size=0.3, sigma=0.1, is_free=False)
    curves = fit_causes(late, simulation.with_causes(Model((fixed,)))).fit("station").curves
    moved = fit_causes(late, simulation.with_causes(Model((replace(fixed, size=0.4),)))).fit("station").curves
    known = replace(fixed, sigma=1e-6)
    alone = fit_causes(late, simulation.with_causes(Model((known,)))).fit("station").curves
    for curve, other, without in zip(curves[:2], moved[:2], alone[:2], strict=True):
        change = np.log(other.c / curve.c)
        assert np.abs(change).max() > 1e-3
        # The other fit has fitted its chain at the moved size once more.
        np.testing.assert_allclose(curve.covariance.common, change[None], rtol=0.06)
        added = (curve.c_sigma_stat / curve.c) ** 2 - (without.c_sigma_stat / without.c) ** 2
        np.testing.assert_allclose(added, curve.covariance.common[0] ** 2, rtol=1e-6, atol=1e-10)
        of_parts = np.sum(curve.covariance.factor**2, axis=0) + curve.covariance.diagonal
        np.testing.assert_allclose(of_parts, (curve.c_sigma_stat / curve.c) ** 2, rtol=1e-9)


def test_one_path_takes_the_size_of_its_station(fitted, late, simulation):
    """A size belongs to its target: fitted to all its paths, and the same for each of them."""
    whole = {curve.name: curve for curve in fitted.fit("antenna").curves}
    rows = (late.station == "CS002") & (late.antenna == 1) & (late.dipole == "Y")
    part = fitted.keep(lambda _: rows)
    assert [size.value for size in part.sizes] == [size.value for size in fitted.sizes]
    (curve,) = part.fit("antenna").curves
    np.testing.assert_allclose(curve.c, whole[curve.name].c, rtol=1e-12)
    assert part.fit("antenna").provenance.inputs["spectra"] == late.select(rows).digest()
    (alone,) = fit_causes(late.select(rows), simulation.with_causes(Model((LATE,)))).sizes
    assert alone.sigma > 1.2 * fitted.sizes[0].sigma


def test_the_provenance_names_the_model_and_the_spectra_as_recorded(report, fitted, late):
    model = Model((LATE,))
    assert report.provenance.inputs["model"] == model.id
    assert report.provenance.inputs["spectra"] == late.digest()
    assert report.provenance.settings["model"] == model.to_text()
    assert "lst_offset in station of CS002 0.3" in report.provenance.notes["model"]
    (cause,) = report.as_dict()["causes"]
    assert cause["adopted"] == {"value": 0.25, "sigma": 0.02}
    assert cause["size"]["value"] == fitted.sizes[0].value
    assert cause["size"]["unit"] == "h"


def test_a_curve_with_the_error_of_a_size_is_read_back(report):
    content = json.loads(json.dumps(report.curves[0].as_dict()))
    assert parse_curve(content).as_dict() == content
    assert len(content["covariance"]["statistical"]["common"]) == 1


def test_spectra_without_the_covariate_of_their_cause_are_left_out(record, simulation):
    spectra = record(GainTemperature(size=0.05, where=HERE))
    values = spectra.environment["temperature_c"].copy()
    lost = np.isin(spectra.event_id, np.unique(spectra.event_id)[::4])
    values[lost] = np.nan
    spectra = replace(spectra, environment={"temperature_c": values})
    one = AdoptedCause("gain_temperature", "CS002", "antenna 2", 0.05, 0.01, {"delay_h": 0})
    fitted = fit_causes(spectra, simulation.with_causes(Model((one,))))
    left_out = lost & (spectra.station == "CS002") & (spectra.antenna == 2)
    assert len(spectra) - len(fitted.spectra) == left_out.sum()
    curves = {curve.name: curve.events for curve in fitted.fit("antenna").curves}
    assert curves["CS002 antenna 2 X"] == 225
    assert curves["CS002 antenna 1 X"] == 300


def test_a_station_with_too_few_events_has_no_size(late, simulation):
    """The first weeks of a year with an inherited model: its curves say why they are none, and nothing is refused."""
    few = late.select(np.isin(late.event_id, np.unique(late.event_id)[:40]))
    fitted = fit_causes(few, simulation.with_causes(Model((LATE,))))
    assert fitted.sizes == []
    assert {curve.status for curve in fitted.fit("antenna").curves} == {TOO_FEW_EVENTS}


def test_a_curve_that_fails_within_the_error_of_a_size_has_not_converged(report):
    curve = report.curves[0].as_not_converged()
    assert curve.status == NOT_CONVERGED
    assert curve.c is None
    assert curve.as_dict()["c"] is None
