"""Many station events to backgrounds: resumable, by whatever engine."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from lbacal.engine import HERE, Engine
from lbacal.files import written_beside
from lbacal_core.errors import LbacalError
from lbacal_core.provenance import hash_content
from lbacal_core.traces.assembly import record_background
from lbacal_core.traces.background import CleaningSettings, measure_background
from lbacal_core.traces.trace import StationEvent

Work = tuple[StationEvent, float | None]
"""A station event, and when the particle detectors expect its pulse (s UTC)."""

METHOD = 2
"""Raised when the same traces and settings give other spectra, so that kept parts are made anew."""


class TraceBatch:
    """Station events with a folder in which each finished one leaves its result at once.

    A run that is killed is repeated and finds what was done; a result counts only for the same files (by size and
    time of change), the same settings and the same method.
    """

    def __init__(self, work: Sequence[Work], settings: CleaningSettings, folder: Path) -> None:
        self.work = work
        self.settings = settings
        self.folder = folder

    def run(self, engine: Engine = HERE) -> Iterator[tuple[StationEvent, list[dict[str, Any]] | str, bool]]:
        """Yield every station event with its records, or one sentence why it failed, and whether it was done before.

        The workers of dask read the files themselves, under the same paths.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        waiting = []
        for item in self.work:
            part = self._part(item)
            if part.is_file():
                yield item[0], json.loads(part.read_text()), True
            else:
                waiting.append(item)
        tell = "the work failed on dask: {}".format
        for number, result in engine.spread(reduce_station_event, self.settings, waiting, tell):
            item = waiting[number]
            if not isinstance(result, str):
                with written_beside(self._part(item)) as beside:
                    beside.write_text(json.dumps(result, allow_nan=False))
            yield item[0], result, False

    def _part(self, item: Work) -> Path:
        event, pulse_unix = item
        files = sorted({reference.path for reference in event.references})
        identity = {
            "method": METHOD,
            "event": event.event_id,
            "files": [[str(path.resolve()), path.stat().st_size, path.stat().st_mtime_ns] for path in files],
            "traces": [[reference.dataset, reference.dipole, reference.start_sample] for reference in event.references],
            "frequency_mhz": self.settings.frequency_mhz.tolist(),
            "blocks": self.settings.blocks,
            "resistance_ohm": self.settings.resistance_ohm,
            "pulse_unix": pulse_unix,
        }
        return self.folder / f"{event.event_id}-{event.station}-{hash_content(identity)[:16]}.json"


def reduce_station_event(
    settings: CleaningSettings, event: StationEvent, pulse_unix: float | None
) -> list[dict[str, Any]] | str:
    """Measure one station event: a record of each path as `traces.assembly.record_background` makes it.

    A failure is returned as its sentence, so that one bad file stops nothing.
    """
    try:
        backgrounds = measure_background(event.references, settings, pulse_unix)
    except (LbacalError, OSError) as error:
        return str(error)
    return [record_background(event, background, settings) for background in backgrounds]
