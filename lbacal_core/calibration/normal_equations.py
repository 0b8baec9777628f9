"""Normal equations of parameters of any magnitude, many systems at once: scaled to a unit diagonal, then solved."""

from __future__ import annotations

import numpy as np

from lbacal_core.grids import Floats

RIDGE = 1e-14
"""What is added to the unit diagonal, 45 times the rounding of a double: parameters that the data cannot tell apart get
a finite answer instead of an error, and every other answer moves by this times the condition number."""

LOST_TO_ROUNDING = 1e-12
"""Eigenvalues below this share of the largest are rounding, where a system is singular in spite of the ridge."""


def scale_to_unit_diagonal(normal: Floats) -> tuple[Floats, Floats]:
    """Scaled matrices, shape (problem, k, k), and the unit of each parameter, shape (problem, k).

    A parameter that the data do not determine has a row of zeros and keeps it.
    """
    unit = 1.0 / np.sqrt(np.maximum(np.einsum("pii->pi", normal), 1e-300))
    return normal * unit[:, :, None] * unit[:, None, :], unit


def solve_normal_equations(normal: Floats, target: Floats, ridge: float = RIDGE) -> Floats:
    """Solve symmetric systems N x = t.

    Parameters
    ----------
    normal
        N, shape (problem, k, k).
    target
        t, shape (problem, k, column).

    Returns
    -------
    Shape (problem, k, column); 0 for a parameter that the data do not determine.
    """
    scaled, unit = scale_to_unit_diagonal(normal)
    scaled += ridge * np.eye(normal.shape[1])
    scaled_target = unit[:, :, None] * target
    try:
        solution = np.linalg.solve(scaled, scaled_target)
    except np.linalg.LinAlgError:  # rounding took what the ridge gave: which matrix meets it depends on the processor
        solution = np.linalg.pinv(scaled, rcond=LOST_TO_ROUNDING, hermitian=True) @ scaled_target
    return np.asarray(unit[:, :, None] * solution)
