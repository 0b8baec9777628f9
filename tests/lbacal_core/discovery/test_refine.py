from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.causes.terms import Law, signature
from lbacal_core.discovery.baseline import gather_stations
from lbacal_core.discovery.extend import fit_plain
from lbacal_core.discovery.refine import refine
from lbacal_core.discovery.scan import Score, scan
from lbacal_core.discovery.targets import list_targets
from lbacal_core.twin.faults.antenna import GainStep
from lbacal_core.twin.faults.fault import Where
from lbacal_core.twin.faults.interference import RfiBroadband

NAMED = {cause.identifier: cause for cause in CAUSES}


def best_of(spectra, chain, sky, cause):
    evidence = fit_plain(gather_stations(spectra, chain, sky)[0]).evidence
    (score,) = scan(evidence, [NAMED[cause]], list_targets(evidence.data))
    return evidence, score


@pytest.mark.parametrize("cause", CAUSES, ids=lambda cause: cause.identifier)
def test_the_laws_about_a_law_contain_it_or_its_like(cause, station):
    conditions = station.conditions
    for law in cause.laws(conditions)[:: max(len(cause.laws(conditions)) // 5, 1)]:
        finer = cause.finer_laws(conditions, law)
        course = cause.course(conditions, law)
        nearest = min(np.abs(cause.course(conditions, one) - course).sum() for one in finer)
        assert nearest <= 1e-9 * np.abs(course).sum() + 1.0  # a step between two events moves one event


def test_hours_between_those_of_the_scan_are_found_and_power_is_not_missing(spoil, chain, sky):
    evidence, score = best_of(spoil(RfiBroadband(size=0.05, index=0.0, hours=(17.0, 2.0))), chain, sky, "rfi_broadband")
    law = refine(evidence, score).law
    assert law.parameters["utc_h"] == [17, 2]
    # As if the scan had preferred what is missing at all other hours.
    others = Law({**score.law.parameters, "utc_h": list(reversed(score.law.parameters["utc_h"]))})
    law = refine(evidence, replace(score, law=others)).law
    assert law.parameters["utc_h"] == [17, 2]


def test_the_date_of_a_strong_step_is_that_of_an_event(spoil, chain, sky):
    step = GainStep(size=0.2, where=Where(antennas=(2,)), date="2014-08-07")
    evidence, score = best_of(spoil(step), chain, sky, "gain_step")
    effect = refine(evidence, score)
    date = np.datetime64("2014-08-07").astype("datetime64[s]").astype(float)
    times = evidence.data.conditions.time_unix
    assert effect.law.parameters["date_unix"] == times[times >= date].min()
    assert effect.law_sigma < 1e-3  # 100 standard deviations leave no other date open


def test_the_scatter_of_the_size_is_that_of_the_likelihood_over_the_laws(spoil, chain, sky):
    """Against the plain sum over laws one by one, each with its own score and size."""
    evidence, score = best_of(
        spoil(RfiBroadband(size=0.004, index=-2.0, hours=(6.0, 18.0))), chain, sky, "rfi_broadband"
    )
    effect = refine(evidence, score)
    conditions = evidence.data.conditions
    chi2, sizes, chosen = [], [], None
    for one in score.cause.finer_laws(conditions, score.law):
        vector = signature(score.cause, evidence.terms, conditions, one)
        (product,), ((information,),) = evidence.products([vector], [score.target])
        chi2.append(product**2 / information)
        sizes.append(product / information)
        chosen = len(sizes) - 1 if one == effect.law else chosen
    chi2, sizes = np.array(chi2), np.array(sizes)
    weight = np.where(sizes > 0, np.exp((chi2 - chi2[chosen]) / 2), 0.0)
    expected = np.sqrt(np.average((sizes / sizes[chosen] - 1) ** 2, weights=weight))
    assert effect.size == pytest.approx(sizes[chosen], rel=1e-3)
    assert effect.law_sigma == pytest.approx(expected, rel=1e-3)
    assert effect.law_sigma > 0.01


def test_a_cause_of_one_law_keeps_it(clean, chain, sky):
    evidence = fit_plain(gather_stations(clean, chain, sky)[0]).evidence
    drift = NAMED["gain_drift"]
    score = Score(drift, Law(), list_targets(evidence.data)[0], 5.0, 0.1, 1.0, 1)
    effect = refine(evidence, score)
    assert (effect.law, effect.size, effect.law_sigma) == (Law(), 0.1, 0.0)
