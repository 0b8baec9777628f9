from __future__ import annotations

from dataclasses import replace

import numpy as np

from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.causes.cause import Template
from lbacal_core.discovery.families import correlate, group_templates, overlap
from lbacal_core.discovery.hypothesis import list_targets


def test_a_cause_correlates_fully_with_itself_and_less_with_others(model):
    conditions = model.station.conditions
    targets = {target.label: target for target in list_targets(model.station)}
    named = {cause.identifier: cause for cause in CAUSES}
    drift, *others = (
        group_templates(conditions, named[name], named[name].templates(conditions))
        for name in ("gain_drift", "lst_offset", "rfi_line")
    )
    families = [*drift, *others[0], *others[1]]
    itself, other, *lines = overlap(model, named["gain_drift"], Template(), targets["station"], families)
    assert itself > 1 - 1e-6
    assert abs(other) < 0.5
    direct = correlate(model, [*drift, *others[0], others[1][7]], targets["station"])[0]
    np.testing.assert_allclose(np.concatenate([itself, other, lines[7]]), direct, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(correlate(model, drift, targets["antenna 2"]), [[1.0]], rtol=1e-9)


def test_a_template_that_the_fit_leaves_free_is_no_trial(model):
    """What rounding leaves of it was as long as 0.2 of a unit, and one trial more: 3 % of those of interference."""
    (cause,) = (cause for cause in CAUSES if cause.identifier == "gain_drift")
    (drift,) = group_templates(model.station.conditions, cause, cause.templates(model.station.conditions))
    constant = replace(drift, profiles=np.ones_like(drift.profiles))
    (target,) = (target for target in list_targets(model.station) if target.scope == "station")
    np.testing.assert_allclose(correlate(model, [drift, constant], target), np.diag([1.0, 0.0]), atol=1e-12)
