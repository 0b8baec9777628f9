"""What a station saw of the sky against its clock, arms, place and unit on record, and against what may be wrong there.

Every other possibility is tried for itself: a clock that is off, arms that are turned, dipoles exchanged everywhere, a
latitude that is another, a longitude of the wrong sign, latitude and longitude exchanged, decibels or volts instead of
power.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from lbacal_core.audit.antennas import DECIBEL, PAIR, fits_cables, log_likelihood_of_unit
from lbacal_core.audit.station import (
    FEWEST,
    SHARE,
    SHARE_SPREAD,
    SKY_HOURS,
    AnyReceiver,
    AuditedStation,
    Seen,
    make_series,
)
from lbacal_core.audit.verdict import (
    ALIKE,
    LEAST_GAIN,
    UNDECIDED,
    WRONG,
    Line,
    Possibility,
    conclude,
    describe,
    doubt_unit,
    tell_drift,
    tell_summer,
)
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.sky.antenna_of import antenna_of
from lbacal_core.sky.differences import WIDE_MODELS, DifferenceModels, list_patterns
from lbacal_core.sky.model import DATA_EPOCH, Complexes, precess_multipoles
from lbacal_core.sky.modes import combine, sky_power_at
from lbacal_core.sky.names import DEFAULT_TO_MHZ, default_sky, load_sky

# What a station should see of the sky at any place, with any arms and clock; and how other models would differ.
#
# Each exchange of a model for another is one standard deviation of what is known. Without them a clock would be off by
# several minutes: so much differ the times at which the Galaxy culminates in antenna models.

Exchange = tuple[int, int]
"""Numbers of a sky and an antenna; 0 is the station's own."""


@dataclass
class SkyModels:
    """P_sky of all models in the bands of a series.

    Attributes
    ----------
    temperatures
        Multipoles of each sky, the own one first, shape (band, l, m).
    patterns
        Multipoles of each antenna by tilt of the arm, the own one first, shape (band, l, m').
    """

    instrument: Instrument
    frequency_mhz: Floats
    temperatures: list[Complexes]
    patterns: dict[float, list[Complexes]]
    _modes: dict[tuple[Exchange, float, float, str], Complexes] = field(default_factory=dict)

    def seen(self, lst_hours: Floats, latitude_deg: float, turned_deg: float = 0.0, arm: str | None = None) -> Seen:
        """Power of the sky by the models at a latitude with one or all arms turned, and the differences between models.

        `lst_hours` has the shape (time,).
        """
        turns = {dipole: turned_deg if arm in (None, dipole) else 0.0 for dipole in self.instrument.dipoles}

        def change(exchange: Exchange) -> Floats:
            power = np.stack(
                [
                    sky_power_at(self._modes_of(exchange, latitude_deg, turn, dipole), lst_hours).T
                    for dipole, turn in turns.items()
                ]
            )
            return np.asarray(power / power.mean(axis=-1, keepdims=True) - 1.0)

        own = change((0, 0))
        antennas = len(next(iter(self.patterns.values())))
        exchanges = [(sky, 0) for sky in range(1, len(self.temperatures))] + [(0, k) for k in range(1, antennas)]
        differences = [change(one) - own for one in exchanges]
        return Seen(own, np.array(differences).reshape(-1, *own.shape))

    def _modes_of(self, exchange: Exchange, latitude_deg: float, turned_deg: float, dipole: str) -> Complexes:
        key = (exchange, latitude_deg, turned_deg, dipole)
        if key not in self._modes:
            sky, antenna = exchange
            pattern = self.patterns[self.instrument.tilt_deg(dipole)][antenna]
            arm = self.instrument.dipole_azimuth_deg[dipole] + turned_deg
            self._modes[key] = combine(self.temperatures[sky], pattern, arm, latitude_deg, self.frequency_mhz)
        return self._modes[key]


