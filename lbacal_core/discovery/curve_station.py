"""An LST curve as a station of the classes X and Y on the axis LST: conditions, chain, and causes that it can show.

The band power is the sum over channels of (P_sky + noise) x weight. The baseline contains the electronic noise of all
stages, whose ratio to the mean sky power has a prior (`lbacal_core.lstcurve.noise_share`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.causes.axes import axes_of
from lbacal_core.causes.catalogue import CAUSES, DESCRIPTIONS
from lbacal_core.causes.cause import Cause, SizeRange, Template
from lbacal_core.causes.conditions import Conditions
from lbacal_core.causes.directions import sky_ratios
from lbacal_core.chain.noise import noise_constants
from lbacal_core.chain.terms import ChainTerms
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument
from lbacal_core.linear import fit_least_squares
from lbacal_core.lstcurve.noise_share import NoisePrior
from lbacal_core.skypower.table import SkyPower

GRID_HOURS: Floats = np.asarray(np.arange(32) * 0.75, dtype=np.float64)
"""Resolves |m| <= 15: the beam of a dipole leaves nothing above 8."""
SMALLEST_SKY = 1e-6
"""Share of the largest P_sky below which no cause makes it fall: the logarithm of the power exists."""
SMALLEST_BEND = 1e-4
"""Share of the squared change of the band power that varies with LST, below which the offset describes a cause:
doubled power then bends the curve by 0.03 dB, less than the noise of a point."""
ABSORBED = "the free level of the curve, or its free noise, describes the change"


@dataclass(frozen=True)
class Choice:
    """A cause with one template, as a fit of an LST curve takes it; its sizes are in units of `scale`."""

    cause: Cause
    template: Template
    scale: float = 1.0
    is_alias: bool = False

    @property
    def label(self) -> str:
        """Identifier, with the parameters of the template."""
        return self.cause.label(self.template)

    @property
    def kinds(self) -> frozenset[str]:
        """Kinds of its effect on the band power; choices with a common kind are never fitted together."""
        return self.cause.kinds(self.template)

    @property
    def sizes(self) -> SizeRange:
        """Sizes that a fit may take."""
        return self.cause.sizes_of(self.template)

    @property
    def is_statement(self) -> bool:
        """Whether it is true or not, at its one size, for the whole array."""
        return self.cause.whole_array_size is not None


@dataclass(frozen=True)
class CurveStation:
    """P_sky of the classes X and Y on `GRID_HOURS`, with the band's weights, for causes to act on.

    The noise of `terms` is as large as the mean sky power of the band; `terms_with` scales it.
    """

    conditions: Conditions
    terms: ChainTerms
    prior: NoisePrior

    @property
    def weights(self) -> Floats:
        """Weight of every channel in the band power, shape (freq,)."""
        return np.asarray(self.terms.front[0, 0])

    @property
    def channels_mhz(self) -> Floats:
        """Channels of the band, shape (freq,)."""
        return self.conditions.frequency_mhz[self.weights > 0]

    def is_described(self, choice: Choice) -> bool:
        """Whether what the baseline leaves free describes a small size: the level, and noise of which nothing is known.

        A small size is added to a sky without noise.
        """
        whole = self.terms_with([], np.zeros(0), 0.0).power().sum(axis=-1)
        change = np.log(self.terms_with([choice], np.array([choice.cause.step]), 0.0).power().sum(axis=-1) / whole)
        bent = 0.0
        for own, power in zip(change, whole, strict=True):
            free = np.stack([np.ones_like(power), power.mean() / power], axis=1)[:, : 1 if self.prior.is_known else 2]
            bent += float(np.sum((own - free @ fit_least_squares(free, own)) ** 2))
        return bool(bent <= SMALLEST_BEND * np.sum(change**2))

    def terms_with(self, choices: Sequence[Choice], sizes: Floats, noise: float) -> ChainTerms:
        """The chain with noise over mean sky power, and causes at sizes, one after the other."""
        own = self.terms
        terms = replace(
            own, n_lna=noise * own.n_lna, receiver_noise=noise * own.receiver_noise, adc_noise=noise * own.adc_noise
        )
        for choice, size in zip(choices, sizes.tolist(), strict=True):
            terms = choice.cause.apply(terms, self.conditions, choice.template, size * choice.scale)
            least = SMALLEST_SKY * terms.sky.max(axis=(1, 2), keepdims=True)
            terms = replace(terms, sky=np.maximum(terms.sky, least))
        return terms


def gather_curve(instrument: Instrument, sky_power: SkyPower, weights: Floats, prior: NoisePrior) -> CurveStation:
    """Lay out the simulation of an LST curve.

    Parameters
    ----------
    weights
        Weight of every channel in the band power, shape (freq,).
    """
    sky = np.stack([sky_power.at(d, GRID_HOURS) for d in DIPOLES])
    sky = np.maximum(sky, SMALLEST_SKY * sky.max(axis=(1, 2), keepdims=True))
    unknown = np.full(GRID_HOURS.size, np.nan)
    conditions = Conditions(
        frequency_mhz=instrument.frequency_mhz,
        time_unix=unknown,
        lst_hours=GRID_HOURS,
        utc_hours=unknown,
        sun_altitude=unknown,
        sun_azimuth=unknown,
        dipoles=DIPOLES,
        cables=["all"] * len(DIPOLES),
        mean_sky=sky.mean(axis=1),
        sky_of={d: sky_power.at(d, GRID_HOURS) for d in DIPOLES},
        sky_at=lambda hours: np.stack([sky_power.at(d, hours) for d in DIPOLES]),
        antenna_gain=instrument.antenna_gain,
        receiver_gain=instrument.receiver_gain,
        noise=noise_constants(instrument),
        cable_log_loss=np.zeros((len(DIPOLES), instrument.frequency_mhz.size)),
        sky_ratio={name: ratio.at(DIPOLES, GRID_HOURS) for name, ratio in sky_ratios(instrument).items()},
        known_noise=prior.mean if prior.is_known else None,
    )
    level = float((sky @ weights).mean() / prior.stages.sum())
    lna, receiver, adc = (level * stage for stage in prior.stages)
    at_antenna = np.divide(lna, weights, out=np.zeros_like(lna), where=weights > 0)
    return CurveStation(conditions, ChainTerms(sky, at_antenna, weights[None, None], receiver, adc), prior)


def list_choices(station: CurveStation) -> list[Choice]:
    """The causes that act along an axis of the curve and bend it, in the order in which they act."""
    conditions, known = station.conditions, axes_of(station.conditions)
    choices = [
        Choice(cause, template, cause.scale(station.terms), is_alias)
        for cause in CAUSES
        if known & set(cause.axes)
        for is_alias, templates in ((False, cause.templates(conditions)), (True, cause.far_templates(conditions)))
        for template in templates
    ]
    return [choice for choice in choices if not station.is_described(choice)]


def why_not(station: CurveStation, choices: Sequence[Choice]) -> Mapping[str, str]:
    """Causes of the catalogue that are not among the choices, with the reason."""
    known, chosen = axes_of(station.conditions), {choice.cause.identifier for choice in choices}
    reasons = {}
    for one in DESCRIPTIONS:
        if one.identifier in chosen:
            continue
        if not known & set(one.axes):
            reasons[one.identifier] = f"it acts along {' and '.join(one.axes)}, and the curve is a mean over them"
        elif isinstance(one, Cause) and not one.templates(station.conditions):
            reasons[one.identifier] = one.needs
        else:
            reasons[one.identifier] = ABSORBED
    return reasons
