"""Files and folders to station events: which traces were taken together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.traces.frames import list_frame_traces, read_frame_trace
from lbacal_core.traces.hdf5 import list_hdf5_traces, read_hdf5_trace
from lbacal_core.traces.trace import Trace, TraceReference

SUFFIXES = (".h5", ".hdf5", ".dat")
EVENT_SPAN_S = 0.5
"""Traces that start within this of the first one belong to one event: the buffers hold seconds, dumps start apart by
microseconds (dipoles) to milliseconds (stations), and triggers are minutes apart."""


@dataclass(frozen=True)
class StationEvent:
    """The traces of one station in one event: the unit of work, and of memory."""

    event_id: str
    station: str
    references: tuple[TraceReference, ...]

    @property
    def name(self) -> str:
        """The event and station in words."""
        return f"{self.event_id} {self.station}"


def list_traces(path: Path, antenna_set: str | None = None) -> list[TraceReference]:
    """Find the traces in one file; `antenna_set` overrides that of the file."""
    if not path.is_file():
        raise UnreadableFileError(f"{path}: no such file")
    if path.stat().st_size == 0:
        raise UnreadableFileError(f"{path}: expected raw traces, found an empty file")
    is_hdf5 = h5py.is_hdf5(path) or path.suffix in (".h5", ".hdf5")
    return list_hdf5_traces(path, antenna_set) if is_hdf5 else list_frame_traces(path, antenna_set)


def read_trace(reference: TraceReference) -> Trace:
    """Read the samples of one trace."""
    return read_frame_trace(reference) if reference.dataset.isdigit() else read_hdf5_trace(reference)


def find_files(paths: Iterable[Path]) -> list[Path]:
    """Files as given, and those below folders that could hold traces, in order of name."""
    files: list[Path] = []
    for path in paths:
        if path.is_dir():
            files += sorted(file for file in path.rglob("*") if file.is_file() and file.suffix in SUFFIXES)
        else:
            files.append(path)
    return list(dict.fromkeys(files))


def name_event(time_unix: float) -> str:
    """Event id from the UTC second in which the event starts: 20110719T110541."""
    return f"{datetime.fromtimestamp(int(time_unix), UTC):%Y%m%dT%H%M%S}"


def group_traces(references: Sequence[TraceReference], event_id: str | None = None) -> list[StationEvent]:
    """Sort traces into events and stations.

    An event is named after its first trace, so one that crosses a full second keeps one name as long as its files are
    given together.
    """
    order = np.argsort([reference.time_unix for reference in references], kind="stable")
    groups: dict[tuple[str, str], list[TraceReference]] = {}
    start = -np.inf
    for k in order:
        reference = references[k]
        if reference.time_unix - start > EVENT_SPAN_S:
            start = reference.time_unix
        key = (event_id or name_event(start), reference.station)
        groups.setdefault(key, []).append(reference)
    events = []
    for (event, station), members in groups.items():
        members.sort(key=lambda reference: reference.rcu)
        for left, right in pairwise(members):
            if left.rcu == right.rcu:
                place = f"event {event}, {station}, RCU {left.rcu}"
                raise BadInputError(place, "one trace", f"{left.path.name} and {right.path.name}")
        events.append(StationEvent(event, station, tuple(members)))
    return events
