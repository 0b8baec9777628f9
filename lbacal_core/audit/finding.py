"""One line of an audit: what was asked, of whom, the answer and how sure it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

WRONG, UNDECIDED, RIGHT = "wrong", "undecided", "right"


@dataclass(frozen=True)
class Line:
    """One question and its answer.

    Attributes
    ----------
    check
        What was asked: `dead`, `exchange`, `clock`, ...
    verdict
        `wrong`, `right`, or `undecided`: these data cannot say.
    station, antennas, dipole
        The path or paths; no antennas for the whole station, None for both polarisations.
    log_odds
        Natural logarithm of the odds for the answer against the claim on record; None where nothing was compared.
    value, sigma, unit
        Size, where there is one.
    candidates
        Checks of which the data cannot say which one is wrong, where there are several.
    sentence
        The answer in words, and for `undecided` what would decide.
    """

    check: str
    verdict: str
    station: str
    sentence: str
    antennas: tuple[int, ...] = ()
    dipole: str | None = None
    log_odds: float | None = None
    value: float | None = None
    sigma: float | None = None
    unit: str = ""
    candidates: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """The line as JSON values."""
        return {
            "check": self.check,
            "verdict": self.verdict,
            "station": self.station,
            "antennas": list(self.antennas),
            "dipole": self.dipole,
            "log_odds": None if self.log_odds is None else round(self.log_odds, 1),
            "value": None if self.value is None else float(f"{self.value:.4g}"),
            "sigma": None if self.sigma is None else float(f"{self.sigma:.2g}"),
            "unit": self.unit,
            "candidates": list(self.candidates),
            "sentence": self.sentence,
        }
