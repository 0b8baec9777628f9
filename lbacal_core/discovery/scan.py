"""The score test: the significance of every cause, law and target from one matrix product, without a refit.

The score of a signature t in whitened residuals e, with what the fit absorbs projected out of t, is t.e / |t|: a
standard normal number where nothing is hidden. Look-elsewhere: the distribution of the largest score is simulated with
the correlations that the signatures have in the data at hand, and carried on to small probabilities as that of the
equivalent number of independent scores.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import erfc, erfcinv

from lbacal_core.causes.interference import RfiLine
from lbacal_core.causes.terms import Cause, ChainTerms, Law, signature
from lbacal_core.discovery.baseline import StationData
from lbacal_core.discovery.targets import Nuisance, Target, mean_over_paths
from lbacal_core.discovery.whitening import Residuals
from lbacal_core.grids import Floats

BATCH = 48
DRAWS = 4000
SMALLEST_INFORMATION = 1e-6
"""Below this a unit of size moves the data by a thousandth of a standard deviation."""


@dataclass(frozen=True)
class Score:
    """The significance of one cause under one law for one target.

    Attributes
    ----------
    z
        Score in standard deviations, with its sign.
    size
        The size that fits best, to first order, in the cause's unit; `z` is size over its standard deviation.
    trials
        Equivalent number of independent scores of this cause in this scan.
    """

    cause: Cause
    law: Law
    target: Target
    z: float
    size: float
    trials: float

    @property
    def p_value(self) -> float:
        """Probability of such a score from this cause's whole family and all targets where nothing is hidden."""
        return p_of(abs(self.z), self.trials)


@dataclass(frozen=True)
class Scan:
    """All scores of a station, best of each (cause, target scope), and what is needed to compare signatures.

    Attributes
    ----------
    best
        The best score of each cause, most significant first.
    trials
        Equivalent number of independent scores of the whole scan.
    station_laws, station_correlation
        The (cause, law) that can concern the station and the correlation of their signatures, shape (law, law).
    path_laws, path_correlation
        The same for one path of the most common class.
    """

    best: list[Score]
    trials: float
    station_laws: list[tuple[Cause, Law]]
    station_correlation: Floats
    path_laws: list[tuple[Cause, Law]]
    path_correlation: Floats


def p_of(z: float, trials: float) -> float:
    """Probability that the largest of `trials` independent standard normal numbers exceeds z in absolute value."""
    return float(-np.expm1(-trials * erfc(z / np.sqrt(2.0))))


def significance(z: float, trials: float) -> float:
    """The score as a normal number after the look-elsewhere correction, however small the probability."""
    p_value = p_of(z, trials)
    return sigma_of(p_value) if p_value > 1e-250 else float(np.sqrt(z**2 - 2 * np.log(trials)))


def sigma_of(p_value: float) -> float:
    """The two-sided normal equivalent of a probability, standard deviations."""
    return float(np.sqrt(2.0) * erfcinv(np.clip(p_value, 1e-300, 1.0)))


def equivalent_trials(correlation: Floats, groups: Sequence[int], copies: Sequence[float], seed: int) -> Floats:
    """Equivalent independent scores of groups of correlated ones, and of all of them together (last).

    Parameters
    ----------
    correlation
        Of the signatures, shape (law, law).
    groups
        Group of each law.
    copies
        How often the group is repeated independently (antennas); shape (group,).
    """
    rng = np.random.default_rng(seed)
    values, vectors = np.linalg.eigh(correlation)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    draws = np.abs(rng.standard_normal((DRAWS, root.shape[1])) @ root.T)
    membership = np.asarray(groups)
    largest = np.stack([draws[:, membership == g].max(axis=1, initial=0.0) for g in range(len(copies))])
    trials = np.array([_trials_of(row) * count for row, count in zip(largest, copies, strict=True)])
    weights = np.asarray(copies)
    # All groups together: equal copies share draws, so that correlated groups are not counted twice.
    together = sum(
        _trials_of(largest[weights >= count].max(axis=0)) * (count - below)
        for below, count in zip([0.0, *sorted(set(weights.tolist()))[:-1]], sorted(set(weights.tolist())), strict=True)
    )
    return np.append(trials, together)


def _trials_of(largest: Floats) -> float:
    """Equivalent trials from the draws' 90 % quantile, where they are many and the tail has begun."""
    quantile = float(np.quantile(largest, 0.9))
    tail = max(float(erfc(quantile / np.sqrt(2.0))), 1e-300)
    return float(max(-np.log(0.9) / tail, 1.0))


