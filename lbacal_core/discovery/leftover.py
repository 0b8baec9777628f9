"""The question without a catalogue, whether structure is left, and along which axis.

Smooth functions of every axis (LST, UTC, date, temperature, rain), times smooth functions of frequency, are fitted to
the whitened residuals of the station's mean and of every path; where nothing is left, the gain in chi^2 follows the
chi^2 distribution. One more test needs no axis: the largest singular value of the events x channels matrix.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from lbacal_core.discovery.baseline import StationData
from lbacal_core.discovery.evidence import Evidence
from lbacal_core.discovery.extend import FOLDS, held_out_fold
from lbacal_core.grids import Floats

HARMONICS = 5
POLYNOMIALS = 4
NOISE_DRAWS = 60
SMALLEST_SIZE = 1e-6


@dataclass(frozen=True)
class Leftover:
    """Structure along one axis.

    Attributes
    ----------
    axis
        ``lst``, ``utc``, ``date``, ``temperature``, ``rain`` or ``event``.
    target
        ``station``, or the path that shows it most.
    p_value
        After correction for all axes and paths.
    gain, dof
        Chi^2 gained by the empirical term and its number of terms.
    held_out_gain
        Log-likelihood gained on events not used.
    channel_share
        Share of the structure in each channel, shape (freq,).
    vectors
        That describe it in the station's mean, shape (vector, letter, event, freq); None where a path shows it.
    """

    axis: str
    target: str
    p_value: float
    gain: float
    dof: int
    held_out_gain: float
    channel_share: Floats
    vectors: Floats | None


def axis_functions(data: StationData) -> dict[str, Floats]:
    """Smooth functions of each axis that these data have, shape (function, event)."""
    conditions = data.conditions
    functions = {
        "lst": _harmonics(conditions.lst_hours / 24.0, HARMONICS),
        "date": _harmonics(0.5 * _unit(conditions.time_unix), 2 * HARMONICS),
    }
    if np.histogram(conditions.utc_hours, bins=8, range=(0, 24))[0].min() > 3:
        functions["utc"] = _harmonics(conditions.utc_hours / 24.0, HARMONICS)
    warmth = conditions.warmth()
    if warmth is not None and np.ptp(warmth) > 0:
        x = 2 * _unit(np.clip(warmth[:, 0], *np.quantile(warmth, [0.01, 0.99]))) - 1
        functions["temperature"] = np.asarray(np.polynomial.legendre.legvander(x, POLYNOMIALS).T[1:], dtype=float)
    rain = conditions.wetness("flag")
    if rain is not None:
        functions["rain"] = rain.T
    for days in (7.0, 27.3, 29.53):
        functions[f"date, period {days:g} d"] = _harmonics(conditions.time_unix / (days * 86_400.0), 2)
    return functions


def find_leftover(
    evidence: Evidence, rng: np.random.Generator, alpha: float, misfit: float | None = None
) -> Leftover | None:
    """The most significant structure that is left, or None.

    It counts where chance gives as much with a probability below alpha, and where it makes events more probable that
    were not used to describe it. Or where a cause is still wanted whose shape is wrong, which chance would do with the
    probability `misfit`: then the question is only along which axis.
    """
    data = evidence.data
    functions = axis_functions(data)
    smooth = np.asarray(np.polynomial.legendre.legvander(np.linspace(-1, 1, data.power.shape[2]), 5).T, dtype=float)
    found = [_station_axis(evidence, axis, rows, smooth) for axis, rows in functions.items()]
    found.append(_any_events(evidence, rng))
    if len(data.antenna) > len(evidence.paths_of):
        found += [_path_axis(evidence, axis, rows, smooth[:4]) for axis, rows in functions.items()]
    best = min(found, key=lambda structure: (structure.p_value, -structure.excess))
    corrected = float(-np.expm1(len(found) * np.log1p(-min(best.p_value, 1 - 1e-12))))
    if corrected >= alpha and misfit is None:
        return None
    held_out, share = _describe(evidence, best, functions, smooth)
    if best.axis != "event" and held_out <= 0 and misfit is None:
        return None
    vectors = None
    if best.axis == "event":
        vectors = _largest_pattern(evidence)
    elif best.path < 0:
        vectors = _station_vectors(evidence, functions[best.axis], smooth)
    p_value = min(corrected, 1.0 if misfit is None else misfit)
    return Leftover(best.axis, best.target, p_value, best.gain, best.dof, held_out, share, vectors)


@dataclass(frozen=True)
class _Structure:
    """Chi^2 that smooth functions of an axis gain: of the station's mean, or of the path that shows it most."""

    axis: str
    target: str
    path: int
    p_value: float
    gain: float
    dof: int

    @property
    def excess(self) -> float:
        """Gain beyond chance in standard deviations (Wilson & Hilferty 1931), for probabilities that are 0."""
        spread = 2.0 / (9.0 * self.dof)
        return float((np.cbrt(self.gain / self.dof) - 1.0 + spread) / spread**0.5)


