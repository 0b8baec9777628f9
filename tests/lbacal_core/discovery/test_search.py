from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.discovery.search import search_station
from lbacal_core.discovery.station import gather_stations
from lbacal_core.twin.campaign import simulate_campaign
from lbacal_core.twin.faults.antenna import GainStep, GainTemperature
from lbacal_core.twin.faults.fault import Where
from lbacal_core.twin.faults.sky import LstOffset
from tests.lbacal_core.discovery.conftest import SEED, SETTINGS


def test_every_number_of_a_finding_is_of_the_last_model(chain, sky):
    """Two effects: what each gains is against the model with the other alone, not against that of its step."""
    faults = [GainStep(size=0.03, where=Where(antennas=(2,)), date="2014-08-07"), LstOffset(size=0.1)]
    spectra = simulate_campaign(SETTINGS, chain, sky, np.random.default_rng(SEED), faults).spectra
    report = search_station(gather_stations(spectra, chain, sky)[0])
    assert {one.hypothesis.cause.identifier for one in report.findings} == {"gain_step", "lst_offset"}
    chi2, dof = report.last.linear.chi_squared()
    for finding in report.findings:
        assert (finding.chi2_after, finding.dof) == (chi2, dof)
        expected = (finding.hypothesis.size / finding.hypothesis.sigma) ** 2
        # Chi^2 is not quite quadratic in the size.
        assert finding.chi2_before - finding.chi2_after == pytest.approx(expected, rel=0.15)
    whole = report.first.linear.with_levels(report.last.linear.residuals.levels).chi_squared()[0]
    assert whole > max(finding.chi2_before for finding in report.findings)


def test_the_sizes_of_all_findings_are_those_of_the_last_fit(world):
    """A cause that is found second moves the size of the first: both are reported as fitted together."""
    report = world.look(GainTemperature(size=0.02), LstOffset(size=0.4)).investigate()
    found = {finding.hypothesis.cause.identifier: finding.hypothesis for finding in report.findings}
    assert set(found) == {"gain_temperature", "lst_offset"}
    together = {one.cause.identifier: one for one in report.last.hypotheses}
    for cause, size in (("gain_temperature", 0.02), ("lst_offset", 0.4)):
        assert (found[cause].size, found[cause].sigma) == (together[cause].size, together[cause].sigma)
        assert found[cause].size == pytest.approx(size, abs=3 * found[cause].uncertainty)
