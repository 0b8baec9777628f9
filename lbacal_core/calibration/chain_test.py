"""The chain test with the sky free within what is known of it: whether the model describes the data at all.

Two things must hold. The intercepts of all channels follow from three noise constants, b = N_LNA s + H q. And along LST
nothing is left beside the lines: the residual of an event, projected on a few smooth functions of frequency, follows no
harmonic of the sidereal day. Exchanged letters, a wrong clock or another antenna's pattern change what is left along
LST first, because a line in each channel absorbs most of what they do to the intercepts.

Where a sky is known to some precision, d ln P_sky = sum_k a_k m_k(LST, nu) with a_k ~ N(0, 1). It moves the measured
lines and what is left beside them by known vectors G (the response of the fit itself), so that both, as one vector r,
have the covariance V + G^T G (V: noise), and

    chi^2 = min over (N_LNA, q) of r^T (V + G^T G)^-1 r

has as many degrees of freedom as r has numbers, less three, and less those of the sky that the data determine, the
trace of G (V + G^T G)^-1 G^T. What the best sky departs from the one given, sum_k a_k^2, counts in full: a sky that is
off by one standard deviation in each mode costs one for each, a wrong clock hundreds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light
from scipy.special import chdtrc
from threadpoolctl import threadpool_limits

from lbacal_core.antenna.ideal import QuarterWaveDipole, ShortDipole
from lbacal_core.antenna.model import AntennaModel
from lbacal_core.antenna.names import load_antenna
from lbacal_core.calibration.lines import (
    SKY_HARMONICS,
    Lines,
    Look,
    PathLines,
    harmonics_at,
    look_beside,
    move_lines,
    move_lines_by,
)
from lbacal_core.chain.model import Intercepts
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.linear import find_whitener, invert_symmetric, solve_symmetric
from lbacal_core.provenance import hash_content
from lbacal_core.skypower.antenna_of import antenna_of
from lbacal_core.skypower.differences import LST_HOURS, DifferenceModels, compute_model_differences
from lbacal_core.skypower.model import compute_sky_power, vary_sky_power

# What P_sky would be with other antennas than the one that an instrument names.
#
# What they change most is the level of P_sky, by a factor of 2 and more where a dipole stands half a wavelength above
# the ground. The fit absorbs a level in A(nu), which is free, so that C is wrong by its root where the antenna is
# another.

PHASES = np.linspace(1.0, 3.0, 11)
"""Heights of short dipoles, k h at the highest channel: 0.6 to 1.8 m at 80 MHz. At pi the zenith is dark."""
SAME = 0.01
"""An antenna that changes P_sky by less, r.m.s., is the same."""


@dataclass(frozen=True)
class OtherAntenna:
    """Another antenna.

    Attributes
    ----------
    change
        By dipole, ln of P_sky with it over P_sky, shape (lst, freq), on a regular grid of the sidereal day from 0 h.
    share
        Its probability among the others before the data are asked: kinds are alike, and so are heights of one kind.
    """

    name: str
    change: Mapping[str, Floats]
    share: float = 1.0


def exchange_antennas(
    instrument: Instrument, power: Mapping[str, Floats], lst_hours: Floats, antennas: Mapping[str, str | AntennaModel]
) -> Iterator[OtherAntenna]:
    """What antennas make of P_sky, by dipole, shape (lst, freq); those that change nothing are left out."""
    own = load_antenna(antenna_of(instrument)).name
    for name, antenna in antennas.items():
        try:
            other = compute_sky_power(instrument, antenna=antenna, lst_hours=lst_hours).power
        except BadInputError:
            # a pattern that is not known at these channels or for a tilted arm
            continue
        change = {dipole: np.log(other[dipole] / one) for dipole, one in power.items()}
        if name != own and max(float(np.sqrt(np.mean(one**2))) for one in change.values()) > SAME:
            yield OtherAntenna(name, change)


def list_other_antennas(instrument: Instrument, power: Mapping[str, Floats], lst_hours: Floats) -> list[OtherAntenna]:
    """Dipoles over lossy ground and over a conducting plane, at heights between which data cannot tell."""
    wavenumber = 2.0 * np.pi * 1e6 * float(instrument.frequency_mhz.max()) / speed_of_light
    heights = (PHASES / wavenumber).tolist()
    kinds: list[dict[str, str | AntennaModel]] = [
        {"hamaker": "hamaker"},
        {"quarter-wave": QuarterWaveDipole()},
        {f"a short dipole at {height:.2f} m": ShortDipole(height_m=height) for height in heights},
    ]
    found = [list(exchange_antennas(instrument, power, lst_hours, kind)) for kind in kinds]
    count = sum(len(kind) > 0 for kind in found)
    return [replace(one, share=1.0 / count / len(kind)) for kind in found for one in kind]


# Mistakes that users have made, as changes of P_sky: the data say whether one describes them better.
#
# Where the sky may follow waves along LST that no model has, data with a mistaken input are not improbable by
# themselves. They are still far more probable with the input set right. The gain of a mistake is ln of the probability
# of the data with P_sky as it would be, over that with P_sky as it is, both with the sky free within what is known of
# it. Where nothing is wrong, a gain of g or more has a probability of at most exp(-g).

LARGEST_GAIN = 10.0
"""Both polarisations together; 24 antennas of clean drawn worlds reach -0.4, exchanged letters 15 and more."""
LIKELY_MISTAKE = "likely mistake"
"""Under this name the notes of a report hold them."""
CLOCK_HOURS = (-2, -1, 1, 2)
OTHER_ANTENNAS = ("hamaker", "short-dipole", "quarter-wave")
"""A dipole over lossy ground, a short one over a conducting plane, and one whose height grows with the wavelength."""
Owner = tuple[str | None, int | None]
"""Station and antenna of a curve."""


@dataclass(frozen=True)
class Mistake:
    """What P_sky would be without a mistake.

    Attributes
    ----------
    name
        What is wrong, in words.
    change
        By dipole, ln of P_sky without the mistake over P_sky, shape (lst, freq), on the grid of the freedom of the sky.
    antenna
        The antenna that it is, where the antenna is wrong. The fit absorbs its level in A(nu), which is free, so that
        only its form along LST shows, and the level is what makes C wrong.
    """

    name: str
    change: Mapping[str, Floats]
    antenna: str | None = None

    def shown(self, dipole: str) -> Floats:
        """What data can show of the change, shape (lst, freq)."""
        change = self.change[dipole]
        return change if self.antenna is None else change - change.mean(axis=0)


def list_mistakes(instrument: Instrument, power: Mapping[str, Floats], lst_hours: Floats) -> list[Mistake]:
    """Letters exchanged, times in another zone, the pattern of another antenna.

    Parameters
    ----------
    power
        P_sky by dipole, shape (lst, freq), on `lst_hours`, a regular grid of the sidereal day.
    """
    mistakes = []
    for one, other in combinations(sorted(power), 2):
        exchanged = {one: other, other: one}
        change = {dipole: np.log(power[exchanged.get(dipole, dipole)] / power[dipole]) for dipole in power}
        mistakes.append(Mistake(f"dipoles {one} and {other} exchanged", change))
    steps = lst_hours.size / 24.0
    for hours in CLOCK_HOURS:
        late = {dipole: np.log(np.roll(one, round(-hours * steps), axis=0) / one) for dipole, one in power.items()}
        mistakes.append(Mistake(f"times {abs(hours)} h too {'late' if hours < 0 else 'early'}", late))
    others = exchange_antennas(instrument, power, lst_hours, {name: name for name in OTHER_ANTENNAS})
    return [*mistakes, *(Mistake(f"the antenna is like {one.name}", one.change, one.name) for one in others)]


def name_mistakes(found: Sequence[tuple[CalibrationCurve, Floats]], mistakes: Sequence[Mistake]) -> dict[Owner, str]:
    """The likely mistake of each antenna, station or array where there is one: its dipoles share it.

    Parameters
    ----------
    found
        Curves with the gain of each mistake, shape (mistake,).
    """
    total: dict[Owner, Floats] = {}
    for curve, gain in found:
        total[curve.owner] = total.get(curve.owner, np.zeros(len(mistakes))) + gain
    return {
        owner: mistakes[int(np.argmax(gain))].name
        for owner, gain in total.items()
        if gain.size and float(np.max(gain)) > LARGEST_GAIN
    }


def describe_mistakes(mistaken: Mapping[Owner, str]) -> str:
    """What may be wrong, the most frequent first, with the first antenna or station that shows it."""
    owners: dict[str, list[Owner]] = {}
    for owner, name in mistaken.items():
        owners.setdefault(name, []).append(owner)
    order = sorted(owners, key=lambda name: (-len(owners[name]), name))
    return "; ".join(f"{name} ({_name(owners[name][0])}{_more(len(owners[name]) - 1)})" for name in order)


def _name(owner: Owner) -> str:
    station, antenna = owner
    return (station or "array") + ("" if antenna is None else f" antenna {antenna}")


def _more(number: int) -> str:
    return f" and {number} more" if number else ""


MISFIT_PROBABILITY = 1e-6
"""A curve whose chi^2 is less probable than this is a misfit: of 2000 good ones 0.002 are."""


@dataclass(frozen=True)
class SkyFreedom:
    """How far P_sky may differ from the one that is given.

    Attributes
    ----------
    modes
        By dipole, shape (mode, lst, freq), on a regular grid of the sidereal day that begins at 0 h: independent
        changes of ln P_sky, one standard deviation each.
    digest
        Hash of what they were made from.
    mistakes
        Named changes of P_sky that would put a mistaken input right, on the same grid.
    antennas
        What P_sky would be with other antennas.
    """

    modes: Mapping[str, Floats]
    digest: str
    mistakes: Sequence[Mistake] = ()
    antennas: Sequence[OtherAntenna] = ()

    def series(self, dipole: str) -> Floats:
        """Coefficients of `harmonics_at` of the modes, shape (mode, harmonic, freq)."""
        return _series_of(self.modes[dipole])

    def mistake_series(self, dipole: str) -> Floats:
        """Coefficients of `harmonics_at` of what data show of each mistake, shape (mistake, harmonic, freq)."""
        shown = [one.shown(dipole) for one in self.mistakes]
        return _series_of(np.reshape(shown, (-1, *self.modes[dipole].shape[1:])))


def _series_of(changes: Floats) -> Floats:
    terms = np.fft.rfft(changes, axis=1)[:, : SKY_HARMONICS + 1] / changes.shape[1]
    return np.concatenate([terms[:, :1].real, 2.0 * terms[:, 1:].real, -2.0 * terms[:, 1:].imag], axis=1)


@dataclass(frozen=True)
class ChainTest:
    """What the test finds in paths.

    Attributes
    ----------
    chi2, dof
        Chi^2 and its degrees of freedom, both shape (path,).
    gain
        Ln of the probability of the data without each mistake over that with it, shape (path, mistake).
    """

    chi2: Floats
    dof: Floats
    gain: Floats

    @property
    def per_dof(self) -> Floats:
        """Chi^2 per degree of freedom."""
        return np.asarray(self.chi2 / self.dof)

    @property
    def is_misfit(self) -> NDArray[np.bool_]:
        """Whether noise and the freedom of the sky cannot explain it."""
        return is_improbable(self.chi2, self.dof)


def is_improbable(chi2: Floats, dof: Floats | NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether chi^2 is larger than chance makes it."""
    return np.asarray((np.asarray(dof) > 0) & (chdtrc(dof, chi2) < MISFIT_PROBABILITY))


