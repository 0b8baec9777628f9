from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.calibration.left_open import list_open_terms, widen_by_open_terms
from lbacal_core.errors import BadInputError
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings

F = 51


def hypothesis(weight, change, dipoles="XY"):
    return {"cause": "a", "weight": weight, "d_ln_c": {dipole: [change] * F for dipole in dipoles}}


def finding(antennas, *hypotheses):
    return {"cause": "gain_step", "where": {"station": "CS002", "antennas": antennas}, "left_open": list(hypotheses)}


def report_of(*findings, unexplained=None):
    return {"findings": list(findings), "stations": [{"station": "CS002", "findings": [], "unexplained": unexplained}]}


@pytest.fixture(scope="module")
def fitted(chain, sky, simulation):
    settings = TwinSettings(stations=("CS002", "CS003"), antennas=4, events_per_year=200)
    spectra = simulate_campaign(settings, chain, sky, np.random.default_rng(4)).spectra
    return {scope: fit_calibration(spectra, simulation, scope) for scope in ("antenna", "station", "array")}


def relative(report, station, dipole, antenna=None):
    (curve,) = [c for c in report.curves if c.path == (station, antenna, dipole)]
    return None if curve.c_sigma_sys is None else curve.c_sigma_sys / curve.c


def test_a_finding_that_is_not_adopted_counts_in_full():
    (term,) = list_open_terms(report_of(finding([0, 1], hypothesis(1.0, 0.03))))
    assert np.sum(term.vectors["X"] ** 2, axis=0) == pytest.approx(np.full(F, 0.03**2))


def test_an_adopted_finding_leaves_the_scatter_of_what_is_not_excluded():
    (term,) = list_open_terms(report_of(finding([0], hypothesis(1.0, 0.03), hypothesis(0.5, 0.06))), adopted=[0])
    # the second moment about what is adopted: a third of the probability lies 0.03 away
    assert np.sum(term.vectors["X"] ** 2, axis=0) == pytest.approx(np.full(F, 0.03**2 / 3))
    (alone,) = list_open_terms(report_of(finding([0], hypothesis(1.0, 0.03))), adopted=[0])
    assert alone.vectors["X"].shape == (0, F)


def test_structure_without_a_name_counts_in_full_for_its_station_alone(fitted):
    terms = list_open_terms(report_of(unexplained={"d_ln_c": {"X": [0.1] * F, "Y": [0.2] * F}}))
    wider = widen_by_open_terms(fitted["station"], terms)
    assert relative(wider, "CS002", "Y") == pytest.approx(np.full(F, 0.2))
    assert relative(wider, "CS003", "Y") is None
    assert list_open_terms(report_of(unexplained={"d_ln_c": None})) == []


def test_a_wider_scope_has_the_error_by_the_share_of_its_paths(fitted):
    terms = list_open_terms(report_of(finding([1], hypothesis(1.0, 0.08, "X"))))
    path, station, array = (widen_by_open_terms(fitted[scope], terms) for scope in ("antenna", "station", "array"))
    assert relative(path, "CS002", "X", 1) == pytest.approx(np.full(F, 0.08))
    assert relative(path, "CS002", "X", 2) is None
    assert relative(path, "CS002", "Y", 1) is None
    assert relative(station, "CS002", "X") == pytest.approx(np.full(F, 0.02))
    assert relative(array, None, "X") == pytest.approx(np.full(F, 0.01))


def test_the_error_joins_those_that_a_curve_has(fitted):
    known = replace(
        fitted["station"], curves=tuple(replace(c, c_sigma_sys=0.06 * c.c) for c in fitted["station"].curves)
    )
    terms = list_open_terms(report_of(unexplained={"d_ln_c": {"X": [0.08] * F}}))
    wider = widen_by_open_terms(known, terms)
    assert relative(wider, "CS002", "X") == pytest.approx(np.full(F, 0.1))
    (curve,) = [c for c in wider.curves if (c.station, c.dipole) == ("CS002", "X")]
    assert curve.covariance.own == pytest.approx(np.full((1, F), 0.08))


def test_a_number_that_the_report_does_not_have_and_another_grid_are_named(fitted):
    report = report_of(finding([0], hypothesis(1.0, 0.03)))
    with pytest.raises(BadInputError, match="numbers 0 to 0"):
        list_open_terms(report, adopted=[1])
    coarse = report_of(unexplained={"d_ln_c": {"X": [0.1] * 7}})
    with pytest.raises(BadInputError, match="51 channels"):
        widen_by_open_terms(fitted["station"], list_open_terms(coarse))