def load_models(
    instrument: Instrument,
    frequency_mhz: Floats,
    sky: str | None,
    antenna: str | None,
    others: DifferenceModels | None = None,
) -> SkyModels:
    """The sky and antenna that are named, else those of the instrument, and the models that they are exchanged for.

    Parameters
    ----------
    others
        All models that ship unless given.
    """
    name = sky or instrument.sky or default_sky(frequency_mhz)
    is_wide = frequency_mhz.max() > DEFAULT_TO_MHZ
    others = others or (WIDE_MODELS if is_wide else DifferenceModels())
    loaded = [load_sky(one) for one in (name, *(one for one in others.skies if one != name))]
    lmax = min(one.lmax for one in loaded)
    skies = [one.truncated(lmax) for one in loaded]
    named = replace(instrument, antenna=antenna or antenna_of(instrument))
    low = max(one.frequency_mhz[0] for one in skies)
    high = min(one.frequency_mhz[-1] for one in skies)
    inside = np.clip(frequency_mhz, low, high)
    patterns = {}
    for tilt in {instrument.tilt_deg(dipole) for dipole in instrument.dipoles}:
        plain, rest = list_patterns(named, others, inside, lmax, tilt)
        patterns[tilt] = [plain, *rest]
    temperatures = [precess_multipoles(one.temperature(inside), DATA_EPOCH) for one in skies]
    return SkyModels(instrument, frequency_mhz, temperatures, patterns)


SHORTEST_HOURS = 0.5
"""The sky hardly changes in less; dipoles of antennas beside each other can be compared in more."""
CLOCK_RANGE, CLOCK_STEP, CLOCK_FINE = 24.0, 0.5, 0.05
FEW_CLOCKS = np.arange(-11.0, 12.0, 1.5).tolist()
"""Hours by which the clock of a month is tried: the rise of the Galaxy lasts longer than the half of a step."""
ARMS_RANGE, ARMS_STEP, ARMS_FINE = 180.0, 10.0, 1.0
WHOLE_HOURS = 12.0
"""Sidereal time that each of summer and winter time must cover for a clock of its own."""
NORTH_POLE_DEG, LATITUDE_STEP, LATITUDE_FINE = 90.0, 10.0, 1.0


