"""The state of everything on one page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lbacal_core.instrument import Instrument
from lbacal_core.validity import Instant, Promotion
from service.storage.database import Database
from service.storage.versions import Version
from service.usecases.calibrations import select_paths


@dataclass(frozen=True)
class StationState:
    """How many paths of a station are calibrated at the last event, and how many of them by their own version."""

    name: str
    paths: int
    in_effect: int
    own: int


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
        """Those for which a version is in effect at the last event."""
        return sum(station.in_effect for station in self.stations)


def look_over(database: Database, instrument: Instrument, clock: Callable[[], Instant], newest: int = 10) -> Overview:
    """Gather the state of everything."""
    paths = select_paths(instrument, None, None, None)
    with database.read() as stores:
        span = stores.spectra.span()
        answers = stores.ledger.answers(paths, clock() if span is None else span[1], None)
        stations = []
        for name in sorted({str(path.station) for path in paths}):
            said = [answers[path] for path in paths if path.station == name]
            decisive = [asked[-1] for asked in said if asked and asked[-1].calibration is not None]
            own = sum(promotion.scope.level == "antenna" for promotion in decisive)
            stations.append(StationState(name, len(said), len(decisive), own))
        return Overview(
            events=stores.spectra.count_events(),
            first=span[0] if span else None,
            last=span[1] if span else None,
            open_parts=stores.jobs.count_open(),
            stations=stations,
            promotions=stores.ledger.recent(newest),
            versions=stores.versions.newest(newest),
        )
