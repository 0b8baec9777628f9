"""The numbers that are frozen of a data set: the report, without its scores and its provenance.

A commit that renames what is inside discovery changes no line and no number here.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lbacal_core.discovery.curve_search import describe_curve, investigate_curve
from lbacal_core.discovery.report import investigate
from lbacal_core.lstcurve.curve import BAND_MHZ
from lbacal_core.provenance import Provenance
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.spectra import Spectra
from validation.frozen.data_sets import BandCurve, DataSet, StationSpectra
from validation.superterp import power_of


def frozen_numbers(data: DataSet) -> dict[str, Any]:
    """The report and a summary of the data, as JSON values."""
    taken, report = _of_curve(data) if isinstance(data, BandCurve) else _of_spectra(data)
    return {"data": taken, "report": {key: one for key, one in report.items() if key not in ("provenance", "scores")}}


def _of_curve(data: BandCurve) -> tuple[dict[str, Any], dict[str, Any]]:
    curve = data.curve()
    found = investigate_curve(curve, Simulation(data.instrument, power_of(), is_own_sky=data.is_own_sky), BAND_MHZ)
    points = np.concatenate(list(curve.variation_db.values()))
    taken = {"points": int(np.isfinite(points).sum()), "square_db2": float(np.nansum(points**2))}
    return taken, describe_curve(found, Provenance({}))


def _of_spectra(data: StationSpectra) -> tuple[dict[str, Any], dict[str, Any]]:
    """As `lbacal investigate` asks, with the seed of the data set."""
    spectra = data.spectra()
    simulation = Simulation(data.instrument, power_of(), is_own_sky=data.is_own_sky)
    return _of_data(spectra), investigate(spectra, simulation, seed=data.seed)[0]


def _of_data(spectra: Spectra) -> dict[str, Any]:
    """Says whether the data themselves are the same, before anything is asked of the answer."""
    log_power = np.log(spectra.power)
    environment = {name: float(np.nansum(values)) for name, values in spectra.environment.items()}
    return {"rows": len(spectra), "sum": float(log_power.sum()), "square": float(np.sum(log_power**2)), **environment}
