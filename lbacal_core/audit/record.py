"""What an audit finds wrong with a record, as causes of the catalogue; and the record put right.

Letters, a clock, turned arms and a place are compared at what they may be instead, as they stand: nothing of them is
linear in a size. What then is said of the sky is said of the record put right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.audit.audit import audit
from lbacal_core.audit.moved import MOVED
from lbacal_core.audit.sky_match import is_summer_time
from lbacal_core.audit.verdict import SUMMER_TIME, Line
from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.causes.cause import Description
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.sidereal import SIDEREAL_DAY_S
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.blocks import Recorded
from lbacal_core.spectra.spectra import Spectra

SITE = Description(
    "site",
    "",
    "the station stands elsewhere than its record says",
    "compare the coordinates on record with a map; the transit of the Sun or of a pulsar tells the longitude by itself",
)
RECABLED = Description(
    "antenna_exchange", "", "antennas change places on a date", "follow the cable of each to its receiver"
)
"""These have no size, and are no causes that a model could adopt."""
EXCHANGE = "exchange"
_OF_KIND = {
    EXCHANGE: "dipole_swap",
    "arms": "dipole_azimuth",
    "arm": "dipole_azimuth",
    "clock": "lst_offset",
    SUMMER_TIME: "lst_offset",
    "longitude sign": "lst_offset",
    MOVED: RECABLED.identifier,
    "latitude": SITE.identifier,
    "latitude sign": SITE.identifier,
    "latitude for longitude": SITE.identifier,
}
OF_RECORD = frozenset(_OF_KIND.values())
"""Causes that an error of the record is."""
_BY_NAME: dict[str, Description] = {one.identifier: one for one in (*CAUSES, SITE, RECABLED)}
OF_NOBODY_S = 43_200.0
"""Spectra so near to where a clock became another are left out, s: twelve hours, the most that a clock is off."""
EXCHANGED = 1.0
"""Size of what is only right or wrong: letters (1 of `dipole_swap` is an exchange) and places."""


@dataclass(frozen=True)
class RecordError:
    """One thing that is wrong in a record: a cause with its size, of a station or of some antennas."""

    line: Line

    @property
    def cause(self) -> Description:
        """The name of the error in the catalogue of causes."""
        return _BY_NAME[_OF_KIND[self.line.kind]]

    @property
    def size(self) -> tuple[float, float | None]:
        """The size with its standard deviation, None where it has none: exchanged letters and places."""
        if self.line.value is None or self.cause is SITE:
            return EXCHANGED, None
        return self.line.value, self.line.sigma

    @property
    def is_as_cause(self) -> bool:
        """Whether its cause says the same: one size for all arms, or for all of the time."""
        is_whole = self.line.since_unix is None and self.line.until_unix is None
        return is_whole and self.line.kind not in ("arm", SUMMER_TIME)

    @property
    def label(self) -> str:
        """The antennas or the station that it concerns, as the target of a finding is called."""
        antennas = self.line.antennas
        return f"antennas {', '.join(map(str, antennas))}" if antennas else "station"

    @property
    def sentence(self) -> str:
        """The words of the audit, with its odds."""
        odds = "" if self.line.log_odds is None else f" (ln odds {self.line.log_odds:+.0f} against the record)"
        return f"In station {self.line.station}, {self.line.sentence}{odds}."


@dataclass(frozen=True)
class PutRight:
    """The record of one station put right.

    Attributes
    ----------
    errors
        What was wrong with it.
    left_out
        Paths that do not work, or whose spectra are copies for a time, which are left out, in words.
    as_recorded
        The spectra of the paths that work, under the record as it was.
    """

    errors: Sequence[RecordError]
    left_out: Sequence[Line]
    as_recorded: Spectra
    spectra: Spectra
    simulation: Simulation


def put_right(spectra: Spectra, simulation: Simulation) -> PutRight | None:
    """The record of one station put right where an audit finds it wrong; None where it finds nothing.

    Parameters
    ----------
    spectra
        Those of the station.
    simulation
        Under its own sky: one that is given has no other clock or arms to be computed for.
    """
    wrong = audit(spectra, simulation.instrument, others=simulation.models).wrong
    errors = [RecordError(one) for one in wrong if one.kind in _OF_KIND]
    left_out = [one for one in wrong if one.dipole is not None and one.antennas and one.kind not in _OF_KIND]
    if not errors and not left_out:
        return None
    is_ill = np.zeros(len(spectra), dtype=bool)
    for ill in left_out:
        of_path = np.isin(spectra.antenna, ill.antennas) & (spectra.dipole == ill.dipole)
        is_ill |= of_path & ill.is_during(spectra.time_unix)
    working = spectra.select(np.flatnonzero(~is_ill))
    for line in (one.line for one in errors if one.line.unit == "h"):
        for end in (line.since_unix, line.until_unix):
            if end is not None:  # whose clock is that of before or after, nobody knows
                working = working.select(np.flatnonzero(np.abs(working.time_unix - end) > OF_NOBODY_S))
    instrument, corrected = simulation.instrument, working
    for one in errors:
        corrected, instrument = _correct(corrected, instrument, one.line)
    right = simulation
    if instrument is not simulation.instrument:
        right = replace(simulation, instrument=instrument, given=None).smeared(corrected)
    return PutRight(errors, left_out, working, corrected, right)


NOT_NAMED = (
    "P_sky with other letters or at other times would describe these data better, and the audit finds letters, clock, "
    "arms and place right: something else follows sidereal time"
)


def name_mistake(spectra: Recorded, simulation: Simulation) -> str:
    """Name the error of a record, in the audit's words, where P_sky of another record describes the data better."""
    audits = spectra.each(lambda own: audit(own, simulation.instrument, others=simulation.models).wrong)
    wrong = [one for of_stations in audits for one in of_stations]
    errors = [RecordError(one) for one in wrong if one.kind in _OF_KIND or one.candidates]
    return " ".join(one.sentence for one in errors) or NOT_NAMED


