"""The forward model as its terms, which causes change, and the conditions under which the events were recorded.

A cause is part of the model, not a patch on residuals: it takes `ChainTerms` and returns changed ones, and the recorded
power follows from eq. full_chain as before. Paths of one station with the same dipole letter and cable share their
terms: they are one *class* of paths.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from lbacal_core.grids import Floats

YEAR_S = 365.25 * 86_400.0
SCOPES = ("path", "antenna", "cable", "station")
"""Whom a cause can concern: one path, the two paths of an antenna, all paths of a cable name, the whole station."""


@dataclass(frozen=True)
class ChainTerms:
    """The terms of eq. full_chain for each class of paths, broadcastable to shape (class, event, freq).

    Attributes
    ----------
    sky
        P_sky.
    n_lna
        N_LNA, in the unit of P_sky.
    front
        G_ant A L_coax G_RCU S: from the sky to the output.
    receiver_noise
        N_RCU S G_RCU, at the output.
    adc_noise
        N_ADC, at the output.
    """

    sky: Floats
    n_lna: Floats
    front: Floats
    receiver_noise: Floats
    adc_noise: Floats

    def power(self) -> Floats:
        """Recorded power (eq. full_chain), shape (class, event, freq)."""
        return np.asarray((self.sky + self.n_lna) * self.front + self.receiver_noise + self.adc_noise)


@dataclass(frozen=True)
class Conditions:
    """What is known of the events, the classes of paths and the instrument, for causes to act with.

    Attributes
    ----------
    frequency_mhz
        Shape (freq,).
    time_unix, lst_hours, utc_hours
        Shape (event,).
    sun_altitude, sun_azimuth
        Shape (event,), rad.
    temperature_c, rain_mm_h
        Shape (event,), NaN where unknown; None where the data have no such column.
    dipoles, cables
        Dipole letter and cable name of each class.
    mean_sky
        Mean P_sky over LST, shape (class, freq).
    other_sky
        P_sky of the other dipole letter, shape (class, event, freq).
    sky_at
        P_sky of a class's dipole letter at other LST, shape (event,) hours -> (class, event, freq).
    antenna_gain, receiver_gain
        Shape (freq,).
    cable_log_loss
        ln L_coax of each class, shape (class, freq).
    sky_change
        Relative change of P_sky per unit of a cause that needs a direction, shape (class, event, freq), by a key such
        as ``zenith_weighting`` or ``Cas A``; from the package's own sky and antenna.
    sun_response
        D towards the Sun, shape (class, event, freq), 0 below the horizon.
    """

    frequency_mhz: Floats
    time_unix: Floats
    lst_hours: Floats
    utc_hours: Floats
    sun_altitude: Floats
    sun_azimuth: Floats
    temperature_c: Floats | None
    rain_mm_h: Floats | None
    dipoles: Sequence[str]
    cables: Sequence[str]
    mean_sky: Floats
    other_sky: Floats
    sky_at: Any
    antenna_gain: Floats
    receiver_gain: Floats
    cable_log_loss: Floats
    sky_change: Mapping[str, Floats] = field(default_factory=dict)
    sun_response: Floats | None = None

    def warmth(self, delay_h: float = 0.0) -> Floats | None:
        """(Temperature - its mean) / 10 K, shape (event, 1), or None where it is not known for every event.

        A delayed temperature is the one measured now, moved by the fitted diurnal wave of the season: events are hours
        to days apart, so that the record itself cannot be shifted.
        """
        if self.temperature_c is None or not np.all(np.isfinite(self.temperature_c)):
            return None
        measured = (self.temperature_c - self.temperature_c.mean()) / 10.0
        if delay_h == 0.0:
            return np.asarray(measured[:, None])
        now, earlier = self._diurnal_waves(0.0), self._diurnal_waves(delay_h)
        amplitude, *_ = np.linalg.lstsq(now, measured, rcond=None)
        return np.asarray((measured + (earlier - now) @ amplitude)[:, None])

    def _diurnal_waves(self, delay_h: float) -> Floats:
        """Constant, season, and first two harmonics of the day with a seasonal amplitude, shape (event, 13)."""
        day = 2 * np.pi * (self.utc_hours - delay_h) / 24.0
        year = 2 * np.pi * self.time_unix / YEAR_S
        season = [np.ones_like(year), np.cos(year), np.sin(year)]
        waves = [np.cos(day), np.sin(day), np.cos(2 * day), np.sin(2 * day)]
        return np.stack([*season, *(wave * s for wave in waves[:2] for s in season), *waves[2:]], axis=1)

    def wetness(self, law: str) -> Floats | None:
        """0 when dry, shape (event, 1): 1 in any rain (``flag``), mm/h (``linear``) or their tanh (``saturating``)."""
        if self.rain_mm_h is None or not np.all(np.isfinite(self.rain_mm_h)) or not np.any(self.rain_mm_h > 0):
            return None
        rain = self.rain_mm_h
        wet = {"flag": (rain > 0).astype(float), "linear": rain, "saturating": np.tanh(rain)}[law]
        return np.asarray(wet[:, None])

    def season(self, phase_deg: float) -> Floats:
        """A wave of one year, 1 at a phase after 1 January, shape (event, 1)."""
        year = 2 * np.pi * self.time_unix / YEAR_S
        return np.asarray(np.cos(year - np.radians(phase_deg))[:, None])

    def known(self, course: Floats | None) -> Floats:
        """A course that the laws asked for only because it is known."""
        if course is None:
            raise ValueError("these data have no such column")
        return course

    @property
    def sky_at_55(self) -> Floats:
        """Mean P_sky at 55 MHz of each class, shape (class,)."""
        return np.array([np.interp(55.0, self.frequency_mhz, sky) for sky in self.mean_sky])

    @property
    def has_day_and_night(self) -> bool:
        """Whether the Sun rises and sets in the data."""
        return bool(0.02 < (self.sun_altitude > 0).mean() < 0.98)

    @property
    def has_all_hours(self) -> bool:
        """Whether the events cover all UTC hours, so that hours can be told apart."""
        return bool(np.histogram(self.utc_hours, bins=8, range=(0, 24))[0].min() > 3)

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


@dataclass(frozen=True)
class Law:
    """One member of a cause's family: its parameters (a date, a delay, a line) by name."""

    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Cause:
    """A physical mechanism with a place in the chain, a few parameters and a signature in the data.

    It acts by an amount at each event: its size times the course of its law (a temperature, an hour, a date).

    Attributes
    ----------
    identifier
        Name in the report.
    unit
        Of its size.
    meaning
        What it is, in one clause.
    confirm
        How it could be confirmed by other means.
    needs
        Why data show nothing of it when it has no law for them.
    axes
        Axes of the data along which it acts: ``lst``, ``utc``, ``date``, ``temperature``, ``rain``.
    scopes
        Whom it can concern, a subset of `SCOPES`.
    shaped_by
        Names of the parameters that shape what it does; all others say when.
    step
        A small size, for the derivative of the model.
    largest_step
        By which a fit moves the size at once; infinite where the model is close to linear.
    """

    identifier: str
    unit: str
    meaning: str
    confirm: str
    needs: str = ""
    axes: Sequence[str] = ("lst",)
    scopes: Sequence[str] = ("station",)
    shaped_by: Sequence[str] = ()
    step: float = 1e-3
    largest_step: float = np.inf

    def laws(self, conditions: Conditions) -> list[Law]:  # noqa: ARG002 - most have one law whatever the data
        """The members of the family to be tried on these data; empty where they can show none."""
        return [Law()]

    def course(self, conditions: Conditions, law: Law) -> Floats:  # noqa: ARG002
        """When it acts: the factor on its size at each event, shape (event, 1)."""
        return np.ones((conditions.time_unix.size, 1))

    def act(self, terms: ChainTerms, conditions: Conditions, law: Law, amount: Floats) -> ChainTerms:
        """The model with this cause by an amount, shape (event, 1) or scalar; an amount of 0 changes nothing."""
        raise NotImplementedError

    def apply(self, terms: ChainTerms, conditions: Conditions, law: Law, size: float) -> ChainTerms:
        """The model with this cause at a size."""
        return self.act(terms, conditions, law, size * self.course(conditions, law))

    def finer_laws(self, conditions: Conditions, law: Law) -> list[Law]:  # noqa: ARG002
        """Laws about one that was found, closer together than those that are tried first."""
        return [law]

    def is_another(self, law: Law, earlier: Law) -> bool:  # noqa: ARG002
        """Whether a target can have the cause under both laws, as with dates, channels and sources."""
        return False

    def shape_of(self, law: Law) -> tuple[Any, ...]:
        """What tells apart laws that do different things; laws of one shape differ in their course alone."""
        return tuple(law.parameters[name] for name in self.shaped_by)


def signature(cause: Cause, terms: ChainTerms, conditions: Conditions, law: Law, size: float = 0.0) -> Floats:
    """Relative change of the recorded power per unit of size, shape (class, event, freq): a central difference."""
    above = cause.apply(terms, conditions, law, size + cause.step).power()
    below = cause.apply(terms, conditions, law, size - cause.step).power()
    return np.asarray((above - below) / (cause.step * (above + below)))


def shape_signature(cause: Cause, terms: ChainTerms, conditions: Conditions, law: Law) -> Floats:
    """Relative change of the recorded power per unit of amount: `signature` at size 0 is this times the course."""
    above = cause.act(terms, conditions, law, np.array(cause.step)).power()
    below = cause.act(terms, conditions, law, np.array(-cause.step)).power()
    return np.asarray((above - below) / (cause.step * (above + below)))