def run_chain_test(
    power: Floats,
    sky_power: Floats,
    relative_variance: Floats,
    lst_hours: Floats,
    lines: Lines,
    n: Floats,
    slope: Floats,
    terms: Intercepts,
    is_free: NDArray[np.bool_],
    freedom: SkyFreedom | None,
    dipole: str,
) -> ChainTest:
    """Test fitted paths, each by itself.

    Parameters
    ----------
    power, relative_variance
        As in `fit_lines`, shape (path, event, freq) and (path, event).
    sky_power, lst_hours
        Shape (event, freq) and (event,).
    lines
        Lines of these paths.
    n, slope
        Fitted noise in front, shape (path, r), and s, shape (path, freq). Noise and freedom are taken at these: a
        search for the N_LNA at which both are widest would always succeed.
    terms
        What each noise constant adds to an intercept.
    is_free
        Channels whose intercept is not tested, shape (path, freq).
    freedom, dipole
        The freedom of the sky, None where it is taken at its word; and the paths' dipole.
    """
    basis = harmonics_at(lst_hours, SKY_HARMONICS)
    mistakes = 0 if freedom is None else len(freedom.mistakes)
    series = None
    if freedom is not None:
        series = np.concatenate([freedom.mistake_series(dipole), freedom.series(dipole)])
    found = []
    for p in range(power.shape[0]):
        is_present = np.isfinite(relative_variance[p])
        path = PathLines.of(
            power[p, is_present], sky_power[is_present], relative_variance[p, is_present], lines.select(np.array([p]))
        )
        before = terms.before(n[p])
        found.append(_test_path(path, basis[is_present], before, slope[p], terms, is_free[p], series, mistakes))
    table = np.array(found, dtype=float).reshape(-1, 2 + mistakes)
    return ChainTest(table[:, 0], table[:, 1], table[:, 2:])