class SkyMatch:
    """Power of the sky by the models at a station, for comparison with any part of its antennas."""

    def __init__(self, station: AuditedStation, instrument: Instrument, models: Callable[[], SkyModels]) -> None:
        self.station, self.instrument, self._models = station, instrument, models

    @property
    def models(self) -> SkyModels:
        """P_sky in the bands of the series; not computed where the data are too short for it."""
        return self._models()

    def is_long_enough(self) -> bool:
        """Whether the sky changes at all in these data."""
        return self.station.hours >= SHORTEST_HOURS

    def _say_too_short(self, *checks: str) -> list[Line]:
        asked = {"clock": "clock and place", "arms": "the arms", "unit": "the unit"}
        return [
            Line(
                one, UNDECIDED, self.station.name, f"{self.station.length} not determine {asked[one]}; some hours would"
            )
            for one in checks
        ]

    def gain_of_exchange(self, rows: NDArray[np.int64]) -> float:
        """By how much ln L grows if the dipoles of some rows of the station are exchanged.

        0 where the data are too short.
        """
        if not self.is_long_enough() or rows.size == 0:
            return 0.0
        likelihood = self._likelihood(self.station, rows)
        seen = self._seen(likelihood)
        return likelihood.log_likelihood(_exchanged(seen)) - likelihood.log_likelihood(seen)

    def tell(self, rows: NDArray[np.int64]) -> list[Line]:
        """Compare what some antennas saw, given by rows of the station, with the record and what may be wrong in it."""
        station = self.station
        if rows.size == 0:
            return []
        if not self.is_long_enough():
            return self._say_too_short("clock", "arms", "unit")
        likelihood = self._likelihood(station, rows)
        seen = self._seen(likelihood)
        base = likelihood.log_likelihood(seen)
        units = _try_units(station, rows, self.instrument, base, likelihood.share(seen))
        if station.hours < SKY_HOURS:  # one departure of the sky from its models is all that they show
            told = conclude(station.name, base, units, station.hours, least_doubt=_least_doubt(station, rows))
            return [*self._say_too_short("clock", "arms"), *told]
        arms = (None, *station.dipoles) if len(station.dipoles) > 1 else (None,)
        possibilities = [
            self._scan_clock(likelihood),
            *(self._scan_arms(likelihood, arm) for arm in arms),
            self._scan_latitude(likelihood),
            *self._try_places(likelihood),
            *units,
        ]
        if len(station.dipoles) == PAIR:
            possibilities.append(_possible("exchange", likelihood, _exchanged(seen)))
        fits, least_doubt = likelihood.fits(seen), _least_doubt(station, rows)
        lines = conclude(station.name, base, possibilities, station.hours, fits, least_doubt)
        if all(line.verdict != WRONG for line in lines):
            lines = self._ask_months(rows) or lines
        return [self._ask_time(line, rows) if "clock" in (line.kind, *line.candidates) else line for line in lines]

    def _ask_months(self, rows: NDArray[np.int64]) -> list[Line]:
        """A clock that is off in months on end, where all others agree with the record; else nothing."""
        month = self.station.time_unix.astype("datetime64[s]").astype("datetime64[M]")
        is_off = np.zeros(month.shape, dtype=bool)
        for one in np.unique(month):
            if self.station.at(month == one).hours >= WHOLE_HOURS and np.any(month != one):
                is_off |= (month == one) & self._may_be_off(month == one, rows)
        off = np.flatnonzero(is_off)
        if off.size == 0 or np.ptp(off) >= off.size or self.station.at(~is_off).hours < WHOLE_HOURS:
            return []
        likelihood, rest = (self._likelihood(self.station.at(part), rows) for part in (is_off, ~is_off))
        clock = self._scan_clock(likelihood)
        gain = clock.log_likelihood - likelihood.log_likelihood(self._seen(likelihood))
        if gain < LEAST_GAIN or not (clock.fits and rest.fits(self._seen(rest))):
            return []
        first, last = (one.astype("datetime64[D]") for one in (month[off[0]], month[off[-1]] + 1))
        return [
            Line(
                "clock", WRONG, self.station.name, f"from {first} to {last} {describe(clock)}", log_odds=gain,
                value=clock.value, sigma=clock.sigma, unit="h", kind="clock",
                since_unix=float(first.astype("datetime64[s]").astype(float)),
                until_unix=float(last.astype("datetime64[s]").astype(float)),
            )
        ]  # fmt: skip

    def _may_be_off(self, instants: NDArray[np.bool_], rows: NDArray[np.int64]) -> bool:
        """Whether some instants are likelier with another clock, among a few."""
        one = self._likelihood(self.station.at(instants), rows)
        others = (one.log_likelihood(self._seen(one, hours)) for hours in FEW_CLOCKS)
        return max(others) - one.log_likelihood(self._seen(one)) >= LEAST_GAIN

    def _likelihood(self, station: AuditedStation, rows: NDArray[np.int64]) -> AnyReceiver:
        return AnyReceiver(make_series(station, rows), rows.size)

    def _seen(
        self, likelihood: AnyReceiver, hours: float = 0.0, turned_deg: float = 0.0, arm: str | None = None
    ) -> Seen:
        latitude = self.instrument.latitude_deg
        return self.models.seen(likelihood.series.lst_hours + hours, latitude, turned_deg, arm)

    def _scan_clock(self, likelihood: AnyReceiver) -> Possibility:
        hours = np.arange(-CLOCK_RANGE / 2, CLOCK_RANGE / 2, CLOCK_STEP)
        return _weigh("clock", likelihood, lambda shift: self._seen(likelihood, shift), hours, CLOCK_FINE)

    def _scan_arms(self, likelihood: AnyReceiver, arm: str | None) -> Possibility:
        """All arms together, None, or one of several alone."""
        angles = np.arange(-ARMS_RANGE / 2, ARMS_RANGE / 2, ARMS_STEP)
        turned = _weigh("arms", likelihood, lambda angle: self._seen(likelihood, 0.0, angle, arm), angles, ARMS_FINE)
        return replace(turned, kind="arms" if arm is None else "arm", dipole=arm)

    def _scan_latitude(self, likelihood: AnyReceiver) -> Possibility:
        here, pole = self.instrument.latitude_deg, NORTH_POLE_DEG

        def seen_at(latitude: float) -> Seen:
            return self.models.seen(likelihood.series.lst_hours, min(max(latitude, -pole), pole))

        latitudes = np.arange(-pole, pole, LATITUDE_STEP)
        found = _weigh("latitude", likelihood, seen_at, latitudes, LATITUDE_FINE)
        return replace(found, value=(found.value or 0.0) - here)

    def _try_places(self, likelihood: AnyReceiver) -> list[Possibility]:
        lst, latitude, longitude = (
            likelihood.series.lst_hours, self.instrument.latitude_deg, self.instrument.longitude_deg,
        )  # fmt: skip
        shifts = {"latitude sign": (0.0, -latitude), "longitude sign": (-2 * longitude / 15, latitude)}
        if abs(longitude) <= NORTH_POLE_DEG:
            shifts["latitude for longitude"] = ((latitude - longitude) / 15, longitude)
        return [
            _possible(kind, likelihood, self.models.seen(lst + shift, place), (shift + 12.0) % 24.0 - 12.0)
            for kind, (shift, place) in shifts.items()
        ]

    def _ask_time(self, clock: Line, rows: NDArray[np.int64]) -> Line:
        """A clock that is wrong, and how it differs between summer and winter time or between halves of the time."""
        time = self.station.time_unix
        middle = float(np.median(time))
        of_summer = self._scan_parts(is_summer_time(time), rows)
        told = tell_summer(clock, *of_summer) if of_summer else clock
        if told is not clock or clock.kind != "clock" or clock.since_unix is not None:
            return told
        of_halves = self._scan_parts(time < middle, rows)
        return tell_drift(clock, *of_halves, f"{datetime.fromtimestamp(middle, UTC):%Y-%m-%d}") if of_halves else clock

    def _scan_parts(self, is_in: NDArray[np.bool_], rows: NDArray[np.int64]) -> tuple[Possibility, Possibility] | None:
        """The clock in a part of the time and in the rest; None where one of them is too short."""
        if is_in.all() or not is_in.any():
            return None
        parts = self.station.at(is_in), self.station.at(~is_in)
        if any(part.hours < WHOLE_HOURS for part in parts):
            return None
        one, rest = (self._scan_clock(self._likelihood(part, rows)) for part in parts)
        return one, rest


