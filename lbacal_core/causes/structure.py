"""An empirical term: residual structure along one axis that no cause explains, adopted as what it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lbacal_core.causes.axes import AXES, DATE, TAILS, smooth_functions
from lbacal_core.causes.cause import Cause, SizeRange, Template
from lbacal_core.causes.conditions import Conditions
from lbacal_core.chain.terms import ChainTerms
from lbacal_core.grids import Floats


@dataclass(frozen=True)
class ResidualTerm(Cause):
    """A change of the recorded power by smooth functions of an axis times smooth functions of frequency.

    It has no place in the chain. Its template holds the axis and, by polarisation, the coefficients of the products,
    shape (function of frequency, function of the axis); of a column of the data the range of its values too.
    """

    identifier: str = "residual_structure"
    unit: str = "fraction of the structure that was found"
    meaning: str = "structure that no cause of the catalogue explains"
    confirm: str = "look for what follows the same axis at the same frequencies"
    sizes: SizeRange = SizeRange(-1.0, 3.0)

    def covariates(self, template: Template) -> Sequence[str]:
        """The column that is the axis."""
        column = template.parameters.get("column")
        return (column,) if column else ()

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:
        """All of the recorded power times 1 + the term."""
        change = 1.0 + amount * read_term(conditions, template.parameters)
        return replace(
            terms,
            front=terms.front * change,
            receiver_noise=terms.receiver_noise * change,
            adc_noise=terms.adc_noise * change,
        )


def read_term(conditions: Conditions, parameters: Mapping[str, Any]) -> Floats:
    """The relative change of the power of each class, shape (class, event, freq)."""
    basis = smooth_functions(conditions, parameters["axis"], parameters.get("column"), parameters.get("range"))
    by_polarisation = {name: np.array(rows, dtype=float) for name, rows in parameters["by_polarisation"].items()}
    degree = len(next(iter(by_polarisation.values()))) - 1
    x = np.linspace(-1, 1, conditions.frequency_mhz.size)
    polynomials = np.polynomial.legendre.legvander(x, degree)
    nothing = np.zeros((degree + 1, len(basis)))
    return np.stack([(polynomials @ by_polarisation.get(letter, nothing) @ basis).T for letter in conditions.dipoles])


def describe_term(conditions: Conditions, axis: str, coefficients: Mapping[str, Floats]) -> dict[str, Any] | None:
    """The parameters of a term along an axis of these data; None along the date, where nothing recurs.

    Parameters
    ----------
    coefficients
        By polarisation, shape (function of frequency, function of the axis).
    """
    if axis == DATE:
        return None
    found: dict[str, Any] = {"axis": axis}
    known = next((one for one in AXES if one.name == axis), None)
    column = axis.removeprefix("env/") if known is None else known.column
    if column:
        values = conditions.covariates[column]
        found |= {"column": column, "range": np.quantile(values[np.isfinite(values)], TAILS).tolist()}
    return found | {"by_polarisation": {name: values.tolist() for name, values in coefficients.items()}}
