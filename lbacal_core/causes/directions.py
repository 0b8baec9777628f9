"""Changes of P_sky that need directions: own(with)/own(without), from the package's own sky and antenna.

The ratio is computed at a few sizes and holds for any between: half a power of the cosine is far from a small change.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument
from lbacal_core.linear import pseudo_invert
from lbacal_core.sky.sources import SOURCES
from lbacal_core.skypower.sources import source_sky_power
from lbacal_core.skypower.table import SkyPower, read_at
from lbacal_core.skypower.variation import vary_sky_power

SOURCE_KEYS = {"Cas A": "cas-a", "Cyg A": "cyg-a", "Tau A": "tau-a", "Vir A": "vir-a"}
EXPONENTS = (0.1, 0.5, 1.0, 1.5)
"""Powers of cos(zenith) at which the ratio is computed; a polynomial through them gives any between."""
TURNS_DEG = tuple(22.5 * k for k in range(8))
"""Angles over half a turn; the beam of a dipole has nothing above six times the azimuth."""


@dataclass(frozen=True)
class SkyRatio:
    """P_sky with a cause over P_sky without it, for any size.

    Attributes
    ----------
    terms
        Coefficients by dipole on a regular grid of LST, shape (term, lst, freq).
    evaluate
        From terms, shape (term, ...), and an amount to the ratio.
    """

    terms: Mapping[str, Floats]
    evaluate: Callable[[Floats, Floats], Floats]

    def at(self, dipoles: Sequence[str], lst_hours: Floats) -> Callable[[Floats], Floats]:
        """The ratio at events as a function of the amount, shape (class, event, freq)."""
        return partial(self.evaluate, np.stack([read_at(self.terms[d], lst_hours) for d in dipoles], axis=1))


def sky_ratios(instrument: Instrument) -> dict[str, SkyRatio]:
    """Ratios by which P_sky changes, by the name of the cause or of the source.

    Empty where the own models do not cover the instrument's channels.
    """
    try:
        own = vary_sky_power(instrument)
    except BadInputError:
        return {}
    shares = {
        name: {
            d: source_sky_power(instrument, SOURCES[key], d, own.lst_hours) / own.power[d] for d in instrument.dipoles
        }
        for name, key in SOURCE_KEYS.items()
    }
    wider = vary_sky_power(instrument, zenith_gain_fraction=0.2).power
    shares["pattern_width"] = {d: (wider[d] / own.power[d] - 1.0) / 0.2 for d in instrument.dipoles}
    turned = [vary_sky_power(instrument, azimuth_deg=angle) for angle in TURNS_DEG]
    powers = [vary_sky_power(instrument, zenith_exponent=exponent) for exponent in EXPONENTS]
    return {
        **{name: SkyRatio({d: share[d][None] for d in instrument.dipoles}, _add) for name, share in shares.items()},
        "dipole_azimuth": SkyRatio({d: _series(own, turned, d) for d in instrument.dipoles}, _turn),
        "zenith_weighting": SkyRatio({d: _polynomial(own, powers, d) for d in instrument.dipoles}, _exponentiate),
    }


def _add(terms: Floats, amount: Floats) -> Floats:
    """1 + amount x the share of P_sky that is added."""
    return np.asarray(1.0 + amount * terms[0])


def _polynomial(own: SkyPower, varied: Sequence[SkyPower], dipole: str) -> Floats:
    """Coefficients of the polynomial in the size, 0 at 0, through ln(own(size)/own(0)); the linear term last."""
    logs = np.stack([np.log(one.power[dipole] / own.power[dipole]) for one in varied])
    sizes = np.array(EXPONENTS)
    return np.asarray(np.einsum("kn,ntf->ktf", pseudo_invert(np.vander(sizes) * sizes[:, None]), logs))


def _exponentiate(terms: Floats, amount: Floats) -> Floats:
    """Exp of the polynomial: the ratio stays positive.

    A power too many in the simulation, a negative amount, is taken out by own(0)/own(power), the exact inverse, which
    is not own(-power)/own(0): that one weighs the horizon without limit.
    """
    power = np.abs(amount)
    value = terms[0] * power
    for term in terms[1:]:
        value = (value + term) * power
    return np.asarray(np.exp(np.sign(amount) * value))


def _series(own: SkyPower, turned: Sequence[SkyPower], dipole: str) -> Floats:
    """Cosine and sine terms of the Fourier series of own(turned)/own(0) in twice the angle: an arm points both ways."""
    count = len(turned)
    terms = np.fft.rfft(np.stack([one.power[dipole] for one in turned]), axis=0) / count / own.power[dipole]
    terms[1 : (count + 1) // 2] *= 2.0
    return np.concatenate([terms.real, -terms.imag])


def _turn(terms: Floats, amount: Floats) -> Floats:
    """The Fourier series at an angle in degrees."""
    cosines, sines = np.split(terms, 2)
    angle = 2.0 * np.radians(amount)
    ratio = cosines[0] + 0.0 * angle
    for order in range(1, len(cosines)):
        ratio = ratio + np.cos(order * angle) * cosines[order] + np.sin(order * angle) * sines[order]
    return np.asarray(ratio)