def tell_unit(station: AuditedStation, rows: NDArray[np.int64], instrument: Instrument) -> list[Line]:
    """A line on the unit where it is wrong by what cables and spectrum say, or undecided, else none.

    `rows` are those of the station.
    """
    units = _try_units(station, rows, instrument, 0.0) if rows.size else []
    if any(one.log_likelihood > LEAST_GAIN for one in units):
        return conclude(station.name, 0.0, units)
    return doubt_unit(station.name, 0.0, units, _least_doubt(station, rows))


def _least_doubt(station: AuditedStation, rows: NDArray[np.int64]) -> float:
    """Ln L above which another unit is told: less where antennas, enough to be compared, have one cable name."""
    is_silent = rows.size >= FEWEST and np.unique(station.cables[rows]).size == 1
    return -ALIKE if is_silent else ALIKE


def is_summer_time(time_unix: Floats) -> NDArray[np.bool_]:
    """Whether Europe has summer time, same shape: from the last Sunday of March to that of October, 01:00 UTC."""
    years = 1970 + np.asarray(time_unix // 1.0, dtype="datetime64[s]").astype("datetime64[Y]").astype(int)
    is_summer = np.zeros(time_unix.shape, dtype=bool)
    for year in np.unique(years).tolist():
        lasts = (datetime(year, month, 31, 1, tzinfo=UTC) for month in (3, 10))
        since, until = ((last - timedelta(days=last.isoweekday() % 7)).timestamp() for last in lasts)
        is_summer |= (time_unix >= since) & (time_unix < until)
    return is_summer


def _exchanged(seen: Seen) -> Seen:
    """What the station sees if its two dipoles bear each other's letter."""
    return Seen(seen.change[::-1], seen.differences[:, ::-1])


def _scan(tell: Callable[[float], float], coarse: Floats, fine: float) -> tuple[float, float, float]:
    """Best ln L, where it is, and the error of that, by a parabola through the best values."""
    values = [tell(float(x)) for x in coarse]
    best = float(coarse[int(np.argmax(values))])
    step = float(coarse[1] - coarse[0])
    around = best + np.arange(-step, step + fine / 2, fine)
    near = np.array([tell(float(x)) for x in around])
    k = int(np.argmax(near))
    at = slice(max(k - 2, 0), k + 3)
    bend, slope, height = np.polyfit(around[at] - around[k], near[at], 2)
    if bend >= 0:
        return float(near[k]), float(around[k]), float("inf")
    vertex = float(np.clip(-slope / (2 * bend), -fine, fine))
    return float(max(near[k], height)), float(around[k] + vertex), float((-2 * bend) ** -0.5)


def _possible(kind: str, likelihood: AnyReceiver, seen: Seen, value: float | None = None) -> Possibility:
    return Possibility(kind, likelihood.log_likelihood(seen), value, fits=likelihood.fits(seen))


def _weigh(
    kind: str, likelihood: AnyReceiver, seen: Callable[[float], Seen], coarse: Floats, fine: float
) -> Possibility:
    """A possibility with a size, over one turn of it: ln L averaged over all sizes that it may have."""
    best, value, sigma = _scan(lambda size: likelihood.log_likelihood(seen(size)), coarse, fine)
    period = -2.0 * float(coarse[0])
    width = min(1.0, sigma * (2 * np.pi) ** 0.5 / period)
    size = (value + period / 2) % period - period / 2
    return Possibility(kind, best + float(np.log(width)), size, sigma, likelihood.fits(seen(value)))


def _try_units(
    station: AuditedStation,
    rows: NDArray[np.int64],
    instrument: Instrument,
    base: float,
    share: tuple[float, float] | None = None,
) -> list[Possibility]:
    """Other units than power, by cable names, spectrum and scatter, and by how much of the sky's change is seen.

    Parameters
    ----------
    share
        The share of the sky that the data show, and its error; None where they are too short.
    """
    # what a share k of the sky in the power becomes in the recorded values
    shrinks = {"volt": 0.5, "dB": DECIBEL / float(np.nanmean(station.power))}
    by_cables = log_likelihood_of_unit(station, rows, "power", instrument)
    found = []
    for unit, factor in shrinks.items():
        if unit == "dB" and np.nanmax(np.abs(station.power)) > LARGEST_DECIBEL:
            continue
        if not fits_cables(station, rows, unit):
            continue
        odds = log_likelihood_of_unit(station, rows, unit, instrument) - by_cables
        if share is not None:
            said = _log_normal(share[0], factor, share[1]) - _log_normal(share[0], 1.0, share[1])
            odds += float(np.clip(said, -SHARE_SAYS, SHARE_SAYS))
        if LEAST_OF_UNIT * factor < station.scatter < LEAST_OF_POWER:
            odds += SCATTER_SAYS
        found.append(Possibility(unit, base + odds))
    return found


def _log_normal(share: float, factor: float, error: float) -> float:
    """Ln p of a share that was expected by the published noise terms times a factor."""
    sigma = float(np.hypot(SHARE_SPREAD * factor, error))
    return -(((share - SHARE * factor) / sigma) ** 2) / 2 - float(np.log(sigma))


LARGEST_DECIBEL = 300.0
LEAST_OF_UNIT, LEAST_OF_POWER, SCATTER_SAYS = 0.8, 0.65, 5.0
"""Scatter over the least that power can have: more than what a unit leaves of it (half in amplitudes), and less than
power has; and what it says, because durations on record may be wrong."""
SHARE_SAYS = 8.0
"""Most that the share of the sky says for a unit: receivers with unusual noise exist."""
