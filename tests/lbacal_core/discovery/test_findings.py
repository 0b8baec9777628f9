from __future__ import annotations

from types import SimpleNamespace

import pytest

from lbacal_core.discovery.findings import _idle
from lbacal_twin.faults.antenna import GainTemperature
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.sky import DipoleAzimuth, LstOffset


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


@pytest.mark.long
def test_findings_that_both_add_something_stay(world):
    report = world.look(GainTemperature(size=0.02), LstOffset(size=0.4)).investigate()
    assert {one.hypothesis.cause.identifier for one in report.findings} == {"gain_temperature", "lst_offset"}


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
