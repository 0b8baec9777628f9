"""What is known of the events, the classes of paths and the instrument, for causes to act with."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from lbacal_core.grids import Floats
from lbacal_core.intercepts import Intercepts, three_constants
from lbacal_core.linear import fit_least_squares
from lbacal_core.skypower.table import read_at

YEAR_S = 365.25 * 86_400.0
TEMPERATURE, RAIN = "temperature_c", "rain_mm_h"
FEWEST_KNOWN = 60
"""Smallest number of events on which a covariate must be known: as many as the fit of a path needs."""
HOURS_BINS, FEWEST_IN_HOURS = 8, 4
"""Parts of the day, and the events that each must hold so that an effect at some hours can be seen."""


@dataclass(frozen=True)
class Conditions:
    """What is known of the events, the classes of paths and the instrument, for causes to act with.

    Attributes
    ----------
    frequency_mhz
        Shape (freq,).
    lst_hours
        Shape (event,).
    time_unix, utc_hours
        Shape (event,), NaN where events are means over all dates.
    sun_altitude, sun_azimuth
        Shape (event,), rad, NaN where events are means over all dates.
    covariates
        What was recorded with the events, such as ``temperature_c``, by the name of its column; shape (event,), NaN
        where unknown.
    dipoles, cables
        Polarisation and cable name of each class.
    mean_sky
        Mean P_sky over LST, shape (class, freq).
    sky_of
        P_sky by the letter of each dipole of the instrument, shape (event, freq).
    sky_at
        P_sky of each class's polarisation at other LST, shape (event,) hours -> (class, event, freq).
    antenna_gain, receiver_gain
        Shape (freq,).
    cable_log_loss
        ln L_coax of each class, shape (class, freq).
    sky_ratio
        P_sky with a cause that needs a direction over P_sky without it, as a function of the amount, shape
        (class, event, freq), by a key such as ``zenith_weighting`` or ``Cas A``; from the package's own sky and
        antenna.
    sun_response
        D towards the Sun, shape (class, event, freq), 0 below the horizon.
    known_noise
        Electronic noise over the mean sky power, where it is known before the fit; None where the fit leaves it free.
    reference_c
        Temperature from which causes count; None for the mean of the data.
    noise
        The noise constants of the chain; None for N_LNA, N_RCU and N_ADC.
    """

    frequency_mhz: Floats
    time_unix: Floats
    lst_hours: Floats
    utc_hours: Floats
    sun_altitude: Floats
    sun_azimuth: Floats
    dipoles: Sequence[str]
    cables: Sequence[str]
    mean_sky: Floats
    sky_of: Mapping[str, Floats]
    sky_at: Callable[[Floats], Floats]
    antenna_gain: Floats
    receiver_gain: Floats
    cable_log_loss: Floats
    covariates: Mapping[str, Floats] = field(default_factory=dict)
    sky_ratio: Mapping[str, Callable[[Floats], Floats]] = field(default_factory=dict)
    sun_response: Floats | None = None
    known_noise: float | None = None
    reference_c: float | None = None
    noise: Intercepts | None = None

    @property
    def intercepts(self) -> Intercepts:
        """The noise constants of the chain."""
        return self.noise or three_constants(self.receiver_gain)

    def with_covariates(self, **values: Floats) -> Conditions:
        """The same with other covariates, shape (event,) each."""
        return replace(self, covariates={**self.covariates, **values})

    def covariate(self, name: str) -> Floats | None:
        """A covariate about its range, NaN where unknown; None where too few events know it, or it never varies."""
        values = self.covariates.get(name)
        if values is None:
            return None
        known = values[np.isfinite(values)]
        return values if known.size >= FEWEST_KNOWN and np.ptp(known) > 0 else None

    def known_events(self, *names: str) -> NDArray[np.bool_]:
        """Events on which all these covariates are known, shape (event,)."""
        is_known = np.ones(self.time_unix.size, dtype=bool)
        for name in names:
            is_known &= np.isfinite(self.covariates[name])
        return is_known

    def warmth(self, delay_h: float = 0.0) -> Floats:
        """(Temperature - its mean, or the reference) / 10 K, shape (event, 1); 0 where it is not known.

        A delayed temperature is the one measured now, moved by the fitted diurnal wave of the season: events are hours
        to days apart, so that the record itself cannot be shifted.
        """
        values = self.covariates[TEMPERATURE]
        is_known = np.isfinite(values)
        reference = values[is_known].mean() if self.reference_c is None else self.reference_c
        measured = (values - reference) / 10.0
        if delay_h != 0.0:
            now, earlier = self._diurnal_waves(0.0), self._diurnal_waves(delay_h)
            amplitude = fit_least_squares(now[is_known], measured[is_known])
            measured = measured + (earlier - now) @ amplitude
        return np.asarray(np.where(is_known, measured, 0.0)[:, None])

    def _diurnal_waves(self, delay_h: float) -> Floats:
        """Constant, season, and first two harmonics of the day with a seasonal amplitude, shape (event, 11)."""
        day = 2 * np.pi * (self.utc_hours - delay_h) / 24.0
        year = 2 * np.pi * self.time_unix / YEAR_S
        season = [np.ones_like(year), np.cos(year), np.sin(year)]
        waves = [np.cos(day), np.sin(day), np.cos(2 * day), np.sin(2 * day)]
        return np.stack([*season, *(wave * s for wave in waves[:2] for s in season), *waves[2:]], axis=1)

    def wetness(self, kind: str) -> Floats:
        """0 when dry, shape (event, 1): 1 in any rain (``flag``), mm/h (``linear``) or its tanh (``saturating``).

        0 where rain is not known.
        """
        rain = np.nan_to_num(self.covariates[RAIN])
        wet = {"flag": (rain > 0).astype(float), "linear": rain, "saturating": np.tanh(rain)}[kind]
        return np.asarray(wet[:, None])

    def season(self, phase_deg: float) -> Floats:
        """A wave of one year, 1 at a phase after 1 January, shape (event, 1)."""
        year = 2 * np.pi * self.time_unix / YEAR_S
        return np.asarray(np.cos(year - np.radians(phase_deg))[:, None])

    @property
    def sky_at_55(self) -> Floats:
        """Mean P_sky at 55 MHz of each class, shape (class,)."""
        return np.array([np.interp(55.0, self.frequency_mhz, sky) for sky in self.mean_sky])

    @property
    def has_dates(self) -> bool:
        """Whether the events have dates, and are no means over them."""
        return bool(np.all(np.isfinite(self.time_unix)))

    @property
    def is_sidereal_day(self) -> bool:
        """Whether the events are the instants of a regular grid over the sidereal day, as those of an LST curve."""
        step = 24.0 / self.lst_hours.size
        return bool(np.allclose(np.diff(self.lst_hours), step, rtol=0.0, atol=1e-9))

    def later(self, sky: Floats, hours: Floats) -> Floats:
        """P_sky, shape (class, event, freq), read later in LST, shape (event,): whatever causes have made of it.

        Single events know P_sky only as the simulation has it, and take the ratio.
        """
        moved = self.lst_hours + hours
        if self.is_sidereal_day:
            return read_at(sky, moved - self.lst_hours[0])
        return np.asarray(sky * self.sky_at(moved) / self.sky_at(self.lst_hours))

    @property
    def dipole_pairs(self) -> list[tuple[str, str]]:
        """Pairs of dipoles whose letters may be exchanged, of which one was recorded at least."""
        return [pair for pair in combinations(sorted(self.sky_of), 2) if set(pair) & set(self.dipoles)]

    def across(self, sky: Floats, pair: tuple[str, str]) -> Floats:
        """P_sky with two letters exchanged, shape (class, event, freq); classes of other letters keep theirs.

        Where the class of the other letter is here as well it is what causes have made of it.
        """
        other = dict([pair, pair[::-1]])
        labels = list(zip(self.dipoles, self.cables, strict=True))
        others = [(other.get(dipole, dipole), cable) for dipole, cable in labels]
        if set(others) == set(labels):
            return sky[[labels.index(one) for one in others]]
        return np.stack(
            [
                self.sky_of[other[dipole]] if dipole in other else own
                for dipole, own in zip(self.dipoles, sky, strict=True)
            ]
        )

    @property
    def has_day_and_night(self) -> bool:
        """Whether the Sun rises and sets in the data."""
        return bool(0.02 < (self.sun_altitude > 0).mean() < 0.98)

    @property
    def has_all_hours(self) -> bool:
        """Whether the events cover all UTC hours, so that an effect at some hours can be seen."""
        return bool(np.histogram(self.utc_hours, bins=HOURS_BINS, range=(0, 24))[0].min() >= FEWEST_IN_HOURS)

    def after(self, date_unix: float) -> Floats:
        """0 before an instant and 1 from it on, shape (event, 1)."""
        return np.asarray((self.time_unix >= date_unix).astype(float)[:, None])

    def in_hours(self, begin: float, end: float) -> Floats:
        """1 within UTC hours from `begin` until `end` (over midnight where end < begin), shape (event, 1)."""
        inside = (self.utc_hours - begin) % 24.0 < ((end - begin) % 24.0 or 24.0)
        return np.asarray(inside.astype(float)[:, None])

    def step_dates(self, number: int = 60) -> list[float]:
        """Instants at which a step is tried: quantiles of the event times, margins kept."""
        inner = np.quantile(self.time_unix, np.linspace(0.02, 0.98, number))
        return [float(instant) for instant in inner]

    def dates_about(self, date_unix: float) -> list[float]:
        """Every instant between events at which a step may be, between the neighbours of one that was tried."""
        times = np.sort(self.time_unix)
        reach = -(-times.size // 60)
        at = int(np.searchsorted(times, date_unix))
        return [float(instant) for instant in times[max(at - reach, 1) : at + reach + 1]]


def read_between(frequency_mhz: Floats, values: Floats, moved_mhz: Floats) -> Floats:
    """Read a tabulated curve at other frequencies: a cubic spline, beyond its ends their slope continued.

    Parameters
    ----------
    frequency_mhz, values
        Shape (freq,).
    moved_mhz
        Any shape.
    """
    spline = CubicSpline(frequency_mhz, values, bc_type="natural")
    inside = np.clip(moved_mhz, frequency_mhz[0], frequency_mhz[-1])
    slopes = spline(frequency_mhz[[0, -1]], 1)
    beyond = np.where(moved_mhz < frequency_mhz[0], slopes[0], slopes[1]) * (moved_mhz - inside)
    return np.asarray(spline(inside) + beyond)
