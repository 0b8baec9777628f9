from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.causes.terms import signature
from lbacal_core.discovery.extend import fit_plain
from lbacal_core.discovery.scan import correlate_with, list_shapes, make_courses, scan
from lbacal_core.discovery.targets import list_targets


@pytest.fixture(scope="module")
def evidence(station):
    return fit_plain(station).evidence


def test_shapes_times_courses_are_the_signatures_of_all_laws(evidence):
    conditions = evidence.data.conditions
    for shape in list_shapes(evidence, CAUSES)[::7]:
        for k in (0, -1):
            law = shape.laws[k]
            base = signature(shape.cause, evidence.terms, conditions, shape.laws[0])
            course = shape.cause.course(conditions, law)
            first = shape.cause.course(conditions, shape.laws[0])
            both = (course[:, 0] != 0) & (first[:, 0] != 0)
            direct = signature(shape.cause, evidence.terms, conditions, law)
            expected = base[:, both] / first[both] * course[both]
            np.testing.assert_allclose(direct[:, both], expected, rtol=2e-3, atol=2e-5 * np.abs(direct).max())


def test_sums_over_sets_of_events_equal_plain_sums():
    rng = np.random.default_rng(2)
    hours = rng.uniform(0, 24, 70)
    values = np.stack([(hours >= begin) & (hours < begin + 6) for begin in range(20)]).astype(float)
    vectors = rng.standard_normal((3, 70, 5))
    np.testing.assert_allclose(make_courses(values).sum(vectors), values @ vectors, atol=1e-12)


def test_scores_of_a_clean_station_are_not_significant(evidence):
    found = scan(evidence, CAUSES, list_targets(evidence.data))
    assert {score.cause.identifier for score in found} == {cause.identifier for cause in CAUSES}
    assert min(score.p_value for score in found) > 0.003


def test_a_cause_correlates_fully_with_itself_and_less_with_others(evidence):
    targets = {target.label: target for target in list_targets(evidence.data)}
    named = {cause.identifier: cause for cause in CAUSES}
    drift = named["gain_drift"]
    (law,) = drift.laws(evidence.data.conditions)
    found = {
        cause.identifier: r
        for cause, r in correlate_with(evidence, drift, law, targets["station"], [drift, named["lst_offset"]])
    }
    assert found["gain_drift"] > 1 - 1e-6
    assert found["lst_offset"] < 0.5