def compare_predictions(
    power: Floats,
    sky_power: Floats,
    relative_variance: Floats,
    lst_hours: Floats,
    lines: Lines,
    n: Floats,
    slope: Floats,
    terms: Intercepts,
    is_free: NDArray[np.bool_],
    freedom: SkyFreedom | None,
    dipole: str,
    predictions: Floats,
) -> Floats:
    """Ln of the probability of the data of one path under other predictions over that under its own fit.

    Parameters
    ----------
    power, ..., dipole
        As in `run_chain_test`, of one path.
    predictions
        Power of each event by other models that were fitted to the same data, shape (prediction, event, freq).

    Returns
    -------
    Shape (prediction,). A prediction may be far from the fit: what the lines do with it is computed and not linearised.
    """
    is_present = np.isfinite(relative_variance[0])
    path = PathLines.of(power[0, is_present], sky_power[is_present], relative_variance[0, is_present], lines)
    basis = harmonics_at(lst_hours, SKY_HARMONICS)[is_present]
    series = None if freedom is None else freedom.series(dipole)
    seen = _Seen.of(path, basis, terms.before(n[0]), slope[0], terms, is_free[0], series)
    return seen.gain_of(seen.respond_to(predictions[:, is_present] / path.model - 1.0))


def _test_path(
    path: PathLines,
    basis: Floats,
    before: Floats,
    slope: Floats,
    terms: Intercepts,
    is_free: NDArray[np.bool_],
    series: Floats | None,
    mistakes: int,
) -> tuple[float, ...]:
    """Chi^2, its degrees of freedom, and the gain of each mistake; the first of the series are those."""
    seen = _Seen.of(path, basis, before, slope, terms, is_free, series, mistakes)
    residual, of_sky_modes = seen.whiten(seen.value), seen.whiten(seen.of_modes.T)
    dof = seen.value.size - len(terms.names) - float(np.sum(of_sky_modes**2))
    return float(np.sum(residual**2)), dof, *seen.gain_of(seen.of_mistakes).tolist()