def scan(
    data: StationData,
    residuals: Residuals,
    nuisance: Nuisance,
    terms: ChainTerms,
    causes: Sequence[Cause],
    targets: Sequence[Target],
    seed: int = 0,
) -> Scan:
    """Score every cause under every law for every target that it can concern.

    Nothing is whitened but the residuals: with g = W^T (1 - Q Q^T) W e for them and H = W^T Q for the orthonormal Q
    that the fit absorbs, the score of a signature t is t.g and its information |W t|^2 - |H^T t|^2.
    """
    scores = _Scores(data, residuals, nuisance, list(targets))
    for batch in _batches([(cause, law) for cause in causes for law in cause.laws(data.conditions)]):
        if all(isinstance(cause, RfiLine) for cause, _ in batch):
            scores.add_lines(batch, terms)
        else:
            values = [signature(cause, terms, data.conditions, law) for cause, law in batch]
            scores.add(batch, np.stack(values).astype(np.float32))
    return scores.finish(seed)


def _batches(entries: list[tuple[Cause, Law]]) -> list[list[tuple[Cause, Law]]]:
    """Laws in batches that fit into memory; all lines together, because they are scored by a shorter way."""
    lines = [entry for entry in entries if isinstance(entry[0], RfiLine)]
    others = [entry for entry in entries if not isinstance(entry[0], RfiLine)]
    return [others[k : k + BATCH] for k in range(0, len(others), BATCH)] + ([lines] if lines else [])


