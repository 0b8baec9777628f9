"""The causes that a band-averaged LST curve can show, each as what it does to P_sky of both dipoles.

A cause that needs a direction acts by ratio, P_sky times own(with)/own(without), from the package's own sky and antenna
computed at a few sizes and interpolated: these effects are not linear (half a power of the cosine is a large change).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from lbacal_core.causes.directions import SOURCE_KEYS
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.instrument import DIPOLES, Instrument
from lbacal_core.sky.sources import SOURCES
from lbacal_core.skypower.sources import source_sky_power
from lbacal_core.skypower.table import SkyPower
from lbacal_core.skypower.variation import vary_sky_power

Power = Mapping[str, Floats]
"""P_sky by dipole letter, shape (lst, freq)."""

OTHER = {"X": "Y", "Y": "X"}
EDGE = 1e-3
"""Of a range."""
FLAT_IN_LST = "averaged over the year and the band it only changes the level, which is free"
NEEDS_MORE_AXES = {
    **dict.fromkeys(
        ("resonance_shift", "resonance_width", "filter_shift", "cable_length", "cable_reflection"),
        "it acts along frequency or on single antennas, and the curve is an average over both",
    ),
    **dict.fromkeys(
        ("lna_noise_temperature", "gain_temperature", "cable_temperature", "gain_step", "gain_drift", "adc_noise_step"),
        "it acts along date or temperature, and every LST bin averages over the year",
    ),
    **dict.fromkeys(
        ("solar_emission", "ionospheric_absorption", "rfi_line", "rfi_broadband"),
        "it acts along the time of day, which a year spreads over all LST; how much of it is left depends on when the "
        "events were taken",
    ),
    "lna_noise_slope": FLAT_IN_LST,
    "adc_jitter": "its power follows that of the sky, so that it only changes the level, which is free",
}


@dataclass(frozen=True)
class CurveCause:
    """A cause that acts on P_sky, with the range of its size.

    Attributes
    ----------
    act
        (P_sky by dipole on the grid, size) -> changed P_sky by dipole.
    kinds
        Causes that share a kind do the same to a band-averaged curve and are never fitted together.
    starts
        Sizes from which a fit starts.
    reported
        Factor from the fitted size to the size in `unit`.
    is_alias
        Whether it says in other words what another cause says; it is listed as an alternative, never named first.
    may_reach
        An end of the range that is physical, not the end of what is believed.
    """

    identifier: str
    unit: str
    meaning: str
    confirm: str
    lowest: float
    highest: float
    act: Callable[[Power, float], dict[str, Floats]]
    kinds: frozenset[str]
    starts: tuple[float, ...] = (0.02,)
    reported: float = 1.0
    parameters: Mapping[str, str] = field(default_factory=dict)
    is_alias: bool = False
    may_reach: float | None = None

    @property
    def label(self) -> str:
        """Identifier, with the source where it names one."""
        return " ".join([self.identifier, *self.parameters.values()])

    def is_at_edge(self, size: float) -> bool:
        """Whether a size has run to the end of its range: then the cause does not describe the data."""
        if self.may_reach is not None and abs(size - self.may_reach) < EDGE * (self.highest - self.lowest):
            return False
        return min(size - self.lowest, self.highest - size) < EDGE * (self.highest - self.lowest)


def curve_causes(instrument: Instrument, sky_power: SkyPower, weights: Floats) -> list[CurveCause]:
    """The causes in the order in which they act: from the sky through the beam and the letters to the receiver.

    Parameters
    ----------
    weights
        Of the channels in the band, shape (freq,).
    """
    return [*_beam_causes(instrument, sky_power.lst_hours), *_chain_causes(sky_power, weights)]


def _beam_causes(instrument: Instrument, lst_hours: Floats) -> list[CurveCause]:
    """Causes that need directions; none where the own models do not cover the instrument's channels."""
    try:
        own = vary_sky_power(instrument, lst_hours=lst_hours).power
    except BadInputError:
        return []
    causes = []
    for name, key in SOURCE_KEYS.items():
        share = {d: source_sky_power(instrument, SOURCES[key], d, lst_hours) / own[d] for d in DIPOLES}
        act, kinds, confirm = _added(share), frozenset({name}), "follow the excess through the source's transit"
        causes.append(
            CurveCause(
                "point_source", "fraction of its flux", f"{name} is wrong in the sky model", confirm,
                -1.5, 5.0, act, kinds, parameters={"source": name},
            )
        )  # fmt: skip
    zenith = np.linspace(-1.5, 1.5, 7)
    turned = np.arange(8) * 22.5
    at_zenith = [vary_sky_power(instrument, lst_hours=lst_hours, zenith_exponent=n).power for n in zenith]
    wider = vary_sky_power(instrument, lst_hours=lst_hours, zenith_gain_fraction=0.2).power
    by_width = {d: (wider[d] / own[d] - 1) / 0.2 for d in DIPOLES}
    at_azimuth = [vary_sky_power(instrument, lst_hours=lst_hours, azimuth_deg=angle).power for angle in turned]
    turn = _by_turning(own, at_azimuth)
    return [
        *causes,
        CurveCause(
            "zenith_weighting", "exponent", "the sky integral weighs with a wrong power of cos(zenith)",
            "repeat the integral for a uniform sky, whose value is known for every power of the cosine",
            -1.5, 1.5, _by_ratio(own, at_zenith, zenith), frozenset({"zenith"}),
        ),
        CurveCause(
            "pattern_width", "fraction", "the antenna pattern is too wide or too narrow",
            "measure the pattern with a source on a drone",
            -0.35, 0.35, _added(by_width), frozenset({"width"}),
        ),
        CurveCause(
            "dipole_azimuth", "deg", "the arms of the dipoles stand at another azimuth", "survey the antennas",
            -45.0, 45.0, turn, frozenset({"azimuth"}), starts=(5.0, -5.0),
        ),
        CurveCause(
            "dipole_azimuth", "deg", "the arms stand across to what is on record, which exchanges X and Y",
            "survey the antennas, or unplug one dipole", 45.0, 135.0, turn, frozenset({"azimuth", "exchange"}),
            starts=(90.0,), parameters={"near": "90 deg"}, is_alias=True,
        ),
    ]  # fmt: skip


