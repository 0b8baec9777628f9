from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.discovery.hypothesis import Hypothesis, Target
from lbacal_core.discovery.left_open import add_left_open, weigh_alternatives
from lbacal_core.discovery.refit import fit_chain, refit
from lbacal_core.discovery.report import investigate
from lbacal_core.discovery.station import gather_stations
from lbacal_twin.faults.antenna import GainStep
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.sky import ZenithWeighting


@pytest.fixture(scope="module")
def weighted(spoil, chain, sky):
    """A year whose sky is weighted with another power of the cosine, and the hypothesis that it is."""
    spectra = spoil(ZenithWeighting(size=1.0))
    (station,) = gather_stations(spectra, chain, sky)
    first = fit_chain(station)
    cause = next(one for one in CAUSES if one.identifier == "zenith_weighting")
    target = Target("station", "station", np.ones(len(station.antenna), dtype=bool))
    last = refit(first, Hypothesis(cause, cause.templates(station.conditions)[0], target, 0.0))
    return spectra, first, last


def test_the_finding_itself_moves_c_by_what_it_was_off(weighted, chain, sky, clean):
    spectra, first, last = weighted
    (found,) = weigh_alternatives(first, last, last.hypotheses[0], [])
    assert found.weight == 1.0
    assert found.delta_chi2 == 0.0
    # the same hardware with and without the fault
    before, after = (fit_calibration(one, chain, sky, "antenna").curves for one in (spectra, clean))
    for letter in "XY":
        paths = [(a, b) for a, b in zip(before, after, strict=True) if a.dipole == letter]
        off = np.mean([np.log(a.c / b.c) for a, b in paths], axis=0)
        sigma = np.mean([a.c_sigma_stat / a.c for a, _ in paths], axis=0)
        assert np.median(np.abs(off)) > 2 * np.median(sigma)
        assert np.median(np.abs(found.d_ln_c[letter] + off)) < 0.5 * np.median(np.abs(off))


def test_what_fits_nearly_as_well_keeps_its_likelihood_and_its_own_change_of_c(weighted):
    _, first, last = weighted
    found, other = weigh_alternatives(first, last, last.hypotheses[0], ["pattern_width"])
    assert other.hypothesis.cause.identifier == "pattern_width"
    assert other.weight == pytest.approx(np.exp(-0.5 * max(other.delta_chi2, 0.0)))
    # a wider pattern takes up a part of the effect, so that it does not fit worse than no hypothesis
    assert other.delta_chi2 <= first.linear.chi_squared()[0] - last.linear.chi_squared()[0]
    assert np.max(np.abs(other.d_ln_c["X"] - found.d_ln_c["X"])) > 1e-3


@pytest.mark.long
def test_a_finding_of_a_report_says_what_it_does_to_c_of_its_paths(spoil, chain, sky):
    step = GainStep(size=0.05, where=Where(antennas=(2,), dipoles=("Y",)), date="2014-08-07")
    report = add_left_open(*investigate(spoil(step), chain, sky))
    (finding,) = report["findings"]
    itself, *_ = finding["left_open"]
    assert itself["cause"] == "gain_step"
    assert itself["weight"] == 1.0
    assert list(itself["d_ln_c"]) == ["Y"]
    # 5 % more power in the last 40 % of the year: 1 % of C
    assert np.median(itself["d_ln_c"]["Y"]) == pytest.approx(0.01, abs=0.006)
