"""What a search leaves open, as changes of C: hypotheses that it does not exclude, and structure without a name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from lbacal_core.audit.record import RecordError
from lbacal_core.causes.cause import Cause, Template
from lbacal_core.discovery.antennas import AntennaScore
from lbacal_core.discovery.findings import Finding, gain_in_chi_squared
from lbacal_core.discovery.hypothesis import Hypothesis, Target
from lbacal_core.discovery.refit import FittedModel, fit_chain, refit, refit_over_noise
from lbacal_core.discovery.report import Search, StationContent, describe_station, plain_parameters, prepare_search
from lbacal_core.discovery.scan import list_families, overlap
from lbacal_core.discovery.search import StationReport
from lbacal_core.discovery.station import Station
from lbacal_core.grids import Floats
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.spectra import Spectra

KNOWN_CHANGE = (0.5, 2.0)
"""Factors on the power between which a structure may be taken out of the data."""


FoundValue = Finding | AntennaScore | RecordError
"""What stands behind a finding of a report."""


@dataclass(frozen=True)
class OpenHypothesis:
    """A hypothesis that the data do not exclude.

    Attributes
    ----------
    delta_chi2
        Chi^2 with it less that with the finding, both fitted in full.
    d_ln_c
        By dipole, shape (freq,): ln C with it less ln C with no hypothesis in its place, mean of the target's paths.
    """

    hypothesis: Hypothesis
    delta_chi2: float
    d_ln_c: Mapping[str, Floats]

    @property
    def weight(self) -> float:
        """Likelihood in units of that of the finding, at most 1."""
        return float(np.exp(-0.5 * max(self.delta_chi2, 0.0)))


def weigh_alternatives(
    without: FittedModel, last: FittedModel, found: Hypothesis, others: Sequence[Cause]
) -> list[OpenHypothesis]:
    """The finding and, each fitted in its place, the causes that the data cannot tell apart from it.

    Parameters
    ----------
    without, last
        Fitted models without the finding, and with it.
    others
        Causes that the data cannot tell apart from it at its size.
    """
    hypotheses = [OpenHypothesis(found, 0.0, _change(without, last, found.target))]
    nearest = _nearest_templates(without, found, others)
    for cause, template in ((one, nearest[one.identifier]) for one in others if one.identifier in nearest):
        fitted = refit_over_noise(without, Hypothesis(cause, template, found.target, 0.0))
        if fitted is not None:
            other, _ = fitted
            change = _change(without, other, found.target)
            hypotheses.append(OpenHypothesis(other.hypotheses[-1], -gain_in_chi_squared(last, other), change))
    return hypotheses


def _without(last: FittedModel, found: Hypothesis) -> FittedModel:
    """The fitted model with all hypotheses but one."""
    model = fit_chain(last.station, last.linear.modes)
    for one in last.hypotheses:
        if one is not found:
            model = refit(model, one, last.noise) or model
    return model


def _change_by_structure(report: StationReport) -> dict[str, Floats] | None:
    """Change of ln C by dipole if the residual structure is taken out of the data; None where there is none to take."""
    structure, station = report.structure, report.first.station
    if structure is None or structure.term is None:
        return None
    every = Target("station", "station", np.ones(len(station.antenna), dtype=bool))
    ratio = 1.0 + structure.term[np.searchsorted(np.unique(station.dipole), station.dipole)]
    clean = replace(station, power=station.power / np.clip(ratio, *KNOWN_CHANGE))
    return _change(report.first, fit_chain(clean, report.first.linear.modes), every)


def _change(before: FittedModel, after: FittedModel, target: Target) -> dict[str, Floats]:
    """Change of ln C = -ln(slope) / 2, mean over the paths of a target whose slopes are positive."""
    old, new = before.baseline.solution.x, after.baseline.solution.x
    has_c = (old > 0) & (new > 0) & target.is_member[:, None]
    change = -0.5 * np.log(np.divide(new, old, out=np.ones_like(old), where=has_c))
    dipole = before.station.dipole
    members = {letter: has_c & (dipole == letter)[:, None] for letter in np.unique(dipole[target.is_member]).tolist()}
    return {
        letter: np.sum(change, axis=0, where=here) / np.maximum(here.sum(axis=0), 1) for letter, here in members.items()
    }


def _nearest_templates(model: FittedModel, found: Hypothesis, others: Sequence[Cause]) -> dict[str, Template]:
    """For each cause the template with the largest correlation with the one found."""
    if not others:
        return {}
    conditions = model.station.conditions
    known = model.linear.on_events(found.cause.known_events(conditions, found.template))
    families = list_families(conditions, others)
    best: dict[str, tuple[float, Template]] = {}
    for family, r in zip(families, overlap(known, found.cause, found.template, found.target, families), strict=True):
        name, k = family.cause.identifier, int(np.argmax(np.abs(r)))
        if name not in best or abs(r[k]) > best[name][0]:
            best[name] = (float(abs(r[k])), family.templates[k])
    return {name: template for name, (_, template) in best.items()}


Each = Callable[
    [Callable[[Search, Station, Spectra], StationContent], Search, Iterable[tuple[Station, Spectra]]],
    Iterable[StationContent],
]
"""Searches the stations of an investigation, here or elsewhere, and gives them in their order."""


def investigate_openly(
    spectra: Spectra,
    simulation: Simulation,
    *,
    progress: Callable[[str], None] = lambda _: None,
    each: Each | None = None,
) -> dict[str, Any]:
    """`report.investigate` as JSON values, with what the report leaves open, each with its change of C.

    A finding of the catalogue gets `left_open`: itself with the weight 1, then what the data cannot tell apart from it.
    Structure without a name gets `d_ln_c`: the change of C if it is taken out of the data.
    """
    search, stations = prepare_search(spectra, simulation)
    if each is None:
        return search.join([search_openly(search, *one, progress) for one in stations])
    return search.join(list(each(search_openly, search, stations)))


def search_openly(
    search: Search, station: Station, own: Spectra, progress: Callable[[str], None] = lambda _: None
) -> StationContent:
    """Search one station, and describe it with what that leaves open."""
    report = search.run(station, own, progress)
    # The products are small: threads of the linear algebra would wait for each other.
    with threadpool_limits(1):
        return _add_left_open(describe_station(report), report)


def _add_left_open(content: StationContent, report: StationReport) -> StationContent:
    for finding in content.findings:
        found = find_value(report, finding)
        if isinstance(found, Finding):  # of antennas that are compared and of records, nothing is open
            names = [name for name, _ in found.indistinguishable]
            others = [one for one in report.catalogue if one.identifier in names]
            without = _without(report.last, found.hypothesis)
            hypotheses = weigh_alternatives(without, report.last, found.hypothesis, others)
            finding["left_open"] = [_describe(one) for one in hypotheses]
    if content.station["unexplained"] is not None:
        change = _change_by_structure(report)
        content.station["unexplained"]["d_ln_c"] = (
            None if change is None else {dipole: one.tolist() for dipole, one in change.items()}
        )
    return content


def find_value(report: StationReport, finding: Mapping[str, Any]) -> FoundValue:
    """The value behind the JSON values of a finding of a station."""
    named = finding["cause"], finding["evidence"]["target"], finding["size"]["value"]
    values: list[tuple[tuple[str, str, float], FoundValue]] = [
        ((one.hypothesis.cause.identifier, one.hypothesis.target.label, one.size[0]), one) for one in report.findings
    ]
    values += [((one.cause.identifier, one.target.label, one.size), one) for one in report.antennas]
    values += [((one.cause.identifier, one.label, one.size[0]), one) for one in report.record]
    return next(value for name, value in values if name == named)


def _describe(one: OpenHypothesis) -> dict[str, Any]:
    return {
        "cause": one.hypothesis.cause.identifier,
        "parameters": plain_parameters(one.hypothesis.template.parameters),
        "size": one.hypothesis.size,
        "delta_chi2": one.delta_chi2,
        "weight": one.weight,
        "d_ln_c": {dipole: values.tolist() for dipole, values in one.d_ln_c.items()},
    }
