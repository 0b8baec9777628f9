"""Antennas whose dipoles bear each other's letter, against the others of their station.

ln P_X - ln P_Y changes with sidereal time alike for all antennas; of an exchanged one it changes the other way round.
Where the data are too short for that its value itself must do: the sky is not equally bright in both polarisations,
and gains of dipoles scatter by a few per cent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.audit.finding import UNDECIDED, WRONG, Line
from lbacal_core.audit.station import AuditedStation, spread
from lbacal_core.grids import Floats

CERTAIN = np.log(1e3)
"""Odds of 1000 to 1 either way; between them the data cannot say."""
FEWEST_TIMES = 3
PAIR = 2
"""Dipoles of an antenna whose letters can be told apart by their ratio; of one or three the sky alone can tell."""
ABOVE_NOISE = 1.5
"""Singular value of a common change over the largest that noise alone has, sigma (sqrt(antennas) + sqrt(times))."""
SMALLEST_SCATTER = 0.03
"""Scatter of ln P_X - ln P_Y from antenna to antenna at least."""
TAIL = 4.0
"""Degrees of freedom of Student's t."""
SMALLEST_SLOPE_ERROR = 0.1
"""Antennas do not follow the median closer than this: coupling between neighbours, sky noise."""


@dataclass(frozen=True)
class ExchangeOdds:
    """Log odds that the dipoles of an antenna bear each other's letter against most of the station.

    Attributes
    ----------
    rows
        Rows of the antennas that were compared.
    odds
        Shape (antenna,) of these; which of the two groups is right, the sky decides.
    """

    rows: NDArray[np.int64]
    odds: Floats

    def exchanged(self) -> NDArray[np.int64]:
        """Rows of the antennas that differ from most."""
        return np.asarray(self.rows[self.odds > CERTAIN])

    def flipped(self) -> ExchangeOdds:
        """The same, if most of the station is exchanged."""
        return ExchangeOdds(self.rows, -self.odds)


def compare_polarisations(station: AuditedStation, is_usable: NDArray[np.bool_]) -> ExchangeOdds:
    """Sort the antennas into those that agree with most of the station and those that are exchanged against it.

    Parameters
    ----------
    is_usable
        Shape (antenna,): both dipoles work.
    """
    rows = np.flatnonzero(is_usable)
    if rows.size == 0 or len(station.dipoles) != PAIR:
        return ExchangeOdds(rows, np.zeros(0))
    ratio = np.nanmean(np.log(station.power[rows, 0]) - np.log(station.power[rows, 1]), axis=-1)
    odds, sign = _odds_of_changes(ratio)
    odds += _odds_of_values(ratio, sign)
    return ExchangeOdds(rows, odds if np.sum(odds > 0) <= rows.size / 2 else -odds)


def tell_exchanged(station: AuditedStation, exchange: ExchangeOdds) -> list[Line]:
    """The exchanged antennas, and those of which these data cannot say."""
    lines: list[Line] = []
    if len(station.dipoles) != PAIR:
        return lines
    exchanged = exchange.exchanged()
    if exchanged.size:
        found = tuple(int(a) for a in station.antennas[exchanged])
        sentence = f"X and Y are exchanged at {_list_antennas(found)}{_describe(station, exchange)}"
        least = float(exchange.odds[exchange.odds > CERTAIN].min())
        lines.append(Line("exchange", WRONG, station.name, sentence, antennas=found, log_odds=least))
    unknown = np.abs(exchange.odds) <= CERTAIN
    if unknown.any():
        silent = tuple(int(a) for a in station.antennas[exchange.rows[unknown]])
        sentence = f"{station.length} not tell X from Y at {_list_antennas(silent)}; some hours would"
        likeliest = float(exchange.odds[unknown].max())
        lines.append(Line("exchange", UNDECIDED, station.name, sentence, antennas=silent, log_odds=likeliest))
    return lines


def _odds_of_changes(ratio: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Log odds, shape (antenna,), of the group of the fewer; and who runs with the strongest common change.

    Parameters
    ----------
    ratio
        Shape (antenna, time). The common change is its first principal component, which does not care how many run
        against it.
    """
    own = ratio - np.nanmean(ratio, axis=1, keepdims=True)
    own = np.where(np.isfinite(own), own, 0.0)
    if ratio.shape[1] < FEWEST_TIMES or not own.any():
        return np.zeros(ratio.shape[0]), np.ones(ratio.shape[0], dtype=bool)
    loadings, strengths, changes = np.linalg.svd(own, full_matrices=False)
    rest = own - strengths[0] * np.outer(loadings[:, 0], changes[0])
    noise = float(np.median(spread(rest, axis=1)))
    if strengths[0] < ABOVE_NOISE * noise * (own.shape[0] ** 0.5 + own.shape[1] ** 0.5):
        return np.zeros(ratio.shape[0]), np.ones(ratio.shape[0], dtype=bool)
    typical = float(np.median(np.abs(loadings[:, 0])))
    slope = loadings[:, 0] / typical
    scatter = float(spread(np.abs(slope)))
    error = np.hypot(max(SMALLEST_SLOPE_ERROR, scatter), noise / (typical * strengths[0]))
    return np.asarray(-2.0 * slope / error**2), slope > 0


def _odds_of_values(ratio: Floats, is_with: NDArray[np.bool_]) -> Floats:
    """Log odds that the mean in time has the other sign, of gains that scatter as those of the station do.

    The scatter is that of Student's t: one odd gain in a hundred antennas is no exchanged one.
    """
    mean = np.nanmean(ratio, axis=1)
    sign = np.where(is_with, 1.0, -1.0)
    typical = float(np.nanmedian(sign * mean))
    error = max(float(spread(sign * mean)), SMALLEST_SCATTER)

    def penalty(expected: float) -> Floats:
        return np.asarray((TAIL + 1) / 2 * np.log1p(((mean - expected) / error) ** 2 / TAIL))

    return penalty(typical) - penalty(-typical)


def _describe(station: AuditedStation, exchange: ExchangeOdds) -> str:
    """Whether they are just the even or the odd antennas: then it is a whole antenna field."""
    parity = station.antennas % 2
    for value, word in ((0, "even"), (1, "odd")):
        of_field = exchange.rows[parity[exchange.rows] == value]
        if of_field.size > 1 and np.array_equal(exchange.exchanged(), of_field):
            return f": all {word} antennas, an antenna field whose inputs are wired the other way round"
    return ""


def _list_antennas(numbers: tuple[int, ...]) -> str:
    shown = ", ".join(str(number) for number in numbers[:8])
    more = f" and {len(numbers) - 8} more" if len(numbers) > 8 else ""
    return f"antenna{'s' if len(numbers) > 1 else ''} {shown}{more}"
