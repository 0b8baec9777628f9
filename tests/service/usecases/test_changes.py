"""What an investigation proposes as a change."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest

from lbacal.instants import DAY_US
from lbacal_core.curves.validity import Promotion, Scope
from lbacal_core.instrument.instrument import Instrument
from service.errors import ConflictError
from service.factory import Factory
from service.storage.changes import INVESTIGATION, Change, Evidence, KeptChange
from service.storage.database import Stores
from service.storage.models import Investigation
from service.usecases.changes import propose
from service.usecases.fits import Fits, Wanted
from service.wire.bodies import ChangeBody, DecisionBody
from tests.service.conftest import instant, new_version

DATE = instant("2014-06-01")
EVERY = [0, 1, 2], ["X", "Y"]


def finding(cause: str, antennas: list[int], dipoles: list[str], **parameters: float) -> dict[str, Any]:
    where = {"antennas": antennas, "dipoles": dipoles}
    size = {"value": -0.19, "sigma": 0.0162}
    return {"cause": cause, "parameters": parameters, "where": where, "size": size, "significance_sigma": 9.0}


def test_what_follows_the_date_is_proposed_with_its_change_of_c(instrument: Instrument) -> None:
    date = {"date_unix": DATE / 1e6}
    findings = [
        finding("gain_temperature", [0], ["X"], delay_h=0.0),
        finding("gain_step", [1], ["X", "Y"], **date),
        finding("gain_drift", *EVERY),
        finding("adc_noise_step", [2], ["Y"], **date),
    ]
    begin, end = instant("2014-01-01"), instant("2015-01-01")
    made = Investigation("a" * 64, "CS001", begin, end, {}, {"findings": findings}, 7, "x", "x")
    (step, of_step), (ramp, of_ramp), (noise, of_noise) = propose(made, instrument)
    assert (step.kind, step.date, step.paths) == ("step", DATE, ((1, "X"), (1, "Y")))
    assert (ramp.kind, ramp.date, ramp.paths) == ("ramp", begin, ()), "every path is the station"
    assert (noise.kind, noise.paths, noise.size, noise.size_sigma) == ("step", ((2, "Y"),), None, None)
    for one in (step, ramp):  # C goes with the gain to the power of -1/2
        assert (one.size, one.size_sigma) == (pytest.approx(1 / 9), pytest.approx(0.01 * 10 / 9))
    expected = [Evidence(INVESTIGATION, f"{'a' * 64}#{number}", 9.0, 7) for number in (1, 2, 3)]
    assert [of_step, of_ramp, of_noise] == expected


@pytest.mark.parametrize(("date", "odds", "kind"), [(DATE, 0.02, "step"), (DATE, 0.002, "ramp"), (0, 0.02, "ramp")])
def test_a_step_between_two_campaigns_was_proposed_as_a_ramp_beside_the_step_in_force(
    instrument: Instrument, date: int, odds: float, kind: str
) -> None:
    ramp = finding("gain_drift", [1], ["X", "Y"]) | {"evidence": {"rivals": [{"cause": "gain_step", "odds": odds}]}}
    window = instant("2014-01-01"), instant("2015-01-01")
    made = Investigation("a" * 64, "CS001", *window, {}, {"findings": [ramp]}, 7, "x", "x")
    step = Change("CS001", ((1, "X"), (1, "Y")), "step", date, 50 * DAY_US, -0.07, 0.003)
    ((change, evidence),) = propose(made, instrument, [KeptChange(1, step, 1, (Evidence("drift", "", 9.0, 1),))])
    assert (change.kind, change == step, evidence.source) == (kind, kind == "step", INVESTIGATION)


@pytest.mark.parametrize(("kind", "most"), [("ramp", 0.05), ("season", 0.1)])
def test_a_decision_tells_what_a_slow_change_does_to_c_in_every_year(factory: Factory, kind: str, most: float) -> None:
    """It told C at the end of the year of its date, where a season may stand at its mean, and of that year alone."""
    path, edges = Scope("CS001", 0, "X"), [instant(f"{year}-01-01") for year in (2013, 2014, 2015, 2016)]
    versions = [new_version(path, str(k), since=since, until=until) for k, (since, until) in enumerate(pairwise(edges))]
    with factory.database.write() as stores:
        stores.versions.add(versions)
        stores.ledger.append([Promotion(0, path, *one.window, one.id, 0) for one in versions], factory.clock)
    body = {
        "paths": [{"station": "CS001", "antenna": 0, "dipole": "X"}], "kind": kind, "reason": "test",
        "at": {"value": "2014-01-01" if kind == "ramp" else "2014-10-01"}, "size": {"value": 0.1, "sigma": 0.01},
    }  # fmt: skip
    kept = factory.changes.enter(ChangeBody.model_validate(body), "test")
    dismissed = DecisionBody(decision="dismissed", reason="it was none")
    _, changes, _ = factory.changes.foresee(kept.number, dismissed, "test")
    told = [(one.path, one.start, one.end, one.after) for one in changes]
    moved = versions[1:] if kind == "ramp" else versions
    assert told == [(path, *one.window, one.id) for one in moved], "before a ramp C stands still"
    sizes = [one.curve_change.max_fraction for one in changes if one.curve_change is not None]
    assert sizes[-2:] == pytest.approx([most, most], rel=0.1)


def test_a_decision_told_what_a_path_by_itself_gives_and_not_what_the_next_daily_run_does(
    factory: Factory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With its spectra alone another antenna was likelier: the version that then went into effect was left out."""
    path, asked = {"station": "CS001", "antenna": 0, "dipole": "X"}, list[Scope]()
    body = {"paths": [path], "at": {"value": "2014-06-01"}, "reason": "test"}
    kept = factory.changes.enter(ChangeBody.model_validate(body), "test")

    def load(_: Fits, _stores: Stores, wanted: Wanted) -> None:
        asked.append(wanted.of)
        raise ConflictError("seen")

    monkeypatch.setattr(Fits, "load", load)
    factory.changes.foresee(kept.number, DecisionBody(decision="dismissed", reason="it was none"), "test")
    assert asked == [Scope("CS001")]
