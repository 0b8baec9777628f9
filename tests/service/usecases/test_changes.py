"""What an investigation proposes as a change."""

from __future__ import annotations

from typing import Any

import pytest

from lbacal_core.instrument.instrument import Instrument
from service.storage.changes import INVESTIGATION, Evidence
from service.storage.models import Investigation
from service.usecases.changes import propose
from tests.service.conftest import instant

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
