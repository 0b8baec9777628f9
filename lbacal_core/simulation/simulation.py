"""The simulation: what is believed of an instrument under a sky, and the power that follows (eq. full_chain).

    P = (P_sky + N) s + B,    s = G_ant / C^2 = G_ant A L_coax G_RCU S,

with the noise N that enters in front of A(nu), N_LNA in the published chain, and B, what is recorded of the noise
behind it, N_RCU S G_RCU + N_ADC there (`instrument.chain.Intercepts`).
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.causes.cause import Cause
from lbacal_core.causes.model import PLAIN, Model
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.errors import BadInputError
from lbacal_core.grids import DAY_S, Floats, require_same_grid
from lbacal_core.instrument.chain import (
    FRONT_CONSTANTS,
    PUBLISHED,
    ChainTerms,
    Intercepts,
    constants_of_form,
    noise_constants,
)
from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.instrument.sidereal import SIDEREAL_DAY_S, local_sidereal_time
from lbacal_core.provenance import Remembered, hash_content
from lbacal_core.simulation.prior import DEFAULT_SKY_BUDGET, SkyPrior, list_changes, sky_prior
from lbacal_core.sky.differences import DifferenceModels, ModelDifferences, compute_model_differences
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.sky_terms import SkyTerm
from lbacal_core.sky.table import SHORTEST_SMEARED_H, SkyPower
from lbacal_core.spectra.blocks import Recorded
from lbacal_core.spectra.spectra import BLOCK_S

SIDEREAL_HOUR_S = SIDEREAL_DAY_S / 24
LARGEST_UNLIKE_H2 = 0.9
"""Mean departure of the squared durations of spectra from their mean, sidereal hours^2, up to which one duration stands
for all: it moves the second harmonic of an event by 1 %, (2 pi)^2 / (6 x 24^2) of it."""
MOST_REMEMBERED = 64
"""Fits of single paths of a station's year and polarisation take 9 MB."""