def _correct(spectra: Spectra, instrument: Instrument, line: Line) -> tuple[Spectra, Instrument]:
    """Spectra and instrument without one error of the record."""
    if line.kind == EXCHANGE:
        one, other = instrument.dipoles
        is_wrong = np.isin(spectra.antenna, line.antennas) if line.antennas else np.ones(len(spectra), dtype=bool)
        is_wrong &= line.is_during(spectra.time_unix)
        exchanged = np.where(spectra.dipole == one, other, one)
        return replace(spectra, dipole=np.where(is_wrong, exchanged, spectra.dipole)), instrument
    if line.kind == MOVED:
        is_wrong = line.is_during(spectra.time_unix) & (line.dipole is None or spectra.dipole == line.dipole)
        following = dict(zip(line.antennas, (*line.antennas[1:], line.antennas[0]), strict=True))
        moved = np.array([following.get(one, one) for one in spectra.antenna.tolist()])
        return replace(spectra, antenna=np.where(is_wrong, moved, spectra.antenna)), instrument
    if line.value is not None and line.unit == "h":
        late_h = np.where(is_summer_time(spectra.time_unix), *(line.seasons_h or (line.value, line.value)))
        late_s = late_h * SIDEREAL_DAY_S / 24.0
        return replace(spectra, time_unix=spectra.time_unix + line.is_during(spectra.time_unix) * late_s), instrument
    if line.check == "arms":
        turned = instrument.dipole_azimuth_deg if line.dipole is None else (line.dipole,)
        arms = instrument.dipole_azimuth_deg
        arms = {**arms, **{one: (arms[one] + (line.value or 0.0)) % 360.0 for one in turned}}
        return replace(spectra, arms_deg={}), replace(instrument, dipole_azimuth_deg=arms)
    here = instrument.at_station(line.station)
    north, east = here.latitude_deg, here.longitude_deg
    places = {"latitude": (north + (line.value or 0.0), east), "latitude sign": (-north, east)}
    place = places.get(line.kind, (east, north))
    return spectra, replace(here, latitude_deg=place[0], longitude_deg=place[1])
