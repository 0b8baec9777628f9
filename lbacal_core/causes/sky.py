"""Causes in the sky and on its way to the antenna."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from lbacal_core.causes.cause import Cause, Conditions, SizeRange, Template
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.instrument.chain import ChainTerms
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.linear import pseudo_invert
from lbacal_core.provenance import Remembered
from lbacal_core.sky.model import SOURCES
from lbacal_core.sky.power import vary_sky_power
from lbacal_core.sky.sources import source_sky_power
from lbacal_core.sky.table import SkyPower, read_at

# Changes of P_sky that need directions: own(with)/own(without), from the package's own sky and antenna.
#
# The ratio is computed at a few sizes and holds for any between: half a power of the cosine is far from a small change.

SOURCE_KEYS = {"Cas A": "cas-a", "Cyg A": "cyg-a", "Tau A": "tau-a", "Vir A": "vir-a"}
EXPONENTS = (0.1, 0.5, 1.0, 1.5)
LARGEST_LOG = 50.0
"""Ln of a ratio, at most: a step of a fit far outside these sizes stays finite."""
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


_RATIOS: Remembered[str, Mapping[str, SkyRatio]] = Remembered(8)
"""By the hash of what they are computed from, sky and antenna models by their content: every station asks for them."""


def sky_ratios(instrument: Instrument) -> Mapping[str, SkyRatio]:
    """Ratios by which P_sky changes, by the name of the cause or of the source.

    Empty where the own models do not cover the instrument's channels.
    """
    try:
        own = vary_sky_power(instrument)
    except BadInputError:
        return {}

    def make() -> Mapping[str, SkyRatio]:
        shares = {
            name: {
                d: source_sky_power(instrument, SOURCES[key], d, own.lst_hours) / own.power[d]
                for d in instrument.dipoles
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

    return _RATIOS.get(own.digest(), make)


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
    return np.asarray(np.exp(np.clip(np.sign(amount) * value, -LARGEST_LOG, LARGEST_LOG)))


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


NO_DIRECTIONS = "the own sky and antenna model do not cover these channels"
NO_SUN = "the Sun is always up, or always down, in these data, or no antenna model covers these channels"


def move_in_time(terms: ChainTerms, conditions: Conditions, amount: Floats) -> ChainTerms:
    """P_sky at a later LST; the amount is in hours."""
    return replace(terms, sky=conditions.later(terms.sky, np.ravel(amount)))


def add_level(terms: ChainTerms, conditions: Conditions, amount: Floats) -> ChainTerms:
    """P_sky plus a constant in LST; the amount is a fraction of the mean P_sky at each frequency."""
    return replace(terms, sky=terms.sky + amount * conditions.mean_sky[:, None, :])


@dataclass(frozen=True)
class SkyChange(Cause):
    """A change of P_sky that needs directions, taken from the package's own sky and antenna as a ratio."""

    needs: str = NO_DIRECTIONS
    acts_by_ratio: bool = True

    def templates(self, conditions: Conditions) -> list[Template]:
        """One, where the own sky could be computed for these channels."""
        return [Template()] if self.identifier in conditions.sky_ratio else []

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:
        """P_sky recomputed with it.

        A source adds a fraction of its flux through D.
        """
        name = template.parameters.get("source", self.identifier)
        return replace(terms, sky=terms.sky * conditions.sky_ratio[name](amount))


@dataclass(frozen=True)
class DipoleAzimuth(SkyChange):
    """The arms stand at another azimuth."""

    identifier: str = "dipole_azimuth"
    unit: str = "deg"
    meaning: str = "the arms of the dipoles stand at another azimuth"
    confirm: str = "survey the antennas"
    scopes: Sequence[str] = ("station", "antenna")
    step: float = 0.02
    sizes: SizeRange = SizeRange(-45.0, 45.0, starts=(5.0, -5.0))

    def far_templates(self, conditions: Conditions) -> list[Template]:
        """Across to what is on record, which exchanges X and Y."""
        return [Template({"near": "90 deg"}) for _ in self.templates(conditions)]

    def sizes_of(self, template: Template) -> SizeRange:
        """About no turn, or about a right angle."""
        return SizeRange(45.0, 135.0, starts=(90.0,)) if template.parameters else self.sizes

    def kinds(self, template: Template) -> frozenset[str]:
        """A right angle is an exchange of X and Y too."""
        return frozenset({self.identifier, "dipole_swap"} if template.parameters else {self.identifier})


