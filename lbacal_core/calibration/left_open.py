"""What an investigation leaves open, as errors of the curves that it concerns.

A finding with hypotheses h, of weight exp(-dchi2 / 2) and with the change v_h of ln C, is used with v: its own change
where the finding is adopted, none where it is not. With p_h the weights over their sum, the vectors of the error are
p_h^1/2 (v_h - v), so that a finding that is not adopted counts in full. Structure without a name counts in full.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lbacal_core.causes.model import UNEXPLAINED
from lbacal_core.curves.covariance import BudgetTerm
from lbacal_core.curves.curves import CalibrationCurve, FitReport
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats


@dataclass(frozen=True)
class OpenTerm:
    """One error that an investigation leaves on some paths.

    Attributes
    ----------
    station, antennas
        Where; all antennas of the station where `antennas` is None.
    vectors
        By dipole, shape (vector, freq): d ln C.
    """

    name: str
    station: str
    antennas: frozenset[int] | None
    vectors: Mapping[str, Floats]

    def share_of(self, members: Iterable[tuple[str, int]]) -> float:
        """The part, 0 to 1, of some antennas, by station and number, that have it."""
        has_it = [s == self.station and (self.antennas is None or a in self.antennas) for s, a in members]
        return float(np.mean(has_it)) if has_it else 0.0

    def for_mean_of(self, members: Iterable[tuple[str, int]], polarisations: Iterable[str]) -> BudgetTerm:
        """The term of a budget for the mean of some antennas, by station and number."""
        size = next(iter(self.vectors.values())).shape[1]
        share, none = self.share_of(members), np.zeros((0, size))
        vectors = {p: share * self.vectors.get(p, none) for p in polarisations}
        return BudgetTerm(self.name, f"lbacal investigate, {self.station}", vectors)


def list_open_terms(report: Mapping[str, Any], adopted: Collection[int | str] = ()) -> list[OpenTerm]:
    """The errors that a report of `lbacal investigate` leaves.

    Parameters
    ----------
    report
        R.json.
    adopted
        Numbers of the findings with which C is made; ``unexplained`` for the structure without a name.
    """
    numbers = range(len(report["findings"]))
    wrong = [number for number in adopted if number not in numbers and number != UNEXPLAINED]
    if wrong:
        raise BadInputError("findings", f"numbers 0 to {len(report['findings']) - 1}", f"{wrong[0]}")
    terms = []
    for number, finding in enumerate(report["findings"]):
        hypotheses, where = finding.get("left_open"), finding["where"]
        if hypotheses:
            terms.append(
                OpenTerm(
                    f"{finding['cause']} {'adopted' if number in adopted else 'not adopted'}",
                    where["station"],
                    frozenset(where["antennas"]),
                    _vectors(hypotheses, is_adopted=number in adopted),
                )
            )
    return terms if UNEXPLAINED in adopted else [*terms, *_unexplained(report)]


def _vectors(hypotheses: list[dict[str, Any]], *, is_adopted: bool) -> dict[str, Floats]:
    weight = np.array([one["weight"] for one in hypotheses])
    size = np.sqrt(weight / weight.sum())[:, None]
    found = {}
    for dipole in hypotheses[0]["d_ln_c"]:
        change = np.array([one["d_ln_c"][dipole] for one in hypotheses])
        vectors = size * (change - (change[0] if is_adopted else 0.0))
        found[dipole] = vectors[1:] if is_adopted else vectors
    return found


def _unexplained(report: Mapping[str, Any]) -> Iterator[OpenTerm]:
    for station in report.get("stations", []):
        change = (station["unexplained"] or {}).get("d_ln_c")
        if change is not None:
            vectors = {dipole: np.array([values]) for dipole, values in change.items()}
            yield OpenTerm("structure without a name", station["station"], None, vectors)


def _on_grid(term: OpenTerm, curve: CalibrationCurve) -> Floats:
    vectors, channels = term.vectors[str(curve.dipole)], curve.frequency_mhz.size
    if vectors.shape[1] != channels:
        raise BadInputError("report", f"changes of C at {channels} channels, as in the data", f"{vectors.shape[1]}")
    return vectors


def widen_by_open_terms(report: FitReport, terms: Collection[OpenTerm]) -> FitReport:
    """The report whose curves have these errors among their own systematic ones, by the share of paths with them."""
    curves = []
    for curve, chain in zip(report.curves, report.chains, strict=True):
        if curve.c is None or curve.covariance is None:
            curves.append(curve)
            continue
        own = [np.zeros((0, curve.frequency_mhz.size))]
        for term in terms:
            members = [(str(curve.station), curve.antenna or 0)] if chain is None else chain.members
            share = term.share_of(members)
            if share > 0.0 and curve.dipole in term.vectors:
                own.append(share * _on_grid(term, curve))
        vectors = np.concatenate(own)
        known = np.zeros_like(curve.c) if curve.c_sigma_sys is None else curve.c_sigma_sys
        wider = np.hypot(known, curve.c * np.sqrt(np.sum(vectors**2, axis=0)))
        covariance = replace(curve.covariance, own=np.concatenate([curve.covariance.own, vectors]))
        is_known = curve.c_sigma_sys is not None or len(vectors) > 0
        curves.append(replace(curve, c_sigma_sys=wider if is_known else None, covariance=covariance))
    return replace(report, curves=tuple(curves))