@dataclass(frozen=True, eq=False, repr=False)
class Simulation:
    """An instrument under a sky.

    Attributes
    ----------
    given
        P_sky of its dipoles; None for the package's own, which is computed when it is first asked for.
    is_own_sky
        Whether P_sky may be wrong as models of sky and antenna differ. Unless said otherwise the package's own may,
        and one that is given is taken at its word.
    models
        Names of the models whose differences these are; all that ship unless given.
    causes
        What the chain has besides, with sizes that are fitted together with C.
    catalogue
        The causes that an investigation looks for.
    form
        The form of the chain, one of `instrument.chain.FORMS`, where the instrument does not list its stages.
    most_remembered
        How much of what was computed is kept.
    made
        What was computed with it, by the content that it was computed from.
    """

    instrument: Instrument
    given: SkyPower | None = None
    is_own_sky: bool | None = None
    models: DifferenceModels | None = None
    causes: Model = PLAIN
    catalogue: Sequence[Cause] = CAUSES
    form: str = PUBLISHED
    most_remembered: int = MOST_REMEMBERED
    made: Remembered[tuple[Any, ...], Any] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        # Not an argument: `dataclasses.replace` would hand it to another instrument or sky.
        object.__setattr__(self, "made", Remembered(self.most_remembered))
        if self.is_own_sky is None:
            object.__setattr__(self, "is_own_sky", self.given is None)
        if self.given is not None:
            name, frequency_mhz = f"instrument {self.instrument.name}", self.instrument.frequency_mhz
            require_same_grid(self.given.origin, self.given.frequency_mhz, frequency_mhz, name)
            self.given.require_made_for(self.instrument)

    def __repr__(self) -> str:
        """One line."""
        sky = "its own sky" if self.given is None else self.given.origin
        causes = "".join(f", {one.cause} in {one.target} of {one.station}" for one in self.causes.causes)
        return f"<Simulation {self.instrument.name} under {sky}{causes}>"

    @classmethod
    def load(cls, instrument: str) -> Simulation:
        """An instrument by its name or file, under its own sky."""
        return cls(load_instrument(instrument))

    def on_channels(self, frequency_mhz: Floats) -> Simulation:
        """The simulation on those of its channels that an input has, at least half; itself for any other input."""
        instrument = self.instrument.on_channels(frequency_mhz)
        if instrument is self.instrument:
            return self
        kept = np.isin(self.instrument.frequency_mhz, instrument.frequency_mhz)
        return replace(self, instrument=instrument, given=self.sky_power.on_channels(kept), is_own_sky=self.is_own_sky)

    @cached_property
    def sky_power(self) -> SkyPower:
        """P_sky(LST, nu) of each dipole and station."""
        return compute_sky_power(self.instrument) if self.given is None else self.given

    @cached_property
    def noise(self) -> Intercepts:
        """The noise constants of the chain, and what each adds along frequency."""
        return noise_constants(self.instrument, self.form)

    @cached_property
    def differences(self) -> ModelDifferences | None:
        """Changes of P_sky by other models of sky and antenna; None where the sky power is taken as exact."""
        if not self.is_own_sky:
            return None
        found: ModelDifferences
        # in what copies with other causes share: a worker makes one for every fit
        found = self.made.get(("differences",), lambda: compute_model_differences(self.instrument, self.models))
        return found

    @cached_property
    def prior(self) -> SkyPrior | None:
        """By how much P_sky may differ from the one here before data are a misfit; None where it may not."""
        if not self.is_own_sky:
            return None
        found: SkyPrior = self.made.get(("prior",), lambda: sky_prior(self.instrument, self.models))
        return found

    @property
    def digest(self) -> str:
        """Hash of instrument, sky power, causes and whatever else predicts power."""
        return hash_content(
            [self.instrument.digest(), self.sky_power.digest(), self.is_own_sky, self.causes.id, self.form]
        )

    @property
    def own_causes(self) -> dict[str, list[str]]:
        """The causes of this installation beside the catalogue, each in words; empty where there is none."""
        own = [f"{one.identifier}: {one.meaning}" for one in self.catalogue if one not in CAUSES]
        return {"own_causes": own} if own else {}

    def changes(self, sky_budget: str = DEFAULT_SKY_BUDGET) -> Sequence[SkyTerm]:
        """Changes of sky, pattern and ground by one standard deviation (`simulation.prior.list_changes`)."""
        found: Sequence[SkyTerm]
        found = self.made.get(("changes", sky_budget), lambda: list_changes(self.instrument, sky_budget))
        return found

    def with_causes(self, causes: Model) -> Simulation:
        """The same with other causes; what was computed is kept."""
        return self._exchange("causes", causes)

    def with_form(self, form: str) -> Simulation:
        """The same with another of `chain.FORMS`; what was computed is kept but for the noise constants."""
        other = self._exchange("form", form)
        vars(other).pop("noise", None)
        return other

    def _exchange(self, name: str, value: object) -> Simulation:
        other = copy(self)
        object.__setattr__(other, name, value)
        return other

    def at_station(self, station: str) -> Simulation:
        """The same where a station of the instrument stands."""
        return replace(self, instrument=self.instrument.at_station(station), given=self.sky_power.of_station(station))

    def at_its_word(self) -> Simulation:
        """The same with a P_sky that cannot be wrong."""
        return replace(self, given=self.sky_power, is_own_sky=False)

    def smeared(self, spectra: Recorded) -> Simulation:
        """The same where the sky moves while spectra are recorded; itself where it does not.

        One duration stands for all, the root mean square: what a duration h takes of a harmonic goes with h^2.
        """
        is_counted = spectra.duration_s is None
        given, unit = (spectra.blocks, BLOCK_S) if spectra.duration_s is None else (spectra.duration_s, 1.0)
        if len(spectra) == 0 or unit * given.max() < SHORTEST_SMEARED_H * SIDEREAL_HOUR_S:
            return self
        seconds, place = unit * given, f"{spectra.head.origin}: {'blocks' if is_counted else 'duration_s'}"
        if seconds.max() > DAY_S:
            of = " in blocks of 5.12 µs" if is_counted else ""
            raise BadInputError(place, f"at most a day in a spectrum{of}", f"{seconds.max() / 3600:.2g} h")
        square = (seconds / SIDEREAL_HOUR_S) ** 2
        if np.mean(np.abs(square - square.mean())) > LARGEST_UNLIKE_H2:
            short, long = np.percentile(seconds, [5, 95]) / 3600
            expected = "durations that are alike: fit the short and the long integrations by themselves"
            raise BadInputError(place, expected, f"{short:.2g} to {long:.2g} h")
        return replace(self, given=self.sky_power.smeared(float(np.sqrt(square.mean()))), is_own_sky=self.is_own_sky)

    def sidereal_time(self, station: str | None, time_unix: Floats) -> Floats:
        """Sidereal time where a station stands, hours, of instants in s UTC; shape (event,)."""
        return local_sidereal_time(time_unix, self.instrument.at_station(station).longitude_deg)

    def sky_at(self, station: str | None, dipole: str, time_unix: Floats) -> Floats:
        """P_sky of a station's dipole at instants in s UTC, shape (event, freq)."""
        return self.sky_power.of_station(station).at(dipole, self.sidereal_time(station, time_unix))

    def split_power(self, curves: Sequence[CalibrationCurve], sky: Floats) -> tuple[Floats, Floats]:
        """Split the power of fitted curves: (P_sky + N) s, shape (curve, event, freq), and B, shape (curve, 1, freq).

        Parameters
        ----------
        sky
            P_sky, shape (event, freq).
        """
        if any(curve.c is None for curve in curves):
            raise ValueError(f"{next(one.name for one in curves if one.c is None)} has no curve")
        slope = self.instrument.antenna_gain / np.array([curve.filled(np.asarray(curve.c)) for curve in curves]) ** 2
        parts = [(noise, _levels_of(curve, noise)) for curve in curves for noise in [noise_of(curve, self.instrument)]]
        before = np.array([noise.before(level[: len(noise.front)]) for noise, level in parts])
        behind = np.array([level[len(noise.front) :] @ noise.behind for noise, level in parts])
        return (sky + before[:, None]) * slope[:, None], behind[:, None]

    def power(self, curve: CalibrationCurve, sky: Floats) -> Floats:
        """Power of a fitted path for a P_sky of shape (event, freq); the same shape, NaN in channels without C."""
        signal, behind = self.split_power([curve], sky)
        return np.where(curve.has_value, (signal + behind)[0], np.nan)

    def background(self, curve: CalibrationCurve, lst_hours: Floats) -> Floats:
        """Power of a fitted path at sidereal times, sky and electronics, shape (event, freq), ADC^2/Ohm/MHz."""
        if curve.dipole is None:
            raise BadInputError(curve.name, "a curve of one polarisation", "one for both")
        sky = self.sky_power.of_station(curve.station)
        return self.power(curve, sky.at(curve.dipole, np.asarray(lst_hours, dtype=float)))

    def electronics(self, curve: CalibrationCurve) -> Floats:
        """Power of a fitted path without the sky, shape (freq,), ADC^2/Ohm/MHz."""
        return np.asarray(self.power(curve, np.zeros((1, self.instrument.frequency_mhz.size)))[0])


