"""A cause: a physical mechanism with a place in the chain, a family of templates and a signature in the data.

A cause is part of the model, not a patch on residuals: it takes `ChainTerms` and returns changed ones, and the recorded
power follows from eq. full_chain as before. It acts by an amount at each event: its size times the time profile of its
template (a temperature, an hour, a date).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from lbacal_core.grids import YEAR_S, Floats
from lbacal_core.instrument.chain import ChainTerms, Intercepts, three_constants
from lbacal_core.linear import fit_least_squares
from lbacal_core.sky.table import read_at

# What is known of the events, the classes of paths and the instrument, for causes to act with.

TEMPERATURE, RAIN = "temperature_c", "rain_mm_h"
REFERENCE_C = 10.0
"""Temperature from which causes count, to which C belongs where a model follows it: near the mean of the Superterp."""
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
    noise: Intercepts | None = None

    @property
    def intercepts(self) -> Intercepts:
        """The noise constants of the chain."""
        return self.noise or three_constants(self.receiver_gain)

    def with_covariates(self, **values: Floats) -> Conditions:
        """The same with other covariates, shape (event,) each."""
        return replace(self, covariates={**self.covariates, **values})

    def covariate(self, name: str) -> Floats | None:
        """A covariate as recorded, shape (event,), NaN where unknown.

        None where too few events know it, or it never varies.
        """
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

    def warmth(self, delay_h: float = 0.0, memory_h: float = 0.0) -> Floats:
        """(Temperature - `REFERENCE_C`) / 10 K, shape (event, 1); 0 where it is not known.

        A delayed temperature is the one measured now, moved by the fitted diurnal wave of the season: events are hours
        to days apart, so that the record itself cannot be shifted. One with a memory is that of a body which takes it
        on as 1 - exp(-t / memory): a diurnal wave is late and small in it.
        """
        values = self.covariates[TEMPERATURE]
        is_known = np.isfinite(values)
        measured = (values - REFERENCE_C) / 10.0
        if delay_h or memory_h:
            now, earlier = self._diurnal_waves(0.0, 0.0), self._diurnal_waves(delay_h, memory_h)
            amplitude = fit_least_squares(now[is_known], measured[is_known])
            measured = measured + (earlier - now) @ amplitude
        return np.asarray(np.where(is_known, measured, 0.0)[:, None])

    def _diurnal_waves(self, delay_h: float, memory_h: float) -> Floats:
        """Constant, season, and first two harmonics of the day with a seasonal amplitude, shape (event, 11)."""
        day = 2 * np.pi * (self.utc_hours - delay_h) / 24.0
        year = 2 * np.pi * self.time_unix / YEAR_S
        season = [np.ones_like(year), np.cos(year), np.sin(year)]
        lags = [np.arctan(2 * np.pi * number * memory_h / 24.0) for number in (1, 2)]
        (cos, sin), twice = (
            [np.cos(lag) * wave(number * day - lag) for wave in (np.cos, np.sin)] for number, lag in enumerate(lags, 1)
        )
        return np.stack([*season, *(wave * s for wave in (cos, sin) for s in season), *twice], axis=1)

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

    def later(self, sky: Floats, hours: Floats) -> Floats:
        """P_sky, shape (class, event, freq), read later in LST, shape (event,): whatever causes have made of it.

        A regular grid over the sidereal day, as of an LST curve, is read as it is; single events know P_sky only as the
        simulation has it, and take the ratio.
        """
        moved = self.lst_hours + hours
        if np.allclose(np.diff(self.lst_hours), 24.0 / self.lst_hours.size, rtol=0.0, atol=1e-9):
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
        """0 before an instant, s UTC, or without dates, and 1 from it on, shape (event, 1)."""
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
    spline = scipy.interpolate.CubicSpline(frequency_mhz, values, bc_type="natural")
    inside = np.clip(moved_mhz, frequency_mhz[0], frequency_mhz[-1])
    slopes = spline(frequency_mhz[[0, -1]], 1)
    beyond = np.where(moved_mhz < frequency_mhz[0], slopes[0], slopes[1]) * (moved_mhz - inside)
    return np.asarray(spline(inside) + beyond)


Act = Callable[[ChainTerms, Conditions, Floats], ChainTerms]
"""What an amount does to the chain."""
EDGE = 1e-3
"""Share of a range that counts as its end."""
BEYOND_SIGMA = 3.0
"""Standard deviations by which an error may carry a size beyond a physical end of its range."""
SCOPES = ("path", "antenna", "group", "cable", "dipole", "station")
"""Kinds of targets: one path, the two paths of an antenna, paths that share hardware, paths of a cable name, one dipole
of all antennas, the whole station."""
OF_HARDWARE = ("station", "dipole", "group", "antenna", "path")
"""Targets of what sits in a path and has no cable."""


@dataclass(frozen=True)
class Template:
    """One member of a cause's family: its parameters (a date, a delay, a line) by name."""

    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class SizeRange:
    """Sizes that a fit far from linear may take.

    Attributes
    ----------
    starts
        Sizes from which it starts.
    physical_end
        An end of the range that is physical, such as 0 for a power, rather than an end of the plausible range.
    """

    lowest: float = -np.inf
    highest: float = np.inf
    starts: Sequence[float] = (0.02,)
    physical_end: float | None = None

    def allows(self, size: float, sigma: float) -> bool:
        """Whether a size found without limits is possible; beyond a physical end the error may have carried it."""
        below, above = (
            BEYOND_SIGMA * sigma if end == self.physical_end else 0.0 for end in (self.lowest, self.highest)
        )
        return self.lowest - below < size < self.highest + above

    def is_at_edge(self, size: float) -> bool:
        """Whether a size has run to the end of the plausible range: the cause then does not describe the data."""
        reach = EDGE * (self.highest - self.lowest)
        if self.physical_end is not None and abs(size - self.physical_end) < reach:
            return False
        return min(size - self.lowest, self.highest - size) < reach