def _chain_causes(sky_power: SkyPower, weights: Floats) -> list[CurveCause]:
    """Causes that need no direction."""
    order = np.fft.rfftfreq(sky_power.lst_hours.size, 1.0 / sky_power.lst_hours.size)
    mean = {d: sky_power.power[d].mean(axis=0) for d in DIPOLES}
    level = float(np.mean([mean[d] @ weights for d in DIPOLES]))

    def swapped(power: Power, size: float) -> dict[str, Floats]:
        return {d: (1 - size) * power[d] + size * power[OTHER[d]] for d in DIPOLES}

    def moved(power: Power, size: float) -> dict[str, Floats]:
        turn = np.exp(2j * np.pi / 24.0 * size * order)[:, None]
        return {d: np.fft.irfft(np.fft.rfft(power[d], axis=0) * turn, power[d].shape[0], axis=0) for d in DIPOLES}

    def raised(power: Power, size: float) -> dict[str, Floats]:
        return {d: power[d] + size * mean[d] for d in DIPOLES}

    def noisy(power: Power, size: float) -> dict[str, Floats]:
        return {d: power[d] + size * level for d in DIPOLES}

    def compressed(power: Power, size: float) -> dict[str, Floats]:
        total = {d: power[d] @ weights for d in DIPOLES}
        return {d: power[d] * (1 - size * (total[d] / total[d].mean() - 1))[:, None] for d in DIPOLES}

    return [
        CurveCause(
            "dipole_swap", "share, 1 = exchanged", "the dipoles X and Y are mixed or exchanged",
            "unplug one dipole, or compare the azimuths of the arms with the file that names them",
            0.0, 1.0, swapped, frozenset({"exchange"}), starts=(0.9, 0.05), may_reach=1.0,
        ),
        CurveCause(
            "lst_offset", "h", "the sidereal time of data or simulation is off",
            "ask whether lst_h is the edge or the centre of the bin; follow the transit of a source of known right "
            "ascension", -3.0, 3.0, moved, frozenset({"lst"}),
        ),
        CurveCause(
            "missing_noise", "W/MHz, in the unit of P_sky", "a stage of electronic noise is missing",
            "measure the noise with a dummy load, or fit event spectra, where noise has another slope in frequency",
            0.0, 10.0, noisy, frozenset({"level"}), reported=level,
        ),
        CurveCause(
            "isotropic_level", "fraction of the mean sky power", "the isotropic part of the sky is wrong",
            "compare with an absolute measurement of the sky minimum", -0.5, 10.0, raised, frozenset({"level"}),
        ),
        CurveCause(
            "compression", "fraction", "the gain falls where the power is high",
            "put an attenuator in front of the receiver, or compare cables of 50 and 115 m", 0.0, 1.0, compressed,
            frozenset({"compression"}),
        ),
    ]  # fmt: skip


def _added(share: Power) -> Callable[[Power, float], dict[str, Floats]]:
    return lambda power, size: {d: power[d] * (1 + size * share[d]) for d in DIPOLES}


def _by_ratio(own: Power, varied: list[Mapping[str, Floats]], sizes: Floats) -> Callable[..., dict[str, Floats]]:
    """P times exp of the polynomial through ln(own(size)/own(0)) at the sizes computed."""
    logs = {d: np.stack([np.log(one[d] / own[d]) for one in varied]) for d in DIPOLES}
    inverse = np.linalg.inv(np.vander(sizes))
    terms = {d: np.einsum("kn,ntf->ktf", inverse, logs[d]) for d in DIPOLES}
    powers = np.arange(sizes.size)[::-1]

    def act(power: Power, size: float) -> dict[str, Floats]:
        basis = float(size) ** powers
        return {d: power[d] * np.exp(np.tensordot(basis, terms[d], 1)) for d in DIPOLES}

    return act


def _by_turning(own: Power, turned: list[Mapping[str, Floats]]) -> Callable[..., dict[str, Floats]]:
    """P times own(turned)/own: a Fourier series in twice the angle, since an arm points both ways."""
    count = len(turned)
    terms = {d: np.fft.rfft(np.stack([one[d] for one in turned]), axis=0) / count for d in DIPOLES}
    order = np.arange(count // 2 + 1)
    weight = np.where((order == 0) | (2 * order == count), 1.0, 2.0)

    def act(power: Power, size: float) -> dict[str, Floats]:
        basis = weight * np.exp(2j * order * np.radians(size))
        return {d: power[d] * np.tensordot(basis, terms[d], 1).real / own[d] for d in DIPOLES}

    return act
