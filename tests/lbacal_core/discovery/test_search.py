from __future__ import annotations

import pytest

from lbacal_core.twin.faults.antenna import GainTemperature
from lbacal_core.twin.faults.sky import LstOffset


def test_the_sizes_of_all_findings_are_those_of_the_last_fit(world):
    """A cause that is found second moves the size of the first: both are reported as fitted together."""
    report = world.look(GainTemperature(size=0.02), LstOffset(size=0.4)).investigate()
    found = {finding.hypothesis.cause.identifier: finding.hypothesis for finding in report.findings}
    assert set(found) == {"gain_temperature", "lst_offset"}
    together = {one.cause.identifier: one for one in report.last.hypotheses}
    for cause, size in (("gain_temperature", 0.02), ("lst_offset", 0.4)):
        assert (found[cause].size, found[cause].sigma) == (together[cause].size, together[cause].sigma)
        assert found[cause].size == pytest.approx(size, abs=3 * found[cause].uncertainty)