@dataclass(frozen=True)
class _Seen:
    """What the test sees of a path, one vector r: the intercepts beside the chain's, then what is left along LST.

    Attributes
    ----------
    value
        r, in standard deviations, shape (number,).
    of_modes, of_mistakes
        How r answers to each mode of the freedom and to the mistakes, shape (..., number).
    columns
        How it answers to the noise constants, shape (number, constant).
    whitener
        Root of the covariance of r, noise and freedom.
    """

    path: PathLines
    look: Look
    to_residual: Floats
    scale: Floats
    value: Floats
    of_modes: Floats
    of_mistakes: Floats
    columns: Floats
    whitener: Floats

    @classmethod
    def of(
        cls,
        path: PathLines,
        basis: Floats,
        before: Floats,
        slope: Floats,
        terms: Intercepts,
        is_free: NDArray[np.bool_],
        series: Floats | None,
        mistakes: int = 0,
    ) -> _Seen:
        """The vector with its covariance; the first of the series are the mistakes, the others the modes."""
        channels = path.slope.size
        look = look_beside(path.power / path.model - 1.0, path.of_sky, path.of_constant, basis)
        moved = np.zeros((0, 2 * channels)) if series is None else move_lines(path, basis, series)
        beside = np.zeros((0, look.value.size))
        if series is not None:
            signal = path.slope * path.of_sky
            beside = look.respond(signal, path.of_sky, path.of_constant, basis, series, moved)
        covariance = invert_symmetric(path.information)
        tested = np.flatnonzero(~is_free)
        to_residual = np.concatenate([-np.diag(before), np.eye(channels)], axis=1)[tested]
        noise = to_residual @ covariance @ to_residual.T
        scale = np.sqrt(np.diag(noise))
        value = np.concatenate([(path.intercept - before * path.slope)[tested] / scale, look.value])
        response = np.concatenate([moved @ to_residual.T / scale, beside], axis=1)
        free = response[mistakes:]
        total = np.eye(value.size) + free.T @ free
        total[: tested.size, : tested.size] += noise / np.outer(scale, scale) - np.eye(tested.size)
        columns = np.zeros((value.size, len(terms.names)))
        forms = np.concatenate([terms.front * slope, terms.behind])
        columns[: tested.size] = forms.T[tested] / scale[:, None]
        return cls(path, look, to_residual, scale, value, free, response[:mistakes], columns, find_whitener(total))

    def whiten(self, vectors: Floats) -> Floats:
        """Vectors, shape (number, ...), in units of their scatter, the noise constants profiled out."""
        flat = vectors.reshape(self.value.size, -1)
        columns, white = self.whitener @ self.columns, self.whitener @ flat
        return np.asarray(white - columns @ solve_symmetric(columns.T @ columns, columns.T @ white))

    def gain_of(self, responses: Floats) -> Floats:
        """Ln of the probability of r about each response over that about 0; shape (response, number) to (response,)."""
        residual, without = self.whiten(self.value)[:, 0], self.whiten(responses.T)
        return np.asarray(residual @ without - 0.5 * np.sum(without**2, axis=0))

    def respond_to(self, change: Floats) -> Floats:
        """R of data that depart from the lines by relative changes, shape (change, event, freq), and have no noise."""
        path, channels = self.path, self.path.slope.size
        moved = move_lines_by(path, change)
        of_lines = path.of_sky * moved[:, None, :channels] + path.of_constant * moved[:, None, channels:]
        beside = np.einsum("ej,kef,fd->kjd", self.look.directions, change - of_lines, self.look.features, optimize=True)
        of_intercepts = self.value[: self.scale.size] + moved @ self.to_residual.T / self.scale
        return np.concatenate([of_intercepts, beside.reshape(len(change), -1)], axis=1)


