"""Antennas whose cable is not the one on record: level and slope against every cable that the instrument has."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lbacal_core.audit.finding import WRONG, Line
from lbacal_core.audit.health import CLASS, Comparison
from lbacal_core.audit.series import as_power
from lbacal_core.audit.station import AuditedStation, spread
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument

LEAST_LOG_ODDS = np.log(1e4)
"""One antenna in a hundred has a wrong entry at most, and every other cable name is tried for each."""
FITS_SIGMA = 4.0
"""The cable that is named must describe the antenna within this many standard deviations."""
MEDIAN = np.pi / 2
"""Variance of a median of n values times n."""
BEHIND_CABLE = 0.2
"""Share of the loss that noise behind the cable hides, at most."""
SKY_INDEX = -0.55
"""Exponent of P_sky along frequency, W m^-2 MHz^-1: that of the brightness (-2.55; Mozdzen et al. 2019) plus 2."""
CORRECTION, BANDS, BAND_SAYS = 0.7, 4, 1.5
"""Ln A(nu), what nobody knows of antenna gains: a factor 2, independent in as many parts of the band; and the most that
one of them says: spectra from which the pass band was divided out exist."""
SMALLEST = np.array([0.03, 0.01])
"""Scatter of level and slope that working antennas have at least: 3-5 % of gain (station gain tables of 2013)."""


def find_wrong_cables(
    station: AuditedStation, comparison: Comparison, instrument: Instrument
) -> tuple[list[Line], dict[int, str]]:
    """Name antennas that another cable describes far better; and the cable of each, by its row.

    A cable name that other antennas have is represented by their median: it holds the noise behind the cable too. Where
    none has it, its loss must do, with what that noise hides of the loss as an error.
    """
    axis = station.frequency_mhz - station.frequency_mhz.mean()
    axis = axis / np.sqrt(np.mean(axis**2)) if axis.size > 1 else axis
    recorded = np.nanmedian(np.log(station.power), axis=2)
    sigma = np.maximum(spread(_level_and_slope(comparison.level[..., None] + comparison.profile, axis)), SMALLEST)
    distances = {}
    for name, loss in instrument.cables.items():
        rows = station.cables == name
        lost = np.log(station.loss / loss)[:, None, :]
        expected = comparison.level[..., None] + comparison.profile + lost
        if not rows.any():
            distances[name] = _distance(expected, axis, np.hypot(sigma, BEHIND_CABLE * _level_and_slope(lost, axis)))
            continue
        of_others = _distance(recorded - np.nanmedian(recorded[rows], axis=0), axis, sigma) / (1 + MEDIAN / rows.sum())
        distances[name] = np.where(rows & (rows.sum() < CLASS), _distance(expected, axis, sigma), of_others)
    lines = []
    found = {}
    for a, own in enumerate(station.cables):
        best = min((name for name in distances if name != own), key=lambda name: distances[name][a], default=None)
        if best is None or not np.isfinite(distances[best][a]):
            continue
        odds = float(distances[own][a] - distances[best][a]) / 2
        if odds < LEAST_LOG_ODDS or distances[best][a] > FITS_SIGMA**2:
            continue
        found[a] = best
        sentence = f"antenna {station.antennas[a]} has the cable {best}, not {own} as on record"
        lines.append(Line("cable", WRONG, station.name, sentence, antennas=(int(station.antennas[a]),), log_odds=odds))
    return lines, found


def _distance(difference: Floats, axis: Floats, sigma: Floats) -> Floats:
    """Squared distance of level and slope in standard deviations (shape (2,) or (antenna, 2)), shape (antenna,)."""
    return np.asarray(np.sum((_level_and_slope(difference, axis) / sigma) ** 2, axis=1))


def _level_and_slope(difference: Floats, axis: Floats) -> Floats:
    """Mean over both polarisations of ln P, and its slope along frequency; shape (antenna, 2)."""
    seen = np.nanmean(difference, axis=1)
    return np.stack([seen.mean(axis=-1), seen @ axis / axis.size], axis=-1)


def fits_cables(station: AuditedStation, rows: NDArray[np.int64], unit: str) -> bool:
    """Whether values in a unit differ between cable names as cables do, and not only better than power does."""
    return _of_cables(station, rows, np.log(as_power(station.power[rows], unit))) > -(FITS_SIGMA**2) / 2


def log_likelihood_of_unit(
    station: AuditedStation, rows: NDArray[np.int64], unit: str, instrument: Instrument
) -> float:
    """Ln L that recorded values are in a unit, by how cable names differ and by how the power runs along frequency.

    A longer cable takes from the power, in dB; and the power runs as the sky does, through antenna and receiver.
    """
    power = np.log(as_power(station.power[rows], unit))
    return _of_cables(station, rows, power) + _of_spectrum(station, rows, power, instrument)


def _of_spectrum(station: AuditedStation, rows: NDArray[np.int64], power: Floats, instrument: Instrument) -> float:
    """Ln L of the median spectrum of the antennas, shape (antenna, dipole, time, freq), but for its level."""
    expected = np.log(instrument.antenna_gain * instrument.receiver_gain)
    expected = expected + SKY_INDEX * np.log(station.frequency_mhz)
    rest = np.nanmedian(power - np.log(station.loss[rows])[:, None, None, :], axis=(0, 1, 2)) - expected
    rest -= rest.mean()
    bands = [float(np.mean(band**2)) for band in np.array_split(rest, BANDS) if band.size]
    return -float(np.sum(np.minimum(np.array(bands) / (2 * CORRECTION**2), BAND_SAYS)))


def _of_cables(station: AuditedStation, rows: NDArray[np.int64], power: Floats) -> float:
    """Ln L of the levels of cable names; 0 where the antennas have one."""
    _, rest, sigma = levels_of_cables(station, rows, power)
    return float(-np.sum((rest / sigma) ** 2) / 2)


def levels_of_cables(
    station: AuditedStation, rows: NDArray[np.int64], power: Floats
) -> tuple[NDArray[np.str_], Floats, Floats]:
    """Cable names, ln P of their antennas over what loss and the other names say, and its error; none of one name."""
    level = np.nanmedian(np.nanmean(power, axis=1), axis=(1, 2))
    expected = np.log(station.loss[rows]).mean(axis=-1)
    names, name_at = np.unique(station.cables[rows], return_inverse=True)
    if names.size == 1:
        return names[:0], np.zeros(0), np.ones(0)
    seen = np.array([np.nanmedian(level[name_at == k]) for k in range(names.size)])
    count = np.bincount(name_at)
    scatter = max(float(spread(level - seen[name_at])), SMALLEST[0])
    loss = np.array([expected[name_at == k][0] for k in range(names.size)])
    variance = MEDIAN * scatter**2 / count + (BEHIND_CABLE * (loss - loss.mean())) ** 2
    return names, (seen - loss) - np.average(seen - loss, weights=1 / variance), np.sqrt(variance)
