"""What a client sends: the spectra of whole events as a request body, a spectra file or JSON."""

from __future__ import annotations

import io
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.spectra.spectra import Spectra, write_spectra

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def files_of_events(spectra: Spectra, at_least: int = 1) -> Iterator[tuple[int, int, bytes]]:
    """Whole events as files, with the numbers of their events and spectra; the same spectra make the same bytes.

    Parameters
    ----------
    at_least
        Each file but the last takes events until it holds as many spectra.
    """
    bundle: list[NDArray[np.int64]] = []
    for rows in chain(_rows_of_events(spectra), [None]):
        if bundle and (rows is None or sum(event.size for event in bundle) >= at_least):
            file, chosen = io.BytesIO(), np.concatenate(bundle)
            write_spectra(spectra.select(chosen), file)
            yield len(bundle), chosen.size, file.getvalue()
            bundle = []
        if rows is not None:
            bundle.append(rows)


def bodies_of_events(spectra: Spectra) -> Iterator[dict[str, Any]]:
    """The spectra of each event as JSON values, for clients without HDF5."""
    for rows in _rows_of_events(spectra):
        yield {
            "frequency_mhz": spectra.frequency_mhz.tolist(),
            "resistance_ohm": spectra.resistance_ohm,
            "spectra": [_describe(spectra, k) for k in rows.tolist()],
        }


def _rows_of_events(spectra: Spectra) -> Iterator[NDArray[np.int64]]:
    """The rows of each event, in order of the events' first times."""
    if len(spectra) == 0:
        return
    names, code = spectra.key_codes["event_id"]
    first = np.full(names.size, np.inf)
    np.minimum.at(first, code, spectra.time_unix)
    order = np.lexsort((code, first[code]))
    edges = np.flatnonzero(np.diff(code[order])) + 1
    yield from np.split(order, edges)


def _describe(spectra: Spectra, k: int) -> dict[str, Any]:
    env = {name: float(values[k]) for name, values in spectra.environment.items() if np.isfinite(values[k])}
    time_utc = EPOCH + timedelta(microseconds=round(float(spectra.time_unix[k]) * 1e6))
    return {
        "event_id": str(spectra.event_id[k]), "time_utc": time_utc.isoformat().replace("+00:00", "Z"),
        "station": str(spectra.station[k]), "antenna": int(spectra.antenna[k]), "dipole": str(spectra.dipole[k]),
        "blocks": int(spectra.blocks[k]), "power": spectra.power[k].tolist(), **({"env": env} if env else {}),
    }  # fmt: skip
