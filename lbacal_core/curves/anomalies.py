"""Spectra whose power is anomalous, as they are named to people: in reports, on pages and by the gate."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

MOST_NAMED = 100
"""A summary names this many spectra and counts the others."""


@dataclass(frozen=True)
class Anomaly:
    """One spectrum that is off, by which factor, and what became of it.

    Attributes
    ----------
    factor
        Recorded power over the path's usual power at that LST.
    frequency_mhz
        The channel that is off, where it is not the whole band.
    kept
        Why it is fitted nevertheless; None where it is left out.
    """

    event_id: str
    station: str
    antenna: int
    dipole: str
    factor: float
    frequency_mhz: float | None = None
    kept: str | None = None

    @property
    def path(self) -> str:
        """The path as scopes are written: ``CS002/17/X``."""
        return f"{self.station}/{self.antenna}/{self.dipole}"

    @property
    def reason(self) -> str:
        """What is anomalous, in words."""
        where = "" if self.frequency_mhz is None else f" at {self.frequency_mhz:g} MHz"
        return f"power {self.factor:.3g} times the usual{where}" + (f"; fitted: {self.kept}" if self.kept else "")

    @property
    def departure(self) -> float:
        """The size of the logarithm of the factor."""
        return abs(math.log(self.factor))

    def as_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {**vars(self), "reason": self.reason}


@dataclass(frozen=True)
class Anomalies:
    """How many anomalous spectra were left out of a fit and how many were fitted, and the worst of both."""

    left_out: int
    fitted: int
    worst: Sequence[Anomaly]

    @classmethod
    def of(cls, found: Iterable[Anomaly]) -> Anomalies:
        """Summarise what was found."""
        ranked = sorted(found, key=lambda one: (-one.departure, one.event_id, one.path))
        fitted = sum(one.kept is not None for one in ranked)
        return cls(len(ranked) - fitted, fitted, tuple(ranked[:MOST_NAMED]))

    def as_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {"left_out": self.left_out, "fitted": self.fitted, "worst": [one.as_dict() for one in self.worst]}

    def name_worst(self, count: int) -> str:
        """The worst few in words; empty where there are none."""
        return ", ".join(f"{one.event_id} of {one.path} ({one.reason})" for one in self.worst[:count])


NONE = Anomalies(0, 0, ())


def parse_anomalies(content: Mapping[str, Any]) -> Anomalies:
    """Make a summary from its JSON values."""
    worst = [Anomaly(**{name: one[name] for name in Anomaly.__dataclass_fields__}) for one in content["worst"]]
    return Anomalies(content["left_out"], content["fitted"], tuple(worst))
