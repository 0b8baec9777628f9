"""The whole paper redone: the one call behind `lbacal paper`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from lbacal_core.paper.budget import compute_budget
from lbacal_core.paper.calibration_findings import find_about_calibration
from lbacal_core.paper.chain_figures import make_chain_figures
from lbacal_core.paper.chain_findings import find_about_chain
from lbacal_core.paper.figures import PaperFigure
from lbacal_core.paper.noise_findings import find_about_noise
from lbacal_core.paper.sky_findings import find_about_sky, find_skies
from lbacal_core.paper.statements import load_statements, make_claims
from lbacal_core.paper.study import make_study

WITHOUT_DATA = (
    "Run without --data: the comparison of sky models is that of those that ship, the spread of the receivers' "
    "gains is not "
    "tested, and figure 2 lacks the WIPL-D table. A folder with sky/*.npz, caltables/ and antenna/lba_vout.npz adds "
    "them."
)


@dataclass(frozen=True)
class RedonePaper:
    """Claims as in claims.json, figures, and notes on what was and was not at hand."""

    claims: Sequence[dict[str, Any]]
    figures: Sequence[PaperFigure]
    notes: Sequence[str]


def redo_paper(tell: Callable[[str], None], *, antennas: int | None = None, data: Path | None = None) -> RedonePaper:
    """Compute every finding and every figure.

    Parameters
    ----------
    tell
        Is told every step before it begins.
    antennas
        Antennas of each simulated station; None for all.
    data
        A folder of measured data and models that do not ship with the package.
    """
    # BLAS threads within the threads of a fit cost twice the time
    with threadpool_limits(1):
        return _redo(tell, antennas, data)


def _redo(tell: Callable[[str], None], antennas: int | None, data: Path | None) -> RedonePaper:
    study = make_study(tell, antennas)
    tell("refit with every exchange of Table 1")
    budget = compute_budget(study)
    tell("judge the statements")
    findings = {
        **find_about_sky(find_skies(data), study.frequency_mhz),
        **find_about_chain(study),
        **find_about_noise(study),
        **find_about_calibration(study, budget, data),
    }
    figures = make_chain_figures(study, budget, data)
    notes = [WITHOUT_DATA] if data is None else [f"Run with measured data and models of {data.name}/."]
    return RedonePaper(make_claims(load_statements(), findings), figures, notes)
