"""The reference chain: what a curve of a station or of the array belongs to, and how it applies to a path's own cable.

The mean power of paths p is that of one chain, the reference chain, whose slope is the mean of theirs (eq. full_chain):

    s_ref = mean(s_p) = G_ant mean((A g)_p L_p) G_RCU S,        C_ref^2 = G_ant / s_ref.

No path is that chain, because cables differ. With L_ref = mean(L_p) over exactly the paths that were averaged,

    s_p = s_ref (L_p / L_ref) (1 + d_p),        C_p = C_ref (L_ref / L_p)^1/2 (1 + d_p)^-1/2.

The first factor is known from the cable table and is applied. The departure d_p of the power gain A g of the path from
the reference chain's is not known of a path that was not fitted by itself: its mean and its spread among the paths with
the same cable, measured where single paths were fitted, are an error of C_p of half their size. Since C is convex in
power, the mean of C_p lies above C_ref (L_ref / L_p)^1/2 by 3/8 of the variance of d (Jensen's inequality), which is
stated and is part of the measured offset. N_LNA and the noise at the output, N_RCU G_RCU S and N_ADC, are those of the
reference chain; referred to the input they follow with s_p.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Self

import numpy as np

from lbacal_core.grids import Floats
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.provenance import as_json, hash_content, with_arrays

JENSEN = 3.0 / 8.0
"""The mean of (1 + d)^-1/2 less 1, over the variance of d, to second order."""


@dataclass(frozen=True)
class CableTable:
    """Which antenna has which cable when, and what each cable loses: the part of an instrument that conversion uses.

    Attributes
    ----------
    cables
        L_coax by cable name, shape (freq,), the factor <= 1 that multiplies the power.
    """

    cables: Mapping[str, Floats]
    antennas: Sequence[AntennaRecord]

    @classmethod
    def of(cls, instrument: Instrument) -> Self:
        """Make the table of an instrument."""
        return cls(instrument.cables, instrument.antennas)

    @cached_property
    def records(self) -> Mapping[tuple[str | None, int | None], Sequence[AntennaRecord]]:
        """The records by station and antenna."""
        found: dict[tuple[str | None, int | None], list[AntennaRecord]] = {}
        for record in self.antennas:
            found.setdefault((record.station, record.antenna), []).append(record)
        return found

    def cable_of(self, station: str, antenna: int, time_unix: float) -> str | None:
        """Name of the cable of an antenna at an instant; None where none is on record."""
        records = self.records.get((station, antenna), ())
        return next((record.cable for record in records if record.covers(time_unix)), None)

    def as_dict(self) -> dict[str, Any]:
        """Describe the table as JSON values: `cables`, `antennas` as station, number, cable, since, until (s UTC)."""
        return {
            "cables": {name: loss.tolist() for name, loss in self.cables.items()},
            "antennas": [[r.station, r.antenna, r.cable, r.since, r.until] for r in self.antennas],
        }

    @cached_property
    def digest(self) -> str:
        """Hash of the content."""
        return hash_content(self.as_dict())


def parse_cable_table(content: Mapping[str, Any]) -> CableTable:
    """Make a cable table from its JSON values."""
    cables = {name: np.array(loss, dtype=float) for name, loss in content["cables"].items()}
    return CableTable(cables, tuple(AntennaRecord(*row) for row in content["antennas"]))


@dataclass(frozen=True)
class GainSpread:
    """How far the power gain A g of paths departs from that of the reference chain, as a fraction of it.

    Attributes
    ----------
    paths
        Paths that were fitted by themselves.
    offset, spread
        Mean departure and standard deviation between paths, shape (freq,).
    """

    paths: int
    offset: Floats
    spread: Floats

    @property
    def variance(self) -> Floats:
        """Mean square departure of another path, shape (freq,).

        Mean and spread are those of n paths: what one more departs follows Student's t with n - 1 degrees of freedom,
        of (1 + 1/n) the variance; one standard deviation holds as much of it as of a normal (Abramowitz & Stegun,
        eq. 26.7.5, for the normal's 1).
        """
        freedom = self.paths - 1
        widened = 1.0 + 1.0 / (2 * freedom) + 1.0 / (4 * freedom**2) + 1.0 / (16 * freedom**3)
        return np.asarray(self.offset**2 + widened**2 * (1.0 + 1.0 / self.paths) * self.spread**2)


@dataclass(frozen=True)
class GainSpreads:
    """The departures of single paths from a reference chain: by cable name, of all together, and between stations.

    Attributes
    ----------
    by_cable
        Only cables with enough fitted paths; `all_paths` answers for the others.
    stations
        Stations of these paths.
    between_stations
        Standard deviation of the mean departures of stations, shape (freq,); None for a single station.
    """

    by_cable: Mapping[str, GainSpread]
    all_paths: GainSpread
    stations: int
    between_stations: Floats | None

    def variance_of(self, cable: str, *, has_station: bool) -> Floats | None:
        """Mean square departure of the A g of a path with a cable, shape (freq,); None where it was not measured.

        The spread over the paths of n stations holds (1 - 1/n) of the variance between stations. For a path of another
        station it is (1 + 1/n), because the mean of n stations is itself off: 2/n are added.
        """
        variance = self.by_cable.get(cable, self.all_paths).variance
        if has_station:
            return variance
        if self.between_stations is None:
            return None
        return np.asarray(variance + 2.0 / self.stations * self.between_stations**2)

    def as_dict(self) -> dict[str, Any]:
        """Describe the spreads as JSON values, its fields by name."""
        return {one.name: as_json(getattr(self, one.name)) for one in fields(self)}

    @cached_property
    def digest(self) -> str:
        """Hash of the content."""
        return hash_content(self.as_dict())


def parse_spreads(content: Mapping[str, Any]) -> GainSpreads:
    """Make spreads from their JSON values."""
    by_cable = {name: GainSpread(**with_arrays(one)) for name, one in content["by_cable"].items()}
    all_paths = GainSpread(**with_arrays(content["all_paths"]))
    return GainSpreads(**with_arrays(content) | {"by_cable": by_cable, "all_paths": all_paths})


@dataclass(frozen=True)
class ReferenceChain:
    """The reference chain of a curve: the mean of many paths.

    Attributes
    ----------
    members
        (station, antenna) of the paths whose power was averaged, each with the same weight; one for a path's own curve.
    mean_loss
        L_ref, shape (freq,): the mean of L_coax over the members, with the cables that they had.
    cables
        The table that converts the curve.
    spreads
        None where too few paths were fitted by themselves.
    doubt
        Why the members are not known for certain; None where they are.
    """

    members: Sequence[tuple[str, int]]
    mean_loss: Floats
    cables: CableTable
    spreads: GainSpreads | None
    doubt: str | None = None

    @cached_property
    def stations(self) -> frozenset[str]:
        """Stations with a member."""
        return frozenset(station for station, _ in self.members)

    @cached_property
    def member_set(self) -> frozenset[tuple[str, int]]:
        """The members, to be looked up."""
        return frozenset(self.members)

    @property
    def jensen(self) -> Floats | None:
        """Fraction of the members' mean C above the curve in their cables, shape (freq,); None without spreads."""
        return None if self.spreads is None else np.asarray(JENSEN * self.spreads.all_paths.spread**2)

    def as_dict(self) -> dict[str, Any]:
        """The chain as JSON values: `members`, `mean_cable_loss`, `jensen`, `cables` (a hash), `spreads`, `doubt`."""
        own = {"mean_cable_loss": self.mean_loss, "jensen": self.jensen, "cables": self.cables.digest}
        whole: dict[str, Any] = as_json({"members": self.members, **own, "spreads": self.spreads, "doubt": self.doubt})
        return whole