@dataclass(frozen=True)
class Description:
    """The texts about a cause that a reader of reports sees; `docs/causes.md` is written from them.

    Attributes
    ----------
    identifier
        Name in a report.
    unit
        Unit of its size.
    meaning
        What it is, in one clause.
    confirm
        How other means could confirm it.
    needs
        What data must have to show it: the reason in a report where they have not.
    axes
        Axes of the data along which it acts (`lbacal_core.causes.axes`).
    scopes
        Kinds of targets that it can affect, a subset of `SCOPES`.
    """

    identifier: str
    unit: str
    meaning: str
    confirm: str
    needs: str = ""
    axes: Sequence[str] = ("lst",)
    scopes: Sequence[str] = ("station",)


@dataclass(frozen=True)
class Cause(Description):
    """A cause that acts on the chain from event to event.

    Attributes
    ----------
    spectral_parameters
        Names of the parameters that make its spectral template; all others make its time profile.
    step
        A small size, for the derivative of the model.
    largest_step
        Largest change of the size in one step of a fit; infinite where the model is close to linear.
    acts_by_ratio
        Whether it multiplies P_sky by own(with)/own(without), from the package's own sky and antenna.
    sizes
        Sizes that a fit far from linear may take, in units of `scale`.
    whole_array_size, whole_array_meaning
        The one size that it has where it acts on a whole array, and what it then is; None where any size is possible.
    does
        What it does to the chain, where that is no method of its class: `act` without the cause and its template.
    since_unix, until_unix
        The interval in which it acts, s UTC, half open; None where an end is open.
    """

    spectral_parameters: Sequence[str] = ()
    step: float = 1e-3
    largest_step: float = np.inf
    acts_by_ratio: bool = False
    sizes: SizeRange = SizeRange()
    whole_array_size: float | None = None
    whole_array_meaning: str = ""
    does: Act | None = None
    since_unix: int | None = None
    until_unix: int | None = None

    def templates(self, conditions: Conditions) -> list[Template]:  # noqa: ARG002 - most have one whatever the data
        """The templates of the family that a scan of these data tries; empty where the data cannot show the cause."""
        return [Template()]

    def far_templates(self, conditions: Conditions) -> list[Template]:  # noqa: ARG002
        """Templates whose sizes are far from 0, where the cause does what another does: alternatives, never named."""
        return []

    def sizes_of(self, template: Template) -> SizeRange:  # noqa: ARG002
        """Sizes that a template may take."""
        return self.sizes

    def is_physical(self, conditions: Conditions, template: Template, size: float, sigma: float) -> bool:  # noqa: ARG002
        """Whether a size found without limits is possible in some data."""
        return self.sizes_of(template).allows(size, sigma)

    def scale(self, terms: ChainTerms) -> float:  # noqa: ARG002
        """Size in the unit of the cause that 1 in `sizes` stands for."""
        return 1.0

    def label(self, template: Template) -> str:
        """Identifier, with the parameters of a template."""
        return " ".join([self.identifier, *(str(value) for value in template.parameters.values())])

    def say(self, template: Template) -> str:  # noqa: ARG002
        """What it is with a template, in one clause."""
        return self.meaning

    def kinds(self, template: Template) -> frozenset[str]:
        """Its effects on the power of a band by name: templates that share one are never fitted together."""
        return frozenset({self.label(template)})

    def covariates(self, template: Template) -> Sequence[str]:  # noqa: ARG002
        """Covariates that the template needs: events without them are left out."""
        return ()

    def time_profile(self, conditions: Conditions, template: Template) -> Floats:  # noqa: ARG002
        """When it acts: the factor on its size at each event, shape (event, 1)."""
        return np.ones((conditions.time_unix.size, 1))

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:  # noqa: ARG002
        """The chain with this cause acting by an amount, shape (event, 1) or scalar; an amount of 0 changes nothing."""
        if self.does is None:
            raise NotImplementedError
        return self.does(terms, conditions, amount)

    def apply(self, terms: ChainTerms, conditions: Conditions, template: Template, size: float) -> ChainTerms:
        """The chain with this cause at a size."""
        profile = self.time_profile(conditions, template) * self.is_inside(conditions)[:, None]
        return self.act(terms, conditions, template, size * profile)

    def is_inside(self, conditions: Conditions) -> NDArray[np.bool_]:
        """Whether each event lies in the interval of the cause, shape (event,)."""
        is_since = True if self.since_unix is None else conditions.time_unix >= self.since_unix
        is_before = True if self.until_unix is None else conditions.time_unix < self.until_unix
        return np.ones(conditions.time_unix.shape, dtype=bool) & is_since & is_before

    def finer_templates(self, conditions: Conditions, template: Template) -> list[Template]:  # noqa: ARG002
        """Templates about one that was found, on a finer grid than that of `templates`."""
        return [template]

    def is_another(self, template: Template, earlier: Template) -> bool:  # noqa: ARG002
        """Whether both templates can be present in one target, as two dates, two lines or two sources can."""
        return False

    def spectral_key(self, template: Template) -> tuple[Any, ...]:
        """Key of the spectral template; templates with the same key differ in their time profile alone."""
        return tuple(template.parameters.get(name) for name in self.spectral_parameters)

    def factor(self, conditions: Conditions, template: Template) -> Floats | None:  # noqa: ARG002
        """The spectral template over that of `flat`, shape (freq,); None where it is not a factor along frequency."""
        return None

    def flat(self, template: Template) -> Template:
        """The template with the factor 1 in every channel."""
        return template

    def split_factor(self, conditions: Conditions, template: Template) -> tuple[Template, Floats | float]:  # noqa: ARG002
        """A template and what its spectral template is multiplied by to give this one's, as shape (class, 1, freq)."""
        return template, 1.0

    def known_events(self, conditions: Conditions, template: Template) -> NDArray[np.bool_]:
        """Events with every covariate of the template, or outside the interval, which need none, shape (event,)."""
        return np.asarray(conditions.known_events(*self.covariates(template)) | ~self.is_inside(conditions))


