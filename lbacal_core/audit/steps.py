"""Power that steps as no sky does: of all paths at one instant, or between antennas of different cables."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from lbacal_core.audit.antennas import FITS_SIGMA, levels_of_cables
from lbacal_core.audit.station import SKY_HOURS, AuditedStation
from lbacal_core.audit.verdict import WRONG, Line
from lbacal_core.calibration.lines import harmonics_at

STEPPED = "stepped"
LEAST_IN_TIME, LEAST_OF_CABLE = np.log(1.5), np.log(2.0)
"""Ln of the power: the sky does not change by as much in an instant, nor what stands behind a cable by its length."""
SURE_SIGMA = 8.0
FEWEST_BESIDE = 6
"""Instants before and after a step."""
HARMONICS = 3
DECIBEL = 10 / np.log(10)


def find_steps(station: AuditedStation, rows: NDArray[np.int64]) -> list[Line]:
    """Steps of the antennas that are given."""
    return [*_find_in_time(station, rows), *_find_between_cables(station, rows)] if rows.size else []


def _find_in_time(station: AuditedStation, rows: NDArray[np.int64]) -> list[Line]:
    """The instant at which most paths step together, beside what changes with sidereal time."""
    paths = np.nanmean(np.log(station.power[rows]), axis=-1).reshape(-1, station.time_unix.size)
    course = np.nanmedian(paths - np.nanmedian(paths, axis=1, keepdims=True), axis=0)
    known = np.flatnonzero(np.isfinite(course))
    course, time = course[known], station.time_unix[known]
    if course.size < 2 * FEWEST_BESIDE:
        return []
    smooth = np.stack([np.ones(course.size), time - time.mean()], axis=1)
    if station.hours >= SKY_HOURS:
        smooth = harmonics_at(station.lst_hours[known], HARMONICS)
    axes, size, _ = np.linalg.svd(smooth / np.linalg.norm(smooth, axis=0), full_matrices=False)
    axes = axes[:, size > 1e-6 * size[0]]
    splits = np.arange(FEWEST_BESIDE, course.size - FEWEST_BESIDE + 1)
    after = (np.arange(course.size)[:, None] >= splits).astype(float)
    own, rest = after - axes @ (axes.T @ after), course - axes @ (axes.T @ course)
    information = np.maximum(np.sum(own**2, axis=0), 1e-9)
    amount = own.T @ rest / information
    k = int(np.argmax(amount**2 * information))
    left = rest - amount[k] * own[:, k]
    sigma = float(np.std(left)) / information[k] ** 0.5
    beside = left + amount[k] * after[:, k]
    jump = float(np.median(beside[splits[k] :][:FEWEST_BESIDE]) - np.median(beside[: splits[k]][-FEWEST_BESIDE:]))
    if min(abs(amount[k]), 2 * jump * np.sign(amount[k])) < LEAST_IN_TIME or abs(amount[k]) < SURE_SIGMA * sigma:
        return []
    when = datetime.fromtimestamp(float(time[splits[k] - 1 : splits[k] + 1].mean()), UTC)
    sentence = (
        f"the power of all paths steps by {DECIBEL * amount[k]:+.1f} dB about {when:%Y-%m-%d %H:%M} UTC: two chains, "
        "to be fitted separately (--until and --since)"
    )
    return [_tell(STEPPED, station, sentence, float(amount[k]), sigma)]


def _find_between_cables(station: AuditedStation, rows: NDArray[np.int64]) -> list[Line]:
    """The cable whose antennas lie farthest from what its loss and the others say."""
    names, rest, sigma = levels_of_cables(station, rows, np.log(station.power[rows]))
    if names.size == 0:
        return []
    weight = sigma**-2
    others = weight.sum() - weight
    apart, error = rest - (weight @ rest - weight * rest) / others, np.sqrt(sigma**2 + 1 / others)
    k = int(np.argmax(np.abs(apart)))
    if abs(apart[k]) < max(LEAST_OF_CABLE, FITS_SIGMA * error[k]):
        return []
    sentence = f"antennas with the cable {names[k]} lie {DECIBEL * apart[k]:+.1f} dB from what loss and others say"
    return [_tell("cable", station, sentence, float(apart[k]), float(error[k]))]


def _tell(check: str, station: AuditedStation, sentence: str, amount: float, sigma: float) -> Line:
    return Line(check, WRONG, station.name, sentence, value=DECIBEL * amount, sigma=DECIBEL * sigma, unit="dB")