# What the package's own sky power may be wrong by: other models of sky and antenna, and smooth departures of both.

LEVEL = (0.2, 0.03, 0.02, 0.01)
"""Spread of ln P_sky along the Legendre polynomials in ln nu: 20 % is the scale error of the paper, the others what
models differ by."""
ZENITH_GAIN = 0.1
"""Change of the pattern's gain at zenith with its total fixed (section 4.2 of the paper)."""
SHAPE = (0.01, 0.003)
"""Changes along LST that no model at hand makes, of each of the first harmonics: the same at all frequencies, and along
ln nu. A sky that is off by 3 % r.m.s. along LST is 1.7 standard deviations of each away; mistakes that this could hide
are asked for by name."""
SHAPE_HARMONICS = 3


def free_own_sky(instrument: Instrument, models: DifferenceModels | None = None) -> SkyFreedom:
    """The freedom of `compute_sky_power` for an instrument; by all other models that ship unless named."""
    with threadpool_limits(1):
        return _free_own_sky(instrument, models or DifferenceModels())


def _free_own_sky(instrument: Instrument, models: DifferenceModels) -> SkyFreedom:
    own = compute_sky_power(instrument, lst_hours=LST_HOURS)
    wider = vary_sky_power(instrument, lst_hours=LST_HOURS, zenith_gain_fraction=ZENITH_GAIN)
    differences = compute_model_differences(instrument, models)
    smooth = _smooth_modes(instrument.frequency_mhz, LST_HOURS)
    modes = {}
    for dipole, values in own.power.items():
        levels = differences.level[dipole][:, None, :] * np.ones((LST_HOURS.size, 1))
        pattern = np.log(wider.power[dipole] / values)[None]
        modes[dipole] = np.concatenate([levels, differences.shape[dipole], pattern, smooth])
    made_of = {"own": own.digest(), "level": LEVEL, "zenith_gain": ZENITH_GAIN, "shape": [SHAPE, SHAPE_HARMONICS]}
    mistakes = list_mistakes(instrument, own.power, LST_HOURS)
    others = list_other_antennas(instrument, own.power, LST_HOURS)
    names = {"mistakes": [one.name for one in mistakes], "other_antennas": [one.name for one in others]}
    digest = hash_content({**made_of, "skies": models.skies, "antennas": models.antennas, **names})
    return SkyFreedom(modes, digest, tuple(mistakes), tuple(others))


def _smooth_modes(frequency_mhz: Floats, lst_hours: Floats) -> Floats:
    """Departures of level and shape that are smooth in ln nu and LST, shape (mode, lst, freq)."""
    log = np.log(frequency_mhz)
    x = 2.0 * (log - log[0]) / max(float(np.ptp(log)), 1e-300) - 1.0
    polynomials = np.polynomial.legendre.legvander(x, len(LEVEL) - 1).T
    angle = 2.0 * np.pi / 24.0 * np.outer(np.arange(1, SHAPE_HARMONICS + 1), lst_hours)
    waves: Sequence[Floats] = [*np.cos(angle), *np.sin(angle)]
    levels = [size * np.tile(p, (lst_hours.size, 1)) for size, p in zip(LEVEL, polynomials, strict=True)]
    shapes = [size * np.outer(wave, p) for wave in waves for size, p in zip(SHAPE, polynomials, strict=False)]
    return np.array([*levels, *shapes])
