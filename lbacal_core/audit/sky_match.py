"""What a station saw of the sky against its clock, arms, place and unit on record, and against what may be wrong there.

Every other possibility is tried for itself: a clock that is off, arms that are turned, dipoles exchanged everywhere, a
hemisphere or a longitude of the wrong sign, latitude and longitude exchanged, decibels or volts instead of power.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lbacal_core.antenna.model import AntennaModel
from lbacal_core.antenna.names import load_antenna
from lbacal_core.audit.cables import log_likelihood_of_unit
from lbacal_core.audit.finding import RIGHT, UNDECIDED, WRONG, Line
from lbacal_core.audit.series import SHARE, SHARE_SPREAD, SeriesLikelihood, make_series, mean_frequencies
from lbacal_core.audit.station import AuditedStation
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument
from lbacal_core.sky.frames import DATA_EPOCH
from lbacal_core.sky.model import SkyModel
from lbacal_core.sky.multipoles import precess_multipoles
from lbacal_core.sky.names import default_sky, load_sky
from lbacal_core.skypower.antenna_of import antenna_of
from lbacal_core.skypower.modes import beam_multipoles, combine, sky_power_at

LEAST_GAIN = 10.0
"""ln L by which another possibility must be better than what is on record: odds of 150 after prior odds of 1 in 150."""
ALIKE = 5.0
"""Possibilities whose ln L differ by less cannot be told apart."""
SHORTEST_HOURS = 0.5
"""The sky hardly changes in less."""
CLOCK_STEP, CLOCK_FINE = 0.25, 1 / 60
ARMS_STEP, ARMS_FINE = 5.0, 0.5
RIGHT_ANGLE, NEAR_RIGHT = 90.0, 10.0
TELLING = {"clock": 1.0, "arms": 20.0}
"""Errors (h, deg) above which data cannot be said to confirm a clock or arms."""


@dataclass(frozen=True)
class Possibility:
    """One way in which a record may differ from what was seen."""

    kind: str
    log_likelihood: float
    value: float | None = None
    sigma: float | None = None


class SkyOf:
    """P_sky of a sky and antenna model for any place, arms and clock, in the bands of a series."""

    def __init__(self, instrument: Instrument, sky: SkyModel, antenna: AntennaModel, frequency_mhz: Floats) -> None:
        self.instrument, self.frequency_mhz = instrument, frequency_mhz
        self.temperature = precess_multipoles(sky.temperature(frequency_mhz), DATA_EPOCH)
        tilts = {instrument.tilt_deg(dipole) for dipole in instrument.dipoles}
        self.beams = {tilt: beam_multipoles(antenna, frequency_mhz, sky.lmax, tilt) for tilt in tilts}

    def seen(self, lst_hours: Floats, latitude_deg: float, turned_deg: float = 0.0) -> Floats:
        """Shape (dipole, band, time)."""
        arms = [
            (self.instrument.dipole_azimuth_deg[dipole] + turned_deg, self.beams[self.instrument.tilt_deg(dipole)])
            for dipole in self.instrument.dipoles
        ]
        modes = [combine(self.temperature, beam, arm, latitude_deg, self.frequency_mhz) for arm, beam in arms]
        return np.stack([sky_power_at(mode, lst_hours).T for mode in modes])


class SkyMatch:
    """What the models say a station should see, for comparison with any part of its antennas."""

    def __init__(self, station: AuditedStation, instrument: Instrument, sky: str | None, antenna: str | None) -> None:
        self.station, self.instrument, self.sky, self.antenna = station, instrument, sky, antenna

    @cached_property
    def sky_of(self) -> SkyOf:
        """P_sky in the bands of the series; not computed where the data are too short for it."""
        sky = load_sky(self.sky or self.instrument.sky or default_sky(self.instrument.frequency_mhz))
        antenna = load_antenna(self.antenna or antenna_of(self.instrument))
        return SkyOf(self.instrument, sky, antenna, mean_frequencies(self.station.frequency_mhz))

    def is_long_enough(self) -> bool:
        """Whether the sky changes at all in these data."""
        return self.station.hours >= SHORTEST_HOURS

    def _say_too_short(self) -> list[Line]:
        sentence = f"{self.station.length} not determine {{}}; some hours would"
        asked = {"clock": "clock and place", "arms": "the arms", "unit": "the unit"}
        return [Line(check, UNDECIDED, self.station.name, sentence.format(what)) for check, what in asked.items()]

    def gain_of_exchange(self, rows: NDArray[np.int64]) -> float:
        """By how much ln L grows if the dipoles of some antennas are exchanged; 0 where the data are too short."""
        if not self.is_long_enough() or rows.size == 0:
            return 0.0
        likelihood = SeriesLikelihood(make_series(self.station, rows))
        lst, latitude = likelihood.series.lst_hours, self.instrument.latitude_deg
        as_claimed, exchanged = (
            likelihood.log_likelihood(self.sky_of.seen(lst, latitude, turned)) for turned in (0.0, RIGHT_ANGLE)
        )
        return exchanged - as_claimed

    def tell(self, rows: NDArray[np.int64]) -> list[Line]:
        """Compare what some antennas saw with the record, and with what may be wrong in it."""
        station = self.station
        if rows.size == 0:
            return []
        if not self.is_long_enough():
            units = [one for one in _try_units(station, rows, 0.0) if one.log_likelihood > LEAST_GAIN]
            return _conclude(station.name, 0.0, units) if units else self._say_too_short()
        likelihood = SeriesLikelihood(make_series(station, rows))
        latitude, longitude = self.instrument.latitude_deg, self.instrument.longitude_deg
        seen = self.sky_of.seen(likelihood.series.lst_hours, latitude)
        base = likelihood.log_likelihood(seen)
        possibilities = [
            _scan_clock(likelihood, self.sky_of, latitude),
            _scan_arms(likelihood, self.sky_of, latitude),
            *_try_places(likelihood, self.sky_of, latitude, longitude),
            *_try_units(station, rows, base, likelihood.share(seen)),
        ]
        return _conclude(station.name, base, possibilities)


def _scan(tell: Callable[[float], float], coarse: Floats, fine: float) -> tuple[float, float, float]:
    """Best ln L, where it is, and the error of that by the curvature."""
    values = [tell(float(x)) for x in coarse]
    best = float(coarse[int(np.argmax(values))])
    step = float(coarse[1] - coarse[0])
    around = best + np.arange(-step, step + fine / 2, fine)
    near = np.array([tell(float(x)) for x in around])
    k = int(np.argmax(near))
    bend = np.polyfit(around[max(k - 5, 0) : k + 6] - around[k], near[max(k - 5, 0) : k + 6], 2)[0]
    return float(near[k]), float(around[k]), float((-2 * bend) ** -0.5) if bend < 0 else float("inf")


def _scan_clock(likelihood: SeriesLikelihood, sky_of: SkyOf, latitude: float) -> Possibility:
    lst = likelihood.series.lst_hours
    gain, hours, sigma = _scan(
        lambda shift: likelihood.log_likelihood(sky_of.seen(lst + shift, latitude)),
        np.arange(-12.0, 12.0, CLOCK_STEP),
        CLOCK_FINE,
    )
    return Possibility("clock", gain, hours, sigma)


def _scan_arms(likelihood: SeriesLikelihood, sky_of: SkyOf, latitude: float) -> Possibility:
    lst = likelihood.series.lst_hours
    gain, turned, sigma = _scan(
        lambda angle: likelihood.log_likelihood(sky_of.seen(lst, latitude, angle)),
        np.arange(-90.0, 90.0, ARMS_STEP),
        ARMS_FINE,
    )
    return Possibility("arms", gain, (turned + 90.0) % 180.0 - 90.0, sigma)


def _try_places(likelihood: SeriesLikelihood, sky_of: SkyOf, latitude: float, longitude: float) -> list[Possibility]:
    lst = likelihood.series.lst_hours
    tried = {
        "latitude sign": (lst, -latitude),
        "longitude sign": (lst - 2 * longitude / 15, latitude),
        "latitude for longitude": (lst + (latitude - longitude) / 15, float(np.clip(longitude, -90, 90))),
    }
    return [
        Possibility(kind, likelihood.log_likelihood(sky_of.seen(hours, place)))
        for kind, (hours, place) in tried.items()
    ]


def _try_units(
    station: AuditedStation, rows: NDArray[np.int64], base: float, share: tuple[float, float] | None = None
) -> list[Possibility]:
    """Other units than power, by how cable names differ and by how much of the sky's change is seen.

    Parameters
    ----------
    share
        The share of the sky that the data show, and its error; None where they are too short.
    """
    # what a share k of the sky in the power becomes in the recorded values
    shrinks = {"volt": 0.5, "dB": 10 / np.log(10) / float(np.nanmean(station.power))}
    by_cables = log_likelihood_of_unit(station, rows, "power")
    found = []
    for unit, factor in shrinks.items():
        if unit == "dB" and np.nanmax(np.abs(station.power)) > LARGEST_DECIBEL:
            continue
        odds = log_likelihood_of_unit(station, rows, unit) - by_cables
        if share is not None:
            said = _log_normal(share[0], factor, share[1]) - _log_normal(share[0], 1.0, share[1])
            odds += float(np.clip(said, -SHARE_SAYS, SHARE_SAYS))
        found.append(Possibility(unit, base + odds))
    return found


def _log_normal(share: float, factor: float, error: float) -> float:
    """Ln p of a share that was expected by the published noise terms times a factor."""
    sigma = float(np.hypot(SHARE_SPREAD * factor, error))
    return -(((share - SHARE * factor) / sigma) ** 2) / 2 - float(np.log(sigma))


LARGEST_DECIBEL = 300.0
SHARE_SAYS = 8.0
"""Most that the share of the sky says for a unit: receivers with unusual noise exist."""


def _conclude(station: str, base: float, possibilities: list[Possibility]) -> list[Line]:
    """What is wrong, if anything; else what the data confirm."""
    best = max(possibilities, key=lambda one: one.log_likelihood)
    gain = best.log_likelihood - base
    if gain < LEAST_GAIN:
        return [_confirm(station, one, base) for one in possibilities if one.kind in TELLING]
    alike = [one for one in possibilities if one is not best and best.log_likelihood - one.log_likelihood < ALIKE]
    check = _CHECKS.get(best.kind, best.kind)
    if best.kind == "arms" and abs(abs(best.value or 0.0) - RIGHT_ANGLE) < NEAR_RIGHT:
        check = "exchange"
    sentence = _describe(best)
    if alike:
        sentence += "; these data cannot tell this from: " + "; ".join(_describe(one) for one in alike)
    unit = {"clock": "h", "arms": "deg"}.get(best.kind, "")
    return [Line(check, WRONG, station, sentence, log_odds=gain, value=best.value, sigma=best.sigma, unit=unit)]


_CHECKS = {
    "latitude sign": "place",
    "longitude sign": "place",
    "latitude for longitude": "place",
    "dB": "unit",
    "volt": "unit",
}


def _describe(one: Possibility) -> str:
    value, sigma = one.value or 0.0, one.sigma or 0.0
    if one.kind == "clock":
        return f"sidereal time is {60 * value:+.0f} +- {60 * sigma:.0f} min from that of clock and longitude on record"
    if one.kind == "arms" and abs(abs(value) - RIGHT_ANGLE) < NEAR_RIGHT:
        return "X and Y are exchanged at every antenna, or both arms are turned by 90 deg"
    if one.kind == "arms":
        return f"both arms are turned by {value:+.0f} +- {sigma:.0f} deg (north through east) from the record"
    return {
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
    words = _describe(one) if one.kind == "clock" else f"the arms are {value:+.0f} +- {sigma:.0f} deg from the record"
    return Line(
        one.kind, RIGHT, station, words, log_odds=one.log_likelihood - base, value=value, sigma=sigma, unit=unit
    )
