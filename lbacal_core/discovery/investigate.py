"""The entry of an investigation: search station by station for what the simulation of the spectra gets wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from threadpoolctl import threadpool_limits

from lbacal_core.discovery.adopted import describe_size
from lbacal_core.discovery.policy import Policy
from lbacal_core.discovery.report import describe
from lbacal_core.discovery.search import StationReport, search_station
from lbacal_core.discovery.station import gather_stations, model_modes
from lbacal_core.grids import require_same_grid
from lbacal_core.instrument import Instrument
from lbacal_core.model import PLAIN, Model
from lbacal_core.provenance import Provenance
from lbacal_core.skypower.differences import DifferenceModels, compute_model_differences
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra import Spectra


def investigate(
    spectra: Spectra,
    instrument: Instrument,
    sky_power: SkyPower,
    *,
    is_own_sky: bool = False,
    models: DifferenceModels | None = None,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
    model: Model = PLAIN,
) -> tuple[dict[str, Any], list[StationReport]]:
    """Find what the simulation gets wrong in the spectra of every station.

    Parameters
    ----------
    is_own_sky
        Whether `sky_power` is the package's own, so that the differences between sky and antenna models are profiled
        out. A sky power from a file is taken as exact.
    models
        Names of the models whose differences these are; all that ship unless given.
    seed
        Seed of the simulated trials factors.
    progress
        Called with a sentence before each step.
    model
        Its adopted causes belong to the baseline, with sizes fitted again: what is looked for is what they leave.

    Returns
    -------
    The report as JSON values, and the values of each station from which it was made.
    """
    name = f"instrument {instrument.name}"
    require_same_grid(spectra.origin, spectra.frequency_mhz, instrument.frequency_mhz, name)
    require_same_grid(sky_power.origin, sky_power.frequency_mhz, instrument.frequency_mhz, name)
    policy = Policy()
    known = compute_model_differences(instrument, models) if is_own_sky else None
    # The products are small: threads of the linear algebra would wait for each other.
    with threadpool_limits(1):
        stations = gather_stations(spectra, instrument, sky_power)
        reports = [
            search_station(
                station,
                modes=None if known is None else model_modes(station, known),
                stations=len(stations),
                seed=seed,
                policy=policy,
                progress=progress,
                model=model,
            )
            for station in stations
        ]
    provenance = Provenance(
        inputs={"spectra": spectra.digest(), "instrument": instrument.digest(), "sky_power": sky_power.digest()},
        settings={"policy": policy.as_dict(), "seed": seed, "own_sky": is_own_sky},
    )
    if model.is_plain:
        return describe(reports, provenance), reports
    provenance = replace(provenance, inputs={**provenance.inputs, "model": model.id})
    adopted = [describe_size(size) for report in reports for size in report.adopted]
    return {**describe(reports, provenance), "model": model.to_text(), "adopted": adopted}, reports
