"""What adopted causes gain on events that their adoption had not seen, measured by every later refit of the station."""

from __future__ import annotations

from collections.abc import Mapping

from lbacal.instants import SECOND_US
from lbacal_core.calibration.windows import leave_out_changed
from lbacal_core.causes.model import Model
from lbacal_core.curves.validity import Instant
from lbacal_core.discovery.adopted import measure_gains
from lbacal_core.discovery.calibrate import FittedCauses
from lbacal_core.simulation.simulation import Simulation
from service.storage.database import Stores
from service.storage.models import ADOPTED, Gain
from service.usecases.fits import Wanted


def find_known_until(stores: Stores, wanted: Wanted) -> dict[str, Instant]:
    """The newest event that the adoption of each cause had seen, by the id of the cause; empty for other scopes."""
    if wanted.scope != "station" or wanted.model.is_plain:
        return {}
    changes = stores.models.changes(wanted.of.station)
    return {one.cause: one.known_until for one in changes if one.act == ADOPTED and one.known_until is not None}


def measure_payoff(
    whole: FittedCauses, wanted: Wanted, known_until: Mapping[str, Instant], simulation: Simulation, now: Instant
) -> list[Gain]:
    """The gain of every adopted cause on the events of a window that are new to it, its size as it was adopted."""
    found = list[Gain]()
    spectra = leave_out_changed(whole.recorded, simulation.instrument) if known_until else None
    if spectra is None:
        return found
    names = [Model((cause,)).id for cause in whole.model.causes]
    for last in sorted({known_until[name] for name in names if name in known_until}):
        is_new = spectra.time_unix > last / SECOND_US
        if not (is_new.any() and whole.stations):
            continue
        measured = measure_gains(spectra, simulation.with_causes(whole.model), is_new)
        found += [
            Gain(
                names[one.number], str(wanted.of.station), wanted.since, wanted.until, one.events, one.gain,
                one.expected, one.expected_sigma, now,
            )
            for one in measured
            if known_until.get(names[one.number]) == last
        ]  # fmt: skip
    return found