@dataclass(frozen=True)
class PointSource(SkyChange):
    """A named source that the sky model lacks or has too strong."""

    identifier: str = "point_source"
    unit: str = "fraction of its flux"
    meaning: str = "a named source is wrong in the sky model"
    confirm: str = "look whether the excess follows the source through its transit at each frequency"
    spectral_parameters: Sequence[str] = ("source",)
    sizes: SizeRange = SizeRange(-1.5, 5.0)

    def templates(self, conditions: Conditions) -> list[Template]:
        """One a source."""
        return [Template({"source": name}) for name in SOURCE_KEYS if name in conditions.sky_ratio]

    def is_another(self, template: Template, earlier: Template) -> bool:
        """Whether the sources differ."""
        return bool(template.parameters["source"] != earlier.parameters["source"])


@dataclass(frozen=True)
class SolarEmission(Cause):
    """The quiet Sun, P proportional to nu^1..2 times D towards it."""

    identifier: str = "solar_emission"
    unit: str = "fraction of the mean sky power at 55 MHz, Sun overhead"
    sizes: SizeRange = SizeRange(0.0, 3.0)
    meaning: str = "the Sun adds power by day"
    confirm: str = "compare with solar monitoring, and days of high activity with quiet ones"
    needs: str = NO_SUN
    axes: Sequence[str] = ("utc", "date")
    spectral_parameters: Sequence[str] = ("spectral_index",)

    def templates(self, conditions: Conditions) -> list[Template]:
        """Spectral indices of the power between 1 and 2, where the Sun rises and sets in the data."""
        if conditions.sun_response is None or not conditions.has_day_and_night:
            return []
        return [Template({"spectral_index": index}) for index in (1.0, 1.5, 2.0)]

    def finer_templates(self, conditions: Conditions, template: Template) -> list[Template]:  # noqa: ARG002
        """All spectral indices, as `templates`."""
        return self.templates(conditions)

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:
        """P_sky plus the Sun through D.

        The amount is over the mean P_sky at 55 MHz, for the Sun overhead.
        """
        ratio = conditions.frequency_mhz / 55.0
        flux = conditions.sky_at_55[:, None, None] * ratio ** template.parameters["spectral_index"]
        return replace(terms, sky=terms.sky + amount * flux * conditions.sun_response)


@dataclass(frozen=True)
class IonosphericAbsorption(Cause):
    """Absorption in the sunlit lower ionosphere, tau = tau_30 (30 MHz / nu)^2 (cos chi)^n."""

    identifier: str = "ionospheric_absorption"
    unit: str = "tau at 30 MHz, Sun overhead"
    sizes: SizeRange = SizeRange(0.0, 3.0)
    meaning: str = "the daytime ionosphere absorbs"
    confirm: str = "compare with a riometer or with absorption maps from ionosondes"
    needs: str = NO_SUN
    axes: Sequence[str] = ("utc", "date")

    def templates(self, conditions: Conditions) -> list[Template]:
        """Exponents between 0.5 and 1, where the Sun rises and sets in the data."""
        return [Template({"exponent": n}) for n in (0.5, 0.75, 1.0)] if conditions.has_day_and_night else []

    def finer_templates(self, conditions: Conditions, template: Template) -> list[Template]:  # noqa: ARG002
        """All exponents, as `templates`."""
        return self.templates(conditions)

    def time_profile(self, conditions: Conditions, template: Template) -> Floats:
        """(cos chi)^n by day, 0 by night, shape (event, 1)."""
        cos_chi = np.maximum(np.sin(conditions.sun_altitude), 0.0)
        return np.asarray((cos_chi ** template.parameters["exponent"])[:, None])

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:  # noqa: ARG002
        """P_sky dimmed.

        It is multiplied by exp(-amount (30 MHz / nu)^2).
        """
        return replace(terms, sky=terms.sky * np.exp(-amount * (30.0 / conditions.frequency_mhz) ** 2))


# Causes from outside that are not the sky: radio-frequency interference left in the spectra.

CLEAR_MHZ = 4.0
"""Distance below which two lines are one disturbance, whose spectrum is not that of a line."""
WINDOWS = ((0, 24), *((begin, (begin + hours) % 24) for hours in (12, 6) for begin in range(24)))
"""UTC hours of the templates: the whole day, and halves and quarters of it from every hour."""


@dataclass(frozen=True)
class InterferenceCause(Cause):
    """Power from outside at some hours of the day."""

    needs: str = "the events do not cover all hours of the day"
    axes: Sequence[str] = ("utc",)

    def time_profile(self, conditions: Conditions, template: Template) -> Floats:
        """1 within the hours of the template, else 0, shape (event, 1)."""
        return conditions.in_hours(*template.parameters["utc_h"])

    def finer_templates(self, conditions: Conditions, template: Template) -> list[Template]:  # noqa: ARG002
        """Hours that begin and end some earlier or later, or all others: power cannot be missing."""
        return [
            Template({**what, "utc_h": list(window)})
            for what in self.what_about(template)
            for window in _windows_about(*template.parameters["utc_h"])
        ]

    def what_about(self, template: Template) -> list[dict[str, float]]:
        """Frequencies, widths or indices about those of a template."""
        raise NotImplementedError