def _station_axis(evidence: Evidence, axis: str, functions: Floats, smooth: Floats) -> _Structure:
    dual = evidence.mean_dual
    signs = _signs(len(dual))
    score = np.einsum("he,def,lf,sd->shl", functions, dual, smooth, signs, optimize=True).ravel()
    weight = np.ones(functions.shape[1])
    absorbed, information = evidence.mean_space.products_of(functions, smooth, signs, weight)
    gain, dof = _gain(score, information - absorbed @ evidence.mean_inverse @ absorbed.T)
    return _Structure(axis, "station", -1, float(chi2.sf(gain, dof)), gain, dof)


def _signs(letters: int) -> Floats:
    """Sum and difference of the dipole letters, shape (combination, letter)."""
    return np.array([[1.0, 1.0], [1.0, -1.0]])[:letters, :letters]


def _station_vectors(evidence: Evidence, functions: Floats, smooth: Floats) -> Floats:
    """Functions of an axis times functions of frequency, for sum and difference of the letters."""
    products = np.einsum("ke,lf->klef", functions, smooth).reshape(-1, functions.shape[1], smooth.shape[1])
    signs = _signs(len(evidence.paths_of))
    return np.asarray(np.einsum("kef,sd->skdef", products, signs).reshape(-1, signs.shape[1], *products.shape[1:]))


def _path_axis(evidence: Evidence, axis: str, functions: Floats, smooth: Floats) -> _Structure:
    """The path that shows most structure along an axis, its probability corrected for the number of paths."""
    best: tuple[float, float, int, int] = (2.0, 0.0, 0, 1)
    signs = np.ones((1, 1))
    for c, (space, members) in enumerate(zip(evidence.path_spaces, evidence.members, strict=True)):
        for k in members:
            score = functions @ (evidence.path_dual[k] @ smooth.T)
            absorbed, information = space.products_of(functions, smooth, signs, evidence.weight[k])
            information -= absorbed @ evidence.path_inverse[k] @ absorbed.T
            others = 1.0 - evidence.residuals.in_mean[k] / evidence.paths_of[evidence.letter_of[c]]
            gain, dof = _gain(score.ravel(), others * information)
            p_value = float(chi2.sf(gain, dof))
            best = min(best, (p_value, gain, dof, int(k)))
    p_value, gain, dof, path = best
    corrected = float(-np.expm1(len(evidence.data.antenna) * np.log1p(-min(p_value, 1 - 1e-12))))
    label = f"antenna {evidence.data.antenna[path]} {evidence.data.dipole[path]}"
    return _Structure(axis, label, path, corrected, gain, dof)


def _gain(score: Floats, information: Floats) -> tuple[float, int]:
    """Chi^2 gained by vectors and the number of them that are independent."""
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    kept = size > SMALLEST_SIZE * size.max(initial=SMALLEST_SIZE)
    if not np.any(kept):
        return 0.0, 1
    scaled = information[np.ix_(kept, kept)] / np.outer(size[kept], size[kept])
    values, vectors = np.linalg.eigh(scaled)
    is_own = values > SMALLEST_SIZE * values[-1]
    amplitude = (score[kept] / size[kept]) @ vectors[:, is_own]
    return float(np.sum(amplitude**2 / values[is_own])), int(is_own.sum())


