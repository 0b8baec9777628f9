"""Errors of C that move together: the budget of systematic terms, and the covariance of one curve along frequency.

All are of ln C. A term of a budget holds one or a few vectors along frequency for each polarisation, one standard
deviation each; vectors are independent of each other, and each is the same for all curves that share the budget.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.grids import Floats
from lbacal_core.provenance import hash_content

DIGITS = 6
"""Decimals of ln C that are kept: a millionth, so that rounding of the last bits gives the same hash."""
MOST_FACTORS = 4
"""Vectors of the statistical covariance; errors are almost fully correlated along frequency."""


@dataclass(frozen=True)
class BudgetTerm:
    """One source of systematic error.

    Attributes
    ----------
    name, source
        What it is, and where its size comes from.
    vectors
        By polarisation, shape (vector, freq): d ln C, one standard deviation each.
    is_of_gain
        Whether it is an error of G_ant, which cancels in C/|H|.
    """

    name: str
    source: str
    vectors: Mapping[str, Floats]
    is_of_gain: bool = False

    def variance(self, polarisation: str) -> Floats:
        """Variance of ln C, shape (freq,)."""
        return np.asarray(np.sum(self.vectors[polarisation] ** 2, axis=0))


@dataclass(frozen=True)
class Budget:
    """All systematic terms that the curves of a fit share.

    Attributes
    ----------
    unsure
        By polarisation, channels of which no term says how far C may be off, shape (freq,); empty where there are none.
        They are told by the flags of curves, and are no part of what is stored.
    """

    frequency_mhz: Floats
    terms: Sequence[BudgetTerm]
    unsure: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)

    @property
    def polarisations(self) -> set[str]:
        """The polarisations with a curve; none where no path has events enough for one."""
        return {polarisation for term in self.terms for polarisation in term.vectors}

    def variance(self, polarisation: str, name: str | None = None) -> Floats:
        """Variance of ln C by all terms, or by those of a name, shape (freq,)."""
        found = [term.variance(polarisation) for term in self.terms if name in (None, term.name)]
        return np.asarray(np.sum(found, axis=0)) + np.zeros(self.frequency_mhz.size)

    def vectors(self, polarisation: str) -> Floats:
        """The vectors of all terms, shape (vector, freq)."""
        return np.concatenate([term.vectors[polarisation] for term in self.terms])

    def covariance(self, polarisation: str) -> Floats:
        """Covariance of ln C along frequency, shape (freq, freq)."""
        vectors = self.vectors(polarisation)
        return np.asarray(vectors.T @ vectors)

    def as_dict(self) -> dict[str, Any]:
        """Describe the budget as JSON values (docs/formats/galcal.md)."""
        return {
            "frequency_mhz": self.frequency_mhz.tolist(),
            "terms": [
                {**vars(term), "vectors": {k: np.round(v, DIGITS).tolist() for k, v in sorted(term.vectors.items())}}
                for term in self.terms
            ],
        }

    @cached_property
    def digest(self) -> str:
        """Hash of the content."""
        return hash_content(self.as_dict())


def parse_budget(content: Mapping[str, Any]) -> Budget:
    """Make a budget from its JSON values."""
    return Budget(
        np.array(content["frequency_mhz"], dtype=float),
        tuple(
            BudgetTerm(
                term["name"],
                term["source"],
                {polarisation: np.array(vectors, dtype=float) for polarisation, vectors in term["vectors"].items()},
                term["is_of_gain"],
            )
            for term in content["terms"]
        ),
    )


@dataclass(frozen=True)
class CurveCovariance:
    """The covariance of ln C of one curve.

    Attributes
    ----------
    factor, diagonal
        Statistical: factor^T factor + diag(diagonal), shapes (vector, freq) and (freq,).
    budget
        Hash of the shared systematic terms; None where there is no budget.
    own
        Systematic terms of this curve alone, shape (vector, freq).
    common
        The part of the statistical covariance that the sizes of adopted causes add, shape (vector, freq): the vector
        of a number is the same amount for all curves of a station and window. None where no cause was adopted.
    """

    factor: Floats
    diagonal: Floats
    budget: str | None
    own: Floats
    common: Floats | None = None

    def with_own(self, vector: Floats) -> CurveCovariance:
        """The same with one more systematic term of this curve alone, one standard deviation of ln C, shape (freq,)."""
        return replace(self, own=np.concatenate([self.own, vector[None]]))

    def as_dict(self) -> dict[str, Any]:
        """Describe the covariance as JSON values (docs/formats/galcal.md)."""
        shared = {} if self.common is None else {"common": _rows(self.common)}
        return {
            "statistical": {"factor": _rows(self.factor), "diagonal": _rows(self.diagonal[None])[0], **shared},
            "systematic": {"budget": self.budget, "own": _rows(self.own)},
        }


def parse_covariance(content: Mapping[str, Any]) -> CurveCovariance:
    """Make a covariance from its JSON values."""
    statistical, systematic = content["statistical"], content["systematic"]
    diagonal = np.array(statistical["diagonal"], dtype=float)
    own = np.array(systematic["own"], dtype=float).reshape(-1, diagonal.size)
    factor = np.array(statistical["factor"], dtype=float).reshape(-1, diagonal.size)
    common = None if "common" not in statistical else np.array(statistical["common"], dtype=float)
    return CurveCovariance(factor, diagonal, systematic["budget"], own, common)


def name_budgets(curves: Iterable[Mapping[str, Any]]) -> list[str]:
    """Hashes of the budgets that curves, as JSON values, name; in order."""
    covariances = (curve.get("covariance") for curve in curves)
    named = {one["systematic"]["budget"] for one in covariances if one}
    return sorted(name for name in named if name is not None)


def compress_covariance(covariance: Floats) -> tuple[Floats, Floats]:
    """A covariance as its strongest axes and a diagonal that keeps every variance exactly.

    Parameters
    ----------
    covariance
        Shape (freq, freq); rows of channels without a value are NaN.

    Returns
    -------
    Factor, shape (vector, freq), and diagonal, shape (freq,).
    """
    is_known = np.isfinite(np.diag(covariance))
    size, axes = np.linalg.eigh(covariance[np.ix_(is_known, is_known)])
    count = min(MOST_FACTORS, size.size)
    factor = np.full((count, is_known.size), np.nan)
    factor[:, is_known] = np.sqrt(np.maximum(size[-count:], 0.0))[:, None] * axes[:, -count:].T
    return factor[::-1], np.maximum(np.diag(covariance) - np.sum(factor**2, axis=0), 0.0)


def _rows(values: Floats) -> list[list[float | None]]:
    return [[float(f"{v:.6g}") if np.isfinite(v) else None for v in row] for row in values.tolist()]