class _Scores:
    """Scores gathered batch by batch."""

    def __init__(self, data: StationData, residuals: Residuals, nuisance: Nuisance, targets: list[Target]) -> None:
        self.data, self.residuals, self.targets = data, residuals, targets
        self.rows: list[tuple[Cause, Law, int, float, float]] = []
        self.wide_units: list[tuple[list[tuple[Cause, Law]], Floats, Floats]] = []
        self.path_units: list[tuple[list[tuple[Cause, Law]], Floats, Floats]] = []
        self.line_correlation: Floats | None = None
        self.line_rows: list[tuple[Cause, Law]] = []
        scale = residuals.levels.path_scale
        of_mean = nuisance.clean_mean(residuals.whiten_mean(residuals.mean))
        self.mean_dual = residuals.pull_back_mean(of_mean).astype(np.float32)
        self.mean_absorbed = nuisance.dual_mean(residuals).astype(np.float32)
        self.path_dual = np.empty(residuals.deviation.shape, dtype=np.float32)
        self.path_absorbed: dict[int, Floats] = {}
        self.weight = residuals.presence / scale**2
        self.has_single = any(target.scope in ("path", "antenna") for target in targets)
        for index in np.unique(data.class_of).tolist():
            members = np.flatnonzero(data.class_of == index)
            whitened = nuisance.clean_path(residuals.whiten_path(residuals.deviation[members]), index)
            self.path_dual[members] = residuals.pull_back_path(whitened) / scale[members][:, None, None] ** 2
            self.path_absorbed[index] = nuisance.dual_path(residuals, index).astype(np.float32)

    def add(self, batch: list[tuple[Cause, Law]], signatures: Floats) -> None:
        """Score a batch with signatures of shape (law, class, event, freq) for all its targets."""
        paths = len(self.data.antenna)
        score, information = np.zeros((len(batch), paths)), np.zeros((len(batch), paths))
        if len(self.targets) > 1:
            common = int(np.bincount(self.data.class_of).argmax())
            for index, absorbed in self.path_absorbed.items():
                members = np.flatnonzero(self.data.class_of == index)
                own = signatures[:, index].reshape(len(batch), -1)
                lost = own @ absorbed.reshape(len(absorbed), -1).T
                norm = self.residuals.norm_path(signatures[:, index]) - np.sum(lost**2, axis=1)
                score[:, members] = own @ self.path_dual[members].reshape(members.size, -1).T
                information[:, members] = norm[:, None] * self.weight[members]
                if index == common:
                    self._remember_path(batch, signatures[:, index], lost)
        self._score_targets(batch, signatures, score, information)

    def _remember_path(self, batch: list[tuple[Cause, Law]], own: Floats, lost: Floats) -> None:
        local = [k for k, (cause, _) in enumerate(batch) if set(cause.scopes) & {"path", "antenna"}]
        if local and self.has_single:
            self.path_units.append(([batch[k] for k in local], own[local], lost[local]))

    def _score_targets(
        self, batch: list[tuple[Cause, Law]], signatures: Floats, score: Floats, information: Floats
    ) -> None:
        for k, target in enumerate(self.targets):
            chosen = [b for b, (cause, _) in enumerate(batch) if target.scope in cause.scopes]
            if not chosen:
                continue
            rest = 1.0 - self._share(target)
            s = score[chosen][:, target.is_member].sum(axis=1)
            f = rest * information[chosen][:, target.is_member].sum(axis=1)
            if target.scope in ("cable", "station"):
                mean = mean_over_paths(self.data, self.residuals, signatures[chosen], target.is_member)
                flat = mean.reshape(len(chosen), -1)
                lost = flat @ self.mean_absorbed.reshape(len(self.mean_absorbed), -1).T
                own = np.array([self.residuals.gram_mean(row[None], row[None])[0, 0] for row in mean])
                own = own - np.sum(lost**2, axis=1)
                if target.scope == "station":
                    s, f = flat @ self.mean_dual.ravel(), own
                    self.wide_units.append(([batch[b] for b in chosen], mean, lost))
                else:
                    s, f = s + flat @ self.mean_dual.ravel(), f + own
            self._keep([batch[b] for b in chosen], k, s, f)

    def add_lines(self, batch: list[tuple[Cause, Law]], terms: ChainTerms) -> None:
        """Score interference lines: each lives in one channel, so hours x channels come from one product."""
        conditions = self.data.conditions
        windows = list(dict.fromkeys(tuple(law.parameters["utc_h"]) for _, law in batch))
        inside: Floats = np.concatenate([conditions.in_hours(*window) for window in windows], axis=1).T
        power = terms.power()
        shape: Floats = power.mean(axis=1, keepdims=True) / power
        channels = shape.shape[2]
        order = {(law.parameters["frequency_mhz"], tuple(law.parameters["utc_h"])): (c, law) for c, law in batch}
        rows = [order[f, window] for window in windows for f in conditions.frequency_mhz.tolist()]
        single = [k for k, target in enumerate(self.targets) if target.scope == "antenna"]
        if single:
            score, information = self._lines_of_paths(inside, shape, channels)
            for k in single:
                target = self.targets[k]
                rest = 1.0 - self._share(target)
                f = rest * information[..., target.is_member].sum(axis=-1)
                self._keep(rows, k, score[..., target.is_member].sum(axis=-1).ravel(), f.ravel())
        mean_shape = mean_over_paths(self.data, self.residuals, shape[None])[0]
        s = np.einsum("we,def->wf", inside, self.mean_dual * mean_shape, optimize=True)
        lost = np.einsum("we,rdef->wfr", inside, self.mean_absorbed * mean_shape, optimize=True)
        f = self._line_norm(inside, mean_shape, channels) - np.sum(lost**2, axis=-1)
        self._keep(rows, self._station(), s.ravel(), f.ravel())
        self._remember_lines(rows, inside, mean_shape, lost, f)

    def _lines_of_paths(self, inside: Floats, shape: Floats, channels: int) -> tuple[Floats, Floats]:
        """Score and information of every window, channel and path, each of shape (window, freq, path)."""
        paths = len(self.data.antenna)
        score, information = np.zeros((2, len(inside), channels, paths))
        levels = self.residuals.levels
        per_square = (1 - 1 / channels) / levels.path_channel**2 + 1 / (channels * levels.path_band) ** 2
        for index, absorbed in self.path_absorbed.items():
            members = np.flatnonzero(self.data.class_of == index)
            score[..., members] = np.einsum(
                "we,pef->wfp", inside, self.path_dual[members] * shape[index], optimize=True
            )
            lost = np.einsum("we,ref->wfr", inside, absorbed * shape[index], optimize=True)
            norm = (inside @ shape[index] ** 2) * per_square - np.sum(lost**2, axis=-1)
            information[..., members] = norm[:, :, None] * self.weight[members]
        return score, information

    def _line_norm(self, inside: Floats, mean_shape: Floats, channels: int) -> Floats:
        """Squared norm of whitened station-wide lines, shape (window, freq)."""
        levels, weight = self.residuals.levels, self.residuals.weight
        square = mean_shape**2 * (weight / levels.mean_channel[:, None] ** 2)[:, :, None] * (1 - 1 / channels)
        joint = weight.min(axis=0)[:, None] / 2 / channels**2
        square = square.sum(axis=0) + joint * mean_shape.sum(axis=0) ** 2 / levels.mean_sum**2
        if len(mean_shape) == 2:
            square = square + joint * (mean_shape[0] - mean_shape[1]) ** 2 / levels.mean_difference**2
        return np.asarray(inside @ square)

    def _remember_lines(
        self, rows: list[tuple[Cause, Law]], inside: Floats, shape: Floats, lost: Floats, information: Floats
    ) -> None:
        """Correlations of the windows of one channel, which stand for those of every channel."""
        middle = shape.shape[2] // 2
        both = inside[:, None, :] * inside[None, :, :]
        gram = self._line_norm(both.reshape(-1, both.shape[2]), shape, shape.shape[2])[:, middle]
        gram = gram.reshape(len(inside), len(inside)) - lost[:, middle] @ lost[:, middle].T
        norm = np.sqrt(np.maximum(information[:, middle], 1e-12))
        self.line_correlation = gram / np.outer(norm, norm)
        self.line_rows = rows

    def _station(self) -> int:
        return next(k for k, target in enumerate(self.targets) if target.scope == "station")

    def _share(self, target: Target) -> float:
        """Share of a letter's paths that a target holds: what it has in common with the mean it is compared to."""
        letters = self.data.dipole[target.is_member]
        return float(np.mean([np.sum(letters == letter) / np.sum(self.data.dipole == letter) for letter in letters]))

    def _keep(self, rows: list[tuple[Cause, Law]], target: int, s: Floats, f: Floats) -> None:
        for (cause, law), value, information in zip(rows, s.tolist(), f.tolist(), strict=True):
            # A signature that the fit absorbs has no information left and no significance.
            if information > SMALLEST_INFORMATION:
                self.rows.append((cause, law, target, value / information**0.5, value / information))

    def finish(self, seed: int) -> Scan:
        """The best score of each cause, with trials from the correlations of the signatures."""
        antennas = len(np.unique(self.data.antenna))
        cables = sum(target.scope == "cable" for target in self.targets)
        wide_rows, wide = self._correlations(self.wide_units, self.residuals.gram_mean)
        path_rows, own = self._correlations(self.path_units, self._gram_path)
        trials: dict[str, float] = {}
        total = 0.0
        for rows, correlation, weights in (
            (wide_rows, wide, {"station": 1.0, "cable": float(cables)}),
            (path_rows, own, {"path": 2.0 * antennas, "antenna": 1.0 * antennas}),
        ):
            if not rows:
                continue
            names = sorted({cause.identifier for cause, _ in rows})
            scopes = {cause.identifier: cause.scopes for cause, _ in rows}
            copies = [sum(weight for scope, weight in weights.items() if scope in scopes[name]) for name in names]
            group = [names.index(cause.identifier) for cause, _ in rows]
            found = equivalent_trials(correlation, group, copies, seed)
            for name, value in zip(names, found[:-1], strict=True):
                trials[name] = trials.get(name, 0.0) + float(value)
            total += float(found[-1])
        if self.line_correlation is not None:
            channels = self.data.conditions.frequency_mhz.size
            copies = [channels * (1.0 + (antennas if self.has_single else 0))]
            found = equivalent_trials(self.line_correlation, [0] * len(self.line_correlation), copies, seed)
            trials["rfi_line"] = float(found[0])
            total += float(found[0])
        best: dict[str, Score] = {}
        for cause, law, target, z, size in self.rows:
            old = best.get(cause.identifier)
            if old is None or abs(z) > abs(old.z):
                count = trials.get(cause.identifier, 1.0)
                best[cause.identifier] = Score(cause, law, self.targets[target], z, size, count)
        ranking = sorted(best.values(), key=lambda score: (score.p_value, -abs(score.z)))
        return Scan(ranking, max(total, 1.0), wide_rows, wide, path_rows, own)

    def _gram_path(self, left: Floats, right: Floats) -> Floats:
        a, b = self.residuals.whiten_path(left), self.residuals.whiten_path(right)
        return np.asarray(a @ b.T)

    def _correlations(
        self,
        units: list[tuple[list[tuple[Cause, Law]], Floats, Floats]],
        gram: Callable[[Floats, Floats], Floats],
    ) -> tuple[list[tuple[Cause, Law]], Floats]:
        """Correlations of signatures with what the fit absorbs taken out."""
        if not units:
            return [], np.zeros((0, 0))
        rows = [entry for batch, _, _ in units for entry in batch]
        values = np.concatenate([part for _, part, _ in units])
        lost = np.concatenate([part for _, _, part in units])
        product = gram(values, values) - lost @ lost.T
        norm = np.sqrt(np.maximum(np.diag(product), SMALLEST_INFORMATION))
        return rows, np.asarray(product / np.outer(norm, norm), dtype=float)