def noise_of(curve: CalibrationCurve, instrument: Instrument) -> Intercepts:
    """The noise constants with which a curve was fitted: its parameters name the form of the chain."""
    if instrument.stages:
        return noise_constants(instrument)
    return constants_of_form(instrument, [name for name in FRONT_CONSTANTS if name in curve.parameters])


def _levels_of(curve: CalibrationCurve, noise: Intercepts) -> Floats:
    return np.array([curve.parameters[name].value for name in noise.names])


def terms_of(curve: CalibrationCurve, instrument: Instrument, sky: Floats) -> ChainTerms:
    """The terms of the chain of a fitted curve under a P_sky of shape (..., freq), on all channels of the curve."""
    if curve.c is None:
        raise ValueError(f"{curve.name} has no curve")
    noise = noise_of(curve, instrument)
    level, r = _levels_of(curve, noise), len(noise.front)
    slope = instrument.antenna_gain / curve.filled(np.asarray(curve.c)) ** 2
    return ChainTerms(sky, noise.before(level[:r]), slope, *noise.split_behind(level[r:]))


def noise_at_input(curve: CalibrationCurve, instrument: Instrument) -> dict[str, Floats]:
    """The noise terms of a fitted curve referred to the start of the chain (Fig. 5 of the paper).

    Each constant divided by what amplifies the sky up to the point where it was fitted: those behind A by
    G_ant / C^2.

    Returns
    -------
    By name of the stage (`lna`, `rcu` and `adc` of a chain without stages), each shape (freq,), in the unit of P_sky;
    `known_noise` is what the instrument states without an error.
    """
    if curve.c is None:
        raise ValueError(f"{curve.name} has no curve")
    slope, noise = instrument.antenna_gain / curve.c**2, noise_of(curve, instrument)
    value = _levels_of(curve, noise)
    forms = np.concatenate([noise.front, noise.behind / slope])
    terms = {name.removeprefix("n_"): one for name, one in zip(noise.names, value[:, None] * forms, strict=True)}
    return terms | ({"known_noise": noise.known} if np.any(noise.known) else {})
