"""`lbacal.budget`: how far C may be off, term by term, each by a refit of the same spectra."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Self

import numpy as np
from astropy import units as u
from astropy.table import QTable

from lbacal.analysis.data import spectra_of
from lbacal.analysis.instrument import Described, simulation_of
from lbacal.analysis.result import Result
from lbacal.pages.budget import describe_best, draw_budget, tabulate
from lbacal.pages.report import Origin, list_origin
from lbacal.with_model import Extended, read_open_terms
from lbacal_core.calibration.budget import compute_budget, measure_electronics
from lbacal_core.calibration.chain_form import compare_forms
from lbacal_core.curves.covariance import Budget, BudgetTerm
from lbacal_core.grids import Floats
from lbacal_core.simulation.prior import DEFAULT_SKY_BUDGET
from lbacal_core.sky.table import SkyPower
from lbacal_core.spectra.spectra import Spectra


@dataclass(frozen=True, repr=False, kw_only=True)
class ErrorBudget(Result):
    """The systematic errors of C: the terms that all curves share, that of single antennas, and what is left open."""

    shared: Budget
    terms: Sequence[BudgetTerm]

    @classmethod
    def of(cls, shared: Budget, terms: Sequence[BudgetTerm], origin: Origin = ()) -> Self:
        """Make the result of these terms."""
        nu = shared.frequency_mhz
        of_gain = ["C/|H| has no error of the antenna gain."] if any(term.is_of_gain for term in terms) else []
        return cls(
            title=f"budget {shared.digest}",
            rows=tabulate(nu, terms),
            notes=[describe_best(nu, terms), *of_gain],
            charts=partial(draw_budget, shared, terms),
            as_table=partial(_list_sigmas, nu, terms),
            as_dict=lambda: {shared.digest: shared.as_dict()},
            origin=origin,
            shared=shared,
            terms=terms,
        )


def _list_sigmas(frequency_mhz: Floats, terms: Sequence[BudgetTerm]) -> QTable:
    """A row for each term, polarisation and channel: one standard deviation of ln C."""
    parts = [(term.name, p, np.sqrt(term.variance(p))) for term in terms for p in term.vectors]
    names, polarisations, sigma = zip(*parts, strict=True)
    columns = [np.repeat(one, frequency_mhz.size) for one in (names, polarisations)]
    columns += [np.tile(frequency_mhz, len(parts)) * u.MHz, np.concatenate(sigma)]
    return QTable(columns, names=("term", "polarisation", "frequency_mhz", "sigma"))


def budget(
    spectra: Spectra | str | Path,
    instrument: Described,
    sky_power: SkyPower | str | Path | None = None,
    sky: str = DEFAULT_SKY_BUDGET,
    left_open: Extended = None,
    *,
    tell: Callable[[str], None] = lambda _: None,
) -> ErrorBudget:
    """How far C may be off, term by term as in Table 1 of the paper; every term is a refit of these spectra.

    Parameters
    ----------
    spectra, instrument, sky_power
        As in `lbacal.fit`.
    sky
        Where the error of the sky is taken from: paper (20 %), models (seven models, 12 %), measured (absolute).
    left_open
        An `Investigation` of these data whose findings are not adopted, or its report; one of its findings, or
        ``"R.json#n"``, where that one is.
    tell
        Called with a sentence before each step.

    Examples
    --------
    >>> import lbacal
    >>> spectra = lbacal.simulate("lofar-superterp", events=100, antennas=2)
    >>> lbacal.budget(spectra, "lofar-superterp", sky="paper").save("budget.png")  # doctest: +SKIP
    """
    measured = spectra_of(spectra)
    simulation = simulation_of(instrument, sky_power).smeared(measured)
    tell("compare the forms of the chain")
    simulation = simulation.with_form(compare_forms(measured, simulation).name)
    tell("refit with each term")
    shared = compute_budget(measured, simulation, sky)
    tell("error of single antennas")
    of_antennas = measure_electronics(measured, simulation)
    terms = [*shared.terms, *([] if of_antennas is None else [of_antennas])]
    members = sorted(set(zip(measured.station.tolist(), measured.antenna.tolist(), strict=True)))
    terms += [one.for_mean_of(members, terms[0].vectors) for one in read_open_terms(left_open, "left_open")]
    return ErrorBudget.of(shared, terms, list_origin(measured.origin, simulation, measured.time_unix))
