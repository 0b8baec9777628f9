"""The model as a value: its text is canonical, its id is the hash of the text, and it is made from a report."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from lbacal_core.causes.model import AdoptedCause, Model
from lbacal_core.errors import BadInputError

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


def test_the_last_bits_of_a_size_do_not_change_the_id():
    moved = replace(SWAP, size=SWAP.size * (1 + 1e-9), sigma=SWAP.sigma * (1 - 1e-9))
    assert Model((moved,)).id == Model((SWAP,)).id


def test_the_order_of_adoption_does_not_change_the_id():
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
    with pytest.raises(BadInputError, match=f"cut the window there instead, by `lbacal cuts` .*found {found}"):
        model.require_one_c("finding 0")


@pytest.mark.parametrize(
    ("cause", "parameters"), [("filter_shift", {"follows": "temperature"}), ("rfi_line", FINDING["parameters"])]
)
def test_what_recurs_leaves_one_c(cause, parameters):
    Model.from_report({"findings": [{**FINDING, "cause": cause, "parameters": parameters}]}).require_one_c("finding 0")


@pytest.mark.parametrize(
    ("report", "message"),
    [
        ({"verdict": "consistent", "findings": []}, "a finding to adopt"),
        ({"findings": [{**FINDING, "cause": "cable_length"}]}, "A\\(nu\\) of every path"),
        ({"findings": [{**FINDING, "where": {"axis": "lst"}}]}, "one of an LST curve"),
        ({"findings": [{**FINDING, "size": {"value": 1.0, "sigma": None}}]}, "a size with an error"),
        ({"findings": [{"cause": "lst_offset"}]}, "the fields of a finding"),
    ],
)
def test_what_cannot_be_adopted_says_why(report, message):
    with pytest.raises(BadInputError, match=message):
        Model.from_report(report)


def test_a_finding_that_is_not_there_is_named():
    with pytest.raises(BadInputError, match="a number from 0 to 0"):
        Model.from_report(REPORT, 3)


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


def test_a_withdrawn_cause_leaves_the_model_as_it_was():
    model = Model((SWAP, STEP))
    assert model.without(1).id == Model((SWAP,)).id