@dataclass(frozen=True)
class RfiLine(InterferenceCause):
    """A narrow line left in one channel or a few at some hours."""

    identifier: str = "rfi_line"
    unit: str = "fraction of the mean power in its strongest channel"
    sizes: SizeRange = SizeRange(0.0, 1e3)
    meaning: str = "a narrow line of interference is left"
    confirm: str = "look at the unbinned spectra of those hours"
    scopes: Sequence[str] = ("station", "antenna")
    spectral_parameters: Sequence[str] = ("frequency_mhz", "width_mhz")

    def templates(self, conditions: Conditions) -> list[Template]:
        """Every channel, one channel or some three wide, at halves and quarters of the day."""
        if not conditions.has_all_hours:
            return []
        return [
            Template({"frequency_mhz": float(centre), "width_mhz": width, "utc_h": list(window)})
            for centre in conditions.frequency_mhz
            for width in (0.5, 2.0)
            for window in WINDOWS
        ]

    def is_another(self, template: Template, earlier: Template) -> bool:
        """Whether it is a line that is clear of the first."""
        distance = abs(template.parameters["frequency_mhz"] - earlier.parameters["frequency_mhz"])
        return bool(distance > CLEAR_MHZ)

    def factor(self, conditions: Conditions, template: Template) -> Floats:
        """The form of the line, 1 in its strongest channel, shape (freq,)."""
        distance = conditions.frequency_mhz - template.parameters["frequency_mhz"]
        line = np.exp(-4 * np.log(2.0) * (distance / template.parameters["width_mhz"]) ** 2)
        return np.asarray(line / line.max())

    def flat(self, template: Template) -> Template:
        """A line without end."""
        return Template({**template.parameters, "width_mhz": np.inf})

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:
        """Power added about a frequency, a Gaussian of the template's full width at half maximum.

        The amount is over the mean power in the strongest channel.
        """
        mean = terms.power().mean(axis=1, keepdims=True)
        return replace(terms, adc_noise=terms.adc_noise + amount * self.factor(conditions, template) * mean)

    def what_about(self, template: Template) -> list[dict[str, float]]:
        """Frequencies between the channels, and other widths, MHz."""
        centre = template.parameters["frequency_mhz"]
        moved = [centre + 0.25 * k for k in range(-2, 3)]
        return [{"frequency_mhz": at, "width_mhz": width} for at in moved for width in (0.5, 1.0, 1.5, 2.0)]


@dataclass(frozen=True)
class RfiBroadband(InterferenceCause):
    """Broad-band interference at some hours, with a power law in frequency."""

    identifier: str = "rfi_broadband"
    unit: str = "fraction of the mean sky power at 55 MHz"
    sizes: SizeRange = SizeRange(0.0, 1e2)
    meaning: str = "broad-band interference is left"
    confirm: str = "look for its direction by correlating antennas at those hours"
    spectral_parameters: Sequence[str] = ("spectral_index",)

    def templates(self, conditions: Conditions) -> list[Template]:
        """Spectral indices 0 to -4 at halves and quarters of the day."""
        if not conditions.has_all_hours:
            return []
        indices = (0.0, -1.0, -2.0, -3.0, -4.0)
        return [Template({"spectral_index": index, "utc_h": list(window)}) for index in indices for window in WINDOWS]

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:
        """Power in front of the antenna's amplifier, as a fraction of the mean sky power at 55 MHz."""
        ratio = conditions.frequency_mhz / 55.0
        added = conditions.sky_at_55[:, None, None] * ratio ** template.parameters["spectral_index"]
        return replace(terms, sky=terms.sky + amount * added)

    def what_about(self, template: Template) -> list[dict[str, float]]:  # noqa: ARG002
        """All spectral indices from 0 to -4, by halves."""
        return [{"spectral_index": -0.5 * k} for k in range(9)]


def _windows_about(begin: float, end: float) -> list[tuple[float, float]]:
    """Windows that begin and last up to three hours more or less, by quarters, and the rest of the day."""
    if (begin, end) == (0, 24):
        return [(0, 24)]
    moved, hours = np.linspace(-3.0, 3.0, 25), (end - begin) % 24
    begins, lasting = ((begin + moved) % 24)[:, None], hours + moved
    first, last = (a.ravel().tolist() for a in np.broadcast_arrays(begins, (begins + lasting) % 24))
    return sorted({*zip(first, last, strict=True), *zip(last, first, strict=True)})
