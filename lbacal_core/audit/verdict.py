"""What is concluded from the likelihoods of a record and of everything that may be wrong in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lbacal_core.audit.finding import RIGHT, UNDECIDED, WRONG, Line

LEAST_GAIN = 10.0
"""ln L by which another possibility must be better than what is on record: odds of 150 after prior odds of 1 in 150."""
ALIKE = 5.0
"""Possibilities whose ln L differ by less cannot be told apart."""
RIGHT_ANGLE, NEAR_RIGHT = 90.0, 10.0
SAME_SIGMAS, SAME_H = 2.5, 1 / 30
"""A size this near to that of a fault that has none is this fault: nothing else puts it just there."""
TELLING = {"clock": 1.0, "arms": 20.0}
"""Errors (h, deg) above which data cannot be said to confirm a clock or arms."""
ZONE_SIGMA_H = 0.1
"""A clock must be known this well before its error is called that of a time zone."""
RECORD = "record"
_CHECKS = {
    "latitude sign": "place",
    "longitude sign": "place",
    "latitude for longitude": "place",
    "dB": "unit",
    "volt": "unit",
}


@dataclass(frozen=True)
class Possibility:
    """One way in which a record may differ from what was seen.

    Attributes
    ----------
    log_likelihood
        Averaged over all sizes that the possibility may have.
    value, sigma
        Size of a clock (h) or of turned arms (deg); of a place, the clock that would look like it (h).
    """

    kind: str
    log_likelihood: float
    value: float | None = None
    sigma: float | None = None

    @property
    def check(self) -> str:
        """Which question of the audit it answers."""
        return _CHECKS.get(self.kind, self.kind)

    def is_chance_of(self, other: Possibility) -> bool:
        """Whether its size is just that which another possibility, which has no free size, explains."""
        value, sigma = self.value or 0.0, self.sigma or 0.0
        if self.kind == "arms" and other.kind == "exchange":
            return RIGHT_ANGLE - abs(value) < max(NEAR_RIGHT, SAME_SIGMAS * sigma)
        if self.kind == "clock" and other.check == "place" and other.value:
            return abs(value - other.value) < max(SAME_H, SAME_SIGMAS * sigma)
        return False


def conclude(station: str, base: float, possibilities: Sequence[Possibility]) -> list[Line]:
    """What is wrong, if anything; else what the data confirm.

    Parameters
    ----------
    base
        ln L of the record.
    """
    best = max(possibilities, key=lambda one: one.log_likelihood)
    gain = best.log_likelihood - base
    if gain < LEAST_GAIN:
        return [_confirm(station, one, base) for one in possibilities if one.kind in TELLING]
    near = [one for one in possibilities if best.log_likelihood - one.log_likelihood < ALIKE]
    alike = [one for one in near if not any(one.is_chance_of(other) for other in near)]
    alike.sort(key=lambda one: -one.log_likelihood)
    if len({one.check for one in alike}) > 1:
        words = "; or ".join(describe(one) for one in alike)
        sentence = f"the record is wrong, and these data do not say where: {words}; a sidereal day would"
        kinds = tuple(dict.fromkeys(one.check for one in alike))
        return [Line(RECORD, WRONG, station, sentence, log_odds=gain, candidates=kinds)]
    best = alike[0]
    sentence = "; or ".join(describe(one) for one in alike)
    unit = {"clock": "h", "arms": "deg"}.get(best.kind, "")
    value = best.value if unit else None
    return [Line(best.check, WRONG, station, sentence, log_odds=gain, value=value, sigma=best.sigma, unit=unit)]


def describe(one: Possibility) -> str:
    """A possibility in words."""
    value, sigma = one.value or 0.0, one.sigma or 0.0
    if one.kind == "clock":
        words = f"sidereal time is {60 * value:+.0f} +- {60 * sigma:.0f} min from that of clock and longitude on record"
        zone = round(-value)
        if zone and sigma < ZONE_SIGMA_H and abs(value + zone) < max(SAME_H, SAME_SIGMAS * sigma):
            words += f" (times as of UTC{zone:+d} would be)"
        return words
    if one.kind == "arms":
        return f"both arms are turned by {value:+.0f} +- {sigma:.0f} deg (north through east) from the record"
    return {
        "exchange": "X and Y are exchanged at every antenna, or both arms are turned by 90 deg",
        "latitude sign": "the latitude has the wrong sign",
        "longitude sign": "the longitude has the wrong sign",
        "latitude for longitude": "latitude and longitude are exchanged",
        "dB": "the power is in decibels",
        "volt": "the power is an amplitude (volts), not its square",
    }[one.kind]


def _confirm(station: str, one: Possibility, base: float) -> Line:
    """Whether the data confirm a clock or arms, and how well."""
    value, sigma = one.value or 0.0, one.sigma or float("inf")
    unit = {"clock": "h", "arms": "deg"}[one.kind]
    if not sigma < TELLING[one.kind]:
        return Line(one.kind, UNDECIDED, station, f"these hours do not determine the {one.kind}; a whole day would")
    words = describe(one) if one.kind == "clock" else f"the arms are {value:+.0f} +- {sigma:.0f} deg from the record"
    return Line(
        one.kind, RIGHT, station, words, log_odds=one.log_likelihood - base, value=value, sigma=sigma, unit=unit
    )
