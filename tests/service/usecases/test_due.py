from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.calibration.singles import MIN_EVENTS
from lbacal_core.causes.model import AdoptedCause, Model
from lbacal_core.curves.validity import Scope
from service.factory import Factory
from service.storage.models import ADOPTED, ModelChange
from service.usecases.due import explain_due
from service.usecases.models import Adoption
from tests.service.conftest import add_spectra, flat_spectra, like

SAME = {"instrument": "a", "sky_power": "b", "model_version": 9}
WINDOW = SAME | {"spectra": [100, 0], "model": None, "changes": [], "decisions": None}
STEP = ["CS002", 2, 1_428_710_400_000_000]


def test_a_reason_names_the_inputs_that_are_others_than_before():
    """One sentence stood for every reason, in 27 of 27 jobs."""
    for now, reason in (
        ({"spectra": [148, 0]}, "+48 usable spectra"),
        ({"spectra": [100, 3]}, "a quality flag set or cleared"),
        ({"changes": [STEP]}, "CS002 antenna 2 changed on 2015-04-11"),
        (
            {"spectra": [99, 4], "decisions": {"cuts": [0, 1]}},
            "-1 usable spectra; a quality flag set or cleared; a decision about a change",
        ),
        ({"instrument": "c", "model_version": 10}, "another instrument; another model version"),
        ({"covariates": 7}, "other covariates are read"),
        ({}, "tried again"),
    ):
        assert explain_due(WINDOW, WINDOW | now) == reason
    assert explain_due(WINDOW | {"changes": [STEP]}, WINDOW) == "1 change counts no more"
    assert explain_due(WINDOW | {"changes": [STEP, [*STEP[:2], 0]]}, WINDOW) == "2 changes count no more"
    assert explain_due(None, WINDOW) == "the first of this window"
    assert explain_due(None, WINDOW | {"model": 1}) == "a cause adopted or withdrawn"
    several = {"changes": [[*STEP[:1], antenna, STEP[2]] for antenna in range(5)]}
    assert explain_due(WINDOW, WINDOW | several).endswith("CS002 antenna 2 changed on 2015-04-11; and 2 more changes")


def test_a_window_of_the_array_names_the_spectra_of_all_stations():
    array = SAME | {"spectra": [["CS002", [100, 0]]]}
    assert explain_due(array, SAME | {"spectra": [["CS002", [100, 0]], ["CS003", [50, 0]]]}) == "+50 usable spectra"


def test_drift_is_followed_again_because_it_was_measured_anew():
    assert explain_due({"drift": "a", "report": None}, {"drift": "b", "report": ["a", 5]}) == "drift measured anew"
    assert explain_due(None, {"drift": "b", "report": None}) == "drift measured anew"


def test_temperatures_that_came_late_made_no_fit_due(factory: Factory, monkeypatch: pytest.MonkeyPatch) -> None:
    """C stayed the fit of the events whose temperature had been known before: work was named by spectra and flags."""
    monkeypatch.setattr("service.usecases.due.find_references", lambda *_: {Scope("CS001", 0, "X"): "a"})
    rows = [(f"{station} {k}", 1.4e9 + k, station, 0, "X") for station in ("CS001", "CS002") for k in range(MIN_EVENTS)]
    spectra = flat_spectra(*rows)
    add_spectra(factory, spectra)
    with like(factory, nightly_investigations=True) as nightly:

        def names() -> dict[tuple[str, ...], str | None]:
            with nightly.database.read() as stores:
                due = nightly.due
                orders = [*due._refits(stores), *due._drift(stores), *due._investigations(stores)]
            return {
                (one.kind, str(one.request["station"]), one.request.get("scope", "")): one.due_name for one in orders
            }

        def send(first: int, last: int) -> set[tuple[str, ...]]:
            """Send the temperatures of some events of CS001, and return what becomes due."""
            before = names()
            warmth = np.where((np.arange(len(spectra)) >= first) & (np.arange(len(spectra)) < last), 10.0, np.nan)
            add_spectra(factory, replace(spectra, environment={"temperature_c": warmth}))
            now = names()
            return {one for one in now if now[one] != before[one]}

        investigation = ("investigation", "CS001", "")
        assert send(0, 5) == {investigation}, "no fit reads them"
        plain, cause = Model(), AdoptedCause("gain_temperature", "CS001", "station", 0.05, 0.01, {"delay_h": 0.0})
        model = Model((cause,))
        change = ModelChange(
            0, "CS001", ADOPTED, model.id, plain.id, model.id, None, None, None, None, None, {}, None, 0, "test", "x"
        )  # fmt: skip
        assert nightly.models.adopt(Adoption(change, model, plain, cause, ()), promote=True)
        fits = {("refit", "None", "array"), ("refit", "CS001", "station"), ("refit", "CS001", "antenna")}
        assert send(5, 9) == {investigation, *fits, ("drift", "CS001", "")}
        assert send(0, 9) == set(), "they are known"