def _describe(
    evidence: Evidence, structure: _Structure, functions: Mapping[str, Floats], smooth: Floats
) -> tuple[float, Floats]:
    """Gain of the empirical term on events not used for it, and its share in each channel."""
    if structure.axis == "event":
        rest = _whiten_rest(evidence, evidence.residuals.mean)
        return 0.0, np.linalg.svd(rest, full_matrices=False)[2][0] ** 2
    folds = held_out_fold(evidence.data)
    if structure.path < 0:
        clean = evidence.clean_mean(_station_vectors(evidence, functions[structure.axis], smooth))
        weighed, dual = evidence.mean_space.weigh(clean), evidence.mean_dual
    else:
        k = structure.path
        rows = np.einsum("ke,lf->klef", functions[structure.axis], smooth[:4]).reshape(
            -1, 1, *evidence.mean_dual.shape[1:]
        )
        clean = evidence.clean_path(rows[:, 0], k)[:, None]
        space = evidence.path_spaces[int(evidence.data.class_of[k])]
        weighed = space.weigh(clean) * evidence.weight[k][:, None]
        dual = evidence.path_dual[k][None]
    held_out = 0.0
    flat = clean.reshape(len(clean), -1)
    for fold in range(FOLDS):
        is_test = (folds == fold)[:, None]
        product = flat @ np.where(is_test, weighed, 0.0).reshape(len(clean), -1).T
        of_test = flat @ np.where(is_test, dual, 0.0).ravel()
        score, information = flat @ dual.ravel() - of_test, flat @ weighed.reshape(len(clean), -1).T - product
        size = np.linalg.lstsq(information, score, rcond=SMALLEST_SIZE)[0]
        held_out += float(size @ of_test - 0.5 * size @ product @ size)
    size = np.linalg.lstsq(flat @ weighed.reshape(len(clean), -1).T, flat @ dual.ravel(), rcond=SMALLEST_SIZE)[0]
    squares = np.sum(np.tensordot(size, clean, axes=1) ** 2, axis=(0, 1))
    return held_out, squares / max(float(squares.sum()), 1e-300)


def _any_events(evidence: Evidence, rng: np.random.Generator) -> _Structure:
    """Largest singular value of the whitened events x channels matrix of the station's mean, against noise."""
    rest = _whiten_rest(evidence, evidence.residuals.mean)
    events, channels = rest.shape
    values = np.linalg.svd(rest, compute_uv=False)
    noise = np.array([_largest_of_noise(rng, events, channels) for _ in range(NOISE_DRAWS)])
    # the same total, so that a wrong level is not taken for structure
    observed = values[0] ** 2 / np.sum(rest**2) * (events * (channels - 1))
    mean, spread = float(noise.mean()), float(noise.std())
    # Upper tail of the largest eigenvalue (Johnstone 2001): exponential in the 3/2 power, e^(-2/3 s^1.5) at s spreads.
    excess = max((observed - mean) / spread, 0.0)
    p_value = float(min(np.exp(-2.0 / 3.0 * (0.8 * excess) ** 1.5), 1.0))
    return _Structure("event", "station", -1, p_value, float(observed - mean), events + channels)


def _largest_pattern(evidence: Evidence) -> Floats:
    """The pattern of events x channels with the largest singular value, shape (1, letter, event, freq)."""
    left, values, right = np.linalg.svd(_whiten_rest(evidence, evidence.residuals.mean), full_matrices=False)
    pattern = values[0] * np.outer(left[:, 0], right[0])
    root = np.sqrt(np.maximum(evidence.mean_space.channel, 1e-300))
    return np.asarray(pattern / root[..., None] * (evidence.mean_space.channel > 0)[..., None])[None]


def share_of_channels(evidence: Evidence, values: Floats) -> Floats:
    """Share of each channel in a vector of the mean that is not flat in frequency, shape (freq,), the sum is 1."""
    squares = np.sum(_whiten_rest(evidence, values) ** 2, axis=0)
    return np.asarray(squares / max(float(squares.sum()), 1e-300))


def _whiten_rest(evidence: Evidence, values: Floats) -> Floats:
    """What is not flat in frequency of a vector of the mean, both letters together, in standard deviations."""
    clean = evidence.clean_mean(values)
    rest = (clean - clean.mean(axis=-1, keepdims=True)) * np.sqrt(evidence.mean_space.channel)[..., None]
    return np.asarray(rest.sum(axis=0) / np.sqrt(len(rest)))


def _largest_of_noise(rng: np.random.Generator, events: int, channels: int) -> float:
    noise = rng.standard_normal((events, channels))
    noise -= noise.mean(axis=1, keepdims=True)
    return float(np.linalg.eigvalsh(noise.T @ noise)[-1])


def _harmonics(phase: Floats, number: int) -> Floats:
    angle = 2 * np.pi * np.outer(np.arange(1, number + 1), phase)
    return np.concatenate([np.cos(angle), np.sin(angle)])


def _unit(values: Floats) -> Floats:
    return np.asarray((values - values.min()) / max(float(np.ptp(values)), 1e-300))
