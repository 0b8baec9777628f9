"""The state of everything on one page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lbacal_core.curves.validity import Instant, Promotion, Scope
from lbacal_core.instrument.instrument import Instrument
from service.storage.database import Database
from service.storage.versions import Version
from service.usecases.calibrations import select_paths


@dataclass(frozen=True)
class StationState:
    """How many paths of a station are calibrated at the last event, and how many of them by their own version.

    A path counts if it has data behind what it is told: its own version, or that of a mean of paths of which it is one.
    `without_data` are told the mean of others.
    """

    name: str
    paths: int
    in_effect: int
    own: int
    without_data: int


@dataclass(frozen=True)
class Overview:
    """Counts, stations, and what changed last."""

    events: int
    first: Instant | None
    last: Instant | None
    open_parts: int
    stations: Sequence[StationState]
    promotions: Sequence[Promotion]
    versions: Sequence[Version]

    @property
    def paths(self) -> int:
        """Paths of the instrument."""
        return sum(station.paths for station in self.stations)

    @property
    def paths_in_effect(self) -> int:
        """Those with data behind the version in effect at the last event."""
        return sum(station.in_effect for station in self.stations)


def look_over(database: Database, instrument: Instrument, clock: Callable[[], Instant], newest: int = 10) -> Overview:
    """Gather the state of everything."""
    paths = select_paths(instrument, None, None, None)
    with database.read() as stores:
        span = stores.spectra.span()
        answers = stores.ledger.answers(paths, clock() if span is None else span[1], None)
        last = {path: said[-1] for path, said in answers.items() if said and said[-1].calibration is not None}
        wide = {str(promotion.calibration) for promotion in last.values() if promotion.scope.antenna is None}
        versions = stores.versions.get_many(wide)
        own = {path for path, promotion in last.items() if promotion.scope.antenna is not None}
        averaged = {
            path for path in last if path not in own and _is_member(versions[str(last[path].calibration)], path)
        }
        stations = []
        for name in sorted({str(path.station) for path in paths}):
            of_station = {path for path in paths if path.station == name}
            with_data = of_station & (own | averaged)
            told = of_station & set(last)
            stations.append(
                StationState(name, len(of_station), len(with_data), len(of_station & own), len(told - with_data))
            )
        return Overview(
            events=stores.spectra.count_events(),
            first=span[0] if span else None,
            last=span[1] if span else None,
            open_parts=stores.jobs.count_open(),
            stations=stations,
            promotions=stores.ledger.recent(newest),
            versions=stores.versions.newest(newest),
        )


def _is_member(version: Version, path: Scope) -> bool:
    """Whether a path is one of those whose mean a version is."""
    chain = version.chains.get(str(path.dipole))
    return chain is not None and (path.station, path.antenna) in chain.member_set