def signature(cause: Cause, terms: ChainTerms, conditions: Conditions, template: Template, size: float = 0.0) -> Floats:
    """Relative change of the recorded power per unit of size, shape (class, event, freq): a central difference."""
    above = cause.apply(terms, conditions, template, size + cause.step).power()
    below = cause.apply(terms, conditions, template, size - cause.step).power()
    return np.asarray((above - below) / (cause.step * (above + below)))


def spectral_signature(cause: Cause, terms: ChainTerms, conditions: Conditions, template: Template) -> Floats:
    """Relative change of the power per unit of amount, shape (class, event, freq).

    At size 0 `signature` is this times the time profile.
    """
    above = cause.act(terms, conditions, template, np.array(cause.step)).power()
    below = cause.act(terms, conditions, template, np.array(-cause.step)).power()
    return np.asarray((above - below) / (cause.step * (above + below)))


def spectral_signatures(
    cause: Cause, terms: ChainTerms, conditions: Conditions, templates: Sequence[Template]
) -> Floats:
    """`spectral_signature` of templates, shape (template, class, event, freq), once for those that differ by a law."""
    made: dict[tuple[Any, ...], Floats] = {}
    found = []
    for template in templates:
        plain, law = cause.split_factor(conditions, template)
        key = cause.spectral_key(plain)
        if key not in made:
            made[key] = spectral_signature(cause, terms, conditions, plain)
        found.append(law * made[key])
    return np.stack(found)
