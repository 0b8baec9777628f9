"""Backgrounds of many station events to one `Spectra`, and the facts that came with them."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lbacal_core.errors import BadInputError
from lbacal_core.foreign import parse_cell, read_text
from lbacal_core.grids import Floats
from lbacal_core.spectra.blocks import SpectraBlock, split_into_blocks
from lbacal_core.spectra.screening import (
    CUT_SIGMA,
    FEWEST_EVENTS,
    SMALLEST_DEPARTURE,
    predict_daily_variation,
    robust_sigma,
)
from lbacal_core.spectra.spectra import Spectra, lay_out_rows
from lbacal_core.traces.background import CleaningSettings, PathBackground
from lbacal_core.traces.trace import StationEvent

COVARIATES = ("temperature_c", "rain_mm_h")


@dataclass(frozen=True)
class EventFacts:
    """Facts of events besides their traces: the time of the cosmic ray, and the weather.

    Attributes
    ----------
    pulse_unix
        By event id: instant expected by the particle detectors, s UTC.
    environment
        By event id and covariate (`temperature_c`, `rain_mm_h`).
    """

    pulse_unix: Mapping[str, float] = field(default_factory=dict)
    environment: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


def read_event_facts(path: Path) -> EventFacts:
    """Read a CSV with the columns event_id and any of pulse_unix, temperature_c, rain_mm_h; empty means unknown."""
    lines = [line for line in read_text(path).splitlines() if line.strip() and not line.startswith("#")]
    reader = csv.DictReader(lines)
    known = {"event_id", "pulse_unix", *COVARIATES}
    columns = set(reader.fieldnames or ())
    if "event_id" not in columns or not columns <= known:
        raise BadInputError(
            str(path), "event_id and any of pulse_unix, temperature_c, rain_mm_h", ", ".join(sorted(columns))
        )
    pulses: dict[str, float] = {}
    environment: dict[str, dict[str, float]] = {}
    for number, row in enumerate(reader, start=1):
        values = {name: parse_cell(row[name], f"{path}: {name}, row {number}") for name in columns - {"event_id"}}
        event = row["event_id"]
        if np.isfinite(values.get("pulse_unix", np.nan)):
            pulses[event] = values["pulse_unix"]
        environment[event] = {name: values[name] for name in COVARIATES if name in values}
    return EventFacts(pulses, environment)


def record_background(event: StationEvent, background: PathBackground, settings: CleaningSettings) -> dict[str, Any]:
    """The record of one path in one event, its power included, as JSON values (docs/formats/raw-traces.md)."""
    reference = background.reference
    low = settings.frequency_mhz[0] - settings.width_mhz / 2
    high = settings.frequency_mhz[-1] + settings.width_mhz / 2
    in_band = (background.channel_mhz >= low) & (background.channel_mhz <= high)
    lines = background.line_mhz[(background.line_mhz >= low) & (background.line_mhz <= high)]
    return {
        "event_id": event.event_id,
        "station": reference.station,
        "rcu": reference.rcu,
        "antenna": reference.antenna,
        "dipole": reference.dipole,
        "antenna_set": reference.antenna_set,
        "file": reference.path.name,
        "time_unix": reference.time_unix,
        "sample_rate_hz": reference.sample_rate_hz,
        "blocks": background.blocks,
        "rms_adc": background.rms,
        "dropped_blocks": dict(background.dropped),
        "faults": dict(background.faults),
        "pulse_blocks": list(background.pulses),
        "line_mhz": [round(float(line), 4) for line in lines],
        "flagged_fraction": float(np.mean(background.is_flagged[in_band])),
        "filled_mhz": settings.frequency_mhz[background.is_filled].tolist(),
        "excluded": background.excluded,
        "power": [] if background.excluded else background.power.tolist(),
    }


def assemble_spectra(records: Sequence[Mapping[str, Any]], settings: CleaningSettings, facts: EventFacts) -> Spectra:
    """Lay the records of usable backgrounds out as spectra, in order of time, station and receiver."""
    usable = [record for record in records if not record["excluded"]]
    usable.sort(key=lambda record: (record["time_unix"], record["station"], record["rcu"]))
    environment = {}
    for name in COVARIATES:
        of_event = {event: values[name] for event, values in facts.environment.items() if name in values}
        if of_event:
            environment[name] = np.array([of_event.get(record["event_id"], np.nan) for record in usable], dtype=float)
    return Spectra(
        frequency_mhz=np.array(settings.frequency_mhz),
        **lay_out_rows(usable, settings.frequency_mhz.size),
        resistance_ohm=settings.resistance_ohm,
        environment=environment,
        origin="traces",
    )


# Events with anomalous power, and why: thunderstorms, failing receivers, saturation (section 3.1 of the paper).
#
# Each path's band power is compared with its own median after the sky's daily variation, common to a station's dipoles
# of one polarisation, has been taken out. The residual scatters by about 5 % (gain from event to event); an event or
# path that is off by more than `CUT_SIGMA` robust standard deviations, and by at least a fifth, is left out.


def find_anomalous_spectra(spectra: Spectra, longitude_deg: float) -> dict[tuple[str, str, int, str], str]:
    """Find spectra whose power is anomalous: (event_id, station, antenna, dipole) to the reason."""
    reasons: dict[tuple[str, str, int, str], str] = {}
    for block in split_into_blocks(spectra):
        if block.power.shape[1] < FEWEST_EVENTS:
            continue
        departure = power_departure(block, longitude_deg)
        of_event = np.nanmedian(departure, axis=0)
        of_path = departure - of_event
        for values, words in ((of_event[None, :], "the station's"), (of_path, "this path's")):
            spread = float(robust_sigma(values.reshape(1, -1))[0])
            is_off = np.abs(np.nan_to_num(values)) > max(CUT_SIGMA * spread, SMALLEST_DEPARTURE)
            for antenna, event in zip(*np.nonzero(np.broadcast_to(is_off, departure.shape)), strict=True):
                if block.is_present[antenna, event]:
                    factor = float(np.exp(np.broadcast_to(values, departure.shape)[antenna, event]))
                    key = (str(block.event_id[event]), block.station, int(block.antennas[antenna]), block.dipole)
                    reasons.setdefault(key, f"anomalous power: {words} is {factor:.2f} times the usual")
    return reasons


def power_departure(block: SpectraBlock, longitude_deg: float) -> Floats:
    """Logarithm of band power over the path's median and the station's daily variation, shape (antenna, event)."""
    level = np.where(block.is_present, np.log(np.median(block.power, axis=2)), np.nan)
    level = level - np.nanmedian(level, axis=1)[:, None]
    common = np.nanmedian(level, axis=0)
    everywhere = np.ones((1, common.size), dtype=bool)
    return np.asarray(level - predict_daily_variation(common[None], block.time_unix, everywhere, longitude_deg))
