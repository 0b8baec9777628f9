"""The question without a catalogue, whether structure is left, and along which axis.

Smooth functions of every axis (LST, UTC, date, temperature, rain), times smooth functions of frequency, are fitted to
the whitened residuals of the station's mean and of every path; where nothing is left, the gain in chi^2 follows the
chi^2 distribution. One more test needs no axis: the largest singular value of the events x channels matrix.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from lbacal_core.discovery.baseline import StationData
from lbacal_core.discovery.extend import FOLDS, event_of_mean, event_of_path, held_out_fold
from lbacal_core.discovery.targets import Nuisance
from lbacal_core.discovery.whitening import Residuals
from lbacal_core.grids import Floats

HARMONICS = 5
POLYNOMIALS = 4
NOISE_DRAWS = 60


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
    """

    axis: str
    target: str
    p_value: float
    gain: float
    dof: int
    held_out_gain: float
    channel_share: Floats


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


def find_leftover(data: StationData, residuals: Residuals, nuisance: Nuisance, rng: np.random.Generator) -> Leftover:
    """The most significant structure that is left."""
    functions = axis_functions(data)
    smooth = np.asarray(np.polynomial.legendre.legvander(np.linspace(-1, 1, data.power.shape[2]), 5).T, dtype=float)
    found = [_station_axis(data, residuals, nuisance, axis, rows, smooth) for axis, rows in functions.items()]
    found.append(_any_events(residuals, nuisance, rng))
    if len(data.antenna) > len(residuals.letters):
        found += _path_axes(data, residuals, nuisance, functions, smooth[:4])
    best = min(found, key=lambda leftover: (leftover.p_value, -leftover.gain))
    tests = len(found)
    corrected = float(-np.expm1(tests * np.log1p(-min(best.p_value, 1 - 1e-12))))
    return Leftover(best.axis, best.target, corrected, best.gain, best.dof, best.held_out_gain, best.channel_share)


def _station_axis(
    data: StationData, residuals: Residuals, nuisance: Nuisance, axis: str, functions: Floats, smooth: Floats
) -> Leftover:
    dipoles = len(residuals.letters)
    products = np.einsum("ke,lf->klef", functions, smooth).reshape(-1, functions.shape[1], smooth.shape[1])
    signs = np.array([[1.0, 1.0], [1.0, -1.0]])[:dipoles, :dipoles]
    rows = np.einsum("kef,sd->skdef", products, signs).reshape(-1, dipoles, *products.shape[1:])
    vectors = nuisance.clean_mean(residuals.whiten_mean(rows))
    of_mean = nuisance.clean_mean(residuals.whiten_mean(residuals.mean))
    gain, dof, held_out, fitted = _project(vectors, of_mean, event_of_mean(residuals), held_out_fold(data))
    in_channels = fitted[: residuals.mean.size].reshape(residuals.mean.shape)
    return Leftover(axis, "station", float(chi2.sf(gain, dof)), gain, dof, held_out, _share(in_channels))


def _path_axes(
    data: StationData, residuals: Residuals, nuisance: Nuisance, functions: Mapping[str, Floats], smooth: Floats
) -> list[Leftover]:
    """For each axis the path that shows most structure, its probability corrected for the number of paths."""
    found = []
    folds = held_out_fold(data)
    of_path = residuals.whiten_path(residuals.deviation) / residuals.levels.path_scale[:, None]
    event_of = event_of_path(residuals)
    for axis, rows in functions.items():
        products = np.einsum("ke,lf->klef", rows, smooth).reshape(-1, rows.shape[1], smooth.shape[1])
        whitened = residuals.whiten_path(products)
        best: tuple[float, int, int] = (-1.0, 0, 1)
        for index in range(len(data.conditions.dipoles)):
            members = np.flatnonzero(data.class_of == index)
            basis = _basis(nuisance.clean_path(whitened, index))
            share = 1.0 - 1.0 / np.array([np.sum(data.dipole == data.dipole[k]) for k in members])
            gains = np.sum((of_path[members] @ basis) ** 2, axis=1) / (share * residuals.presence[members])
            k = int(np.argmax(gains))
            if gains[k] > best[0]:
                best = (float(gains[k]), int(members[k]), basis.shape[1])
        gain, path, dof = best
        p_value = float(-np.expm1(len(data.antenna) * np.log1p(-min(chi2.sf(gain, dof), 1 - 1e-12))))
        vectors = nuisance.clean_path(whitened, int(data.class_of[path]))
        _, _, held_out, fitted = _project(vectors, of_path[path], event_of, folds)
        in_channels = fitted[: products[0].size].reshape(1, *products.shape[1:])
        label = f"antenna {data.antenna[path]} {data.dipole[path]}"
        found.append(Leftover(axis, label, p_value, gain, dof, held_out, _share(in_channels)))
    return found


