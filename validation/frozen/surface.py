"""The numbers that are frozen of a data set; the one file of `frozen` that knows the names inside discovery.

A commit that renames what is inside discovery changes this file and no number.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.discovery.curve_search import describe_curve, investigate_curve
from lbacal_core.discovery.hypothesis import list_targets
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.report import investigate
from lbacal_core.discovery.residual_structure import strongest_structure
from lbacal_core.discovery.scan import by_known_events, list_families, score_families
from lbacal_core.discovery.search import StationReport
from lbacal_core.lstcurve.curve import BAND_MHZ
from lbacal_core.provenance import Provenance
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.spectra import Spectra
from validation.frozen.data_sets import BandCurve, DataSet, StationSpectra
from validation.superterp import power_of


def frozen_numbers(data: DataSet) -> dict[str, Any]:
    """The report, a summary of the data, and for spectra the scan of every station, as JSON values."""
    return _of_curve(data) if isinstance(data, BandCurve) else _of_spectra(data)


def _of_curve(data: BandCurve) -> dict[str, Any]:
    curve = data.curve()
    found = investigate_curve(curve, Simulation(data.instrument, power_of(), is_own_sky=data.is_own_sky), BAND_MHZ)
    points = np.concatenate(list(curve.variation_db.values()))
    return {
        "data": {"points": int(np.isfinite(points).sum()), "square_db2": float(np.nansum(points**2))},
        "report": _without_provenance(describe_curve(found, Provenance({}))),
    }


def _of_spectra(data: StationSpectra) -> dict[str, Any]:
    """As `lbacal investigate` asks, with the seed of the data set."""
    spectra = data.spectra()
    report, stations = investigate(
        spectra, Simulation(data.instrument, power_of(), is_own_sky=data.is_own_sky), seed=data.seed
    )
    numbers = _without_provenance(report)
    numbers["scores"] = {
        station.station.name: _of_scores(report["scores"][station.station.name], station) for station in stations
    }
    return {
        "data": _of_data(spectra),
        "report": numbers,
        "scan": {station.station.name: _of_scan(station) for station in stations},
    }


def _of_data(spectra: Spectra) -> dict[str, Any]:
    """Says whether the data themselves are the same, before anything is asked of the answer."""
    log_power = np.log(spectra.power)
    environment = {name: float(np.nansum(values)) for name, values in spectra.environment.items()}
    return {"rows": len(spectra), "sum": float(log_power.sum()), "square": float(np.sum(log_power**2)), **environment}


def _without_provenance(report: Mapping[str, Any]) -> dict[str, Any]:
    stations = [{key: value for key, value in one.items() if key not in OF_DATA} for one in report.get("stations", ())]
    whole = {**report, "stations": stations} if stations else report
    numbers: dict[str, Any] = _without_pictures({key: value for key, value in whole.items() if key != "provenance"})
    return numbers


OF_DATA = ("paths", "events", "dates")
"""Fields of a station that say what its data are."""


def _without_pictures(value: Any) -> Any:
    """The same without what is drawn of it."""
    if isinstance(value, Mapping):
        return {key: _without_pictures(one) for key, one in value.items() if key != "picture"}
    return [_without_pictures(one) for one in value] if isinstance(value, list) else value


def _of_scan(station: StationReport) -> dict[str, Any]:
    """All scores in short and the strongest structure, before anything is found and with everything that is."""
    models = {"first": station.first.linear}
    if station.last is not station.first:
        models["last"] = station.last.linear
    with threadpool_limits(1):
        return {
            name: {
                "causes": _summarise([(batch[0].cause.identifier, z, size) for batch, z, size in _all_scores(one)]),
                "structure": _of_structure(one),
            }
            for name, one in models.items()
        }


def _of_structure(model: LinearModel) -> dict[str, Any]:
    """The strongest residual structure, however weak it is."""
    structure = strongest_structure(model, np.random.default_rng(0))
    return {
        "axis": structure.axis_name,
        "target": structure.target,
        "p_value": structure.p_value,
        "gain": structure.gain,
        "terms": structure.dof,
        "held_out": structure.held_out_gain or 0.0,
        "mean_frequency_mhz": float(structure.channel_share @ model.station.conditions.frequency_mhz),
    }


def _all_scores(model: LinearModel) -> list[Any]:
    families, targets = list_families(model.station.conditions, CAUSES), list_targets(model.station)
    return [one for known, alike in by_known_events(model, families) for one in score_families(known, alike, targets)]


def _of_scores(scores: Sequence[dict[str, Any]], station: StationReport) -> dict[str, Any]:
    """The best score of every cause by its ID, with the trials factor."""
    both: list[Any] = [*station.scores, *station.antenna_scores]
    best: dict[str, Any] = {}
    for one, told in zip(both, scores, strict=True):
        best.setdefault(told["cause"], {**in_first_window(told), "trials": float(one.trials)})
    return best


def in_first_window(score: dict[str, Any]) -> dict[str, Any]:
    """The one of two windows that share out the day that does not contain midnight.

    Power without a slope in one window, or as much less in the other: A(nu) and N_ADC absorb the difference, the two
    scores are equal and opposite, and rounding decides which of them is the best.
    """
    begin, end = score["parameters"].get("utc_h", (0, 24))
    if score["parameters"].get("spectral_index") != 0.0 or begin < end:
        return score
    turned = {**score["parameters"], "utc_h": [end, begin]}
    return {**score, "parameters": turned, "score_sigma": -score["score_sigma"], "size": -score["size"]}


def _summarise(scores: Sequence[tuple[str, np.ndarray, np.ndarray]]) -> dict[str, Any]:
    """All scores of a cause in short: how many are seen, sum, sum of squares, largest, mean ln sigma of the size."""
    summary = {}
    for cause in dict.fromkeys(name for name, _, _ in scores):
        z = np.concatenate([one.ravel() for name, one, _ in scores if name == cause])
        size = np.concatenate([one.ravel() for name, _, one in scores if name == cause])
        is_seen = z != 0.0
        summary[cause] = {
            "scores": z.size,
            "seen": int(is_seen.sum()),
            "sum": float(z.sum()),
            "square": float(np.sum(z**2)),
            "largest": float(np.abs(z).max()),
            "mean_ln_sigma": float(np.mean(np.log(size[is_seen] / z[is_seen]))) if is_seen.any() else None,
        }
    return summary