def _any_events(residuals: Residuals, nuisance: Nuisance, rng: np.random.Generator) -> Leftover:
    """Largest singular value of the whitened events x channels matrix of the station's mean, against noise."""
    dipoles, events, channels = residuals.mean.shape
    of_mean = nuisance.clean_mean(residuals.whiten_mean(residuals.mean))
    rest = of_mean[: residuals.mean.size].reshape(dipoles, events, channels)
    combined = rest.sum(axis=0) / np.sqrt(dipoles)
    _, values, right = np.linalg.svd(combined, full_matrices=False)
    squares = np.sum(combined**2)
    noise = np.array([_largest_of_noise(rng, events, channels) for _ in range(NOISE_DRAWS)])
    # the same total, so that a wrong level is not taken for structure
    observed = values[0] ** 2 / squares * (events * (channels - 1))
    mean, spread = float(noise.mean()), float(noise.std())
    # Upper tail of the largest eigenvalue (Johnstone 2001): exponential in the 3/2 power, e^(-2/3 s^1.5) at s spreads.
    excess = max((observed - mean) / spread, 0.0)
    p_value = float(min(np.exp(-2.0 / 3.0 * (0.8 * excess) ** 1.5), 1.0))
    gain = float(observed - mean)
    return Leftover("event", "station", p_value, gain, events + channels, 0.0, right[0] ** 2)


def _largest_of_noise(rng: np.random.Generator, events: int, channels: int) -> float:
    noise = rng.standard_normal((events, channels))
    noise -= noise.mean(axis=1, keepdims=True)
    return float(np.linalg.eigvalsh(noise.T @ noise)[-1])


def _project(
    vectors: Floats, values: Floats, event_of: NDArray[np.int64], folds: NDArray[np.int64]
) -> tuple[float, int, float, Floats]:
    """Chi^2 explained by the span of vectors, its dimension, the gain on held-out events, and the fitted values."""
    basis = _basis(vectors)
    coefficients = basis.T @ values
    held_out = 0.0
    fold_of = folds[event_of]
    for k in range(FOLDS):
        is_test = fold_of == k
        train = basis[~is_test]
        fitted = np.linalg.lstsq(train.T @ train + 1e-9 * np.eye(basis.shape[1]), train.T @ values[~is_test])[0]
        predicted = basis[is_test] @ fitted
        held_out += float(predicted @ values[is_test] - 0.5 * predicted @ predicted)
    return float(coefficients @ coefficients), basis.shape[1], held_out, basis @ coefficients


def _basis(vectors: Floats) -> Floats:
    """Orthonormal columns spanning rows that keep at least a millionth of their norm, shape (n, rank)."""
    norm = np.linalg.norm(vectors, axis=1)
    scaled = vectors[norm > 1e-6] / norm[norm > 1e-6, None]
    values, turned = np.linalg.eigh(scaled @ scaled.T)
    kept = values > 1e-6 * values[-1]
    return np.asarray((scaled.T @ turned[:, kept]) / np.sqrt(values[kept]))


def _harmonics(phase: Floats, number: int) -> Floats:
    angle = 2 * np.pi * np.outer(np.arange(1, number + 1), phase)
    return np.concatenate([np.cos(angle), np.sin(angle)])


def _unit(values: Floats) -> Floats:
    return np.asarray((values - values.min()) / max(float(np.ptp(values)), 1e-300))


def _share(fitted: Floats) -> Floats:
    squares = np.sum(fitted**2, axis=(0, 1))
    return np.asarray(squares / max(float(squares.sum()), 1e-300))
