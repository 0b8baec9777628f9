"""The axes of the data: one list, used by causes, by the search for residual structure, and by figures.

An axis is one entry: its values at the events, and the smooth functions of it that describe residual structure.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lbacal_core.causes.cause import RAIN, TEMPERATURE, Cause, Conditions, SizeRange, Template
from lbacal_core.grids import DAY_S, Floats
from lbacal_core.instrument.chain import ChainTerms

HARMONICS = 5
"""Number of harmonics of a day in LST or UTC; the sky has fewer (|m| <= 4 within 1 %)."""
DATE_WAVES = 10
"""Half waves over the data: structure of five weeks in a year."""
POLYNOMIALS = 4
"""Degree of the Legendre polynomials of a covariate."""
PERIODS_D = (7.0, 27.3, 29.53)
"""Days of a working week, of a solar rotation (Carrington, sidereal 25.4, synodic 27.3) and of a lunar month."""
DATE = "date"
"""The axis on which nothing recurs."""
TAILS = [0.01, 0.99]
"""Quantiles of a covariate between which its polynomials run."""


@dataclass(frozen=True)
class Axis:
    """A quantity along which data may vary.

    Attributes
    ----------
    name
        Name in a report.
    label
        Name in a figure, with its unit.
    values
        Its value at each event, shape (event,), NaN where unknown; None where these data do not have the axis.
    functions
        Smooth functions of the known values, (event,) -> (function, event).
    along
        Name of the axis by which causes call it; a period of dates is ``date``.
    column
        Column of `env` that it is, empty if it is none.
    """

    name: str
    label: str
    values: Callable[[Conditions], Floats | None]
    functions: Callable[[Floats], Floats]
    along: str
    column: str = ""

    def basis(self, conditions: Conditions) -> Floats | None:
        """Smooth functions of the axis, shape (function, event), 0 where it is unknown; None where the data lack it."""
        values = self.values(conditions)
        if values is None:
            return None
        is_known = np.isfinite(values)
        known = self.functions(values[is_known])
        basis = np.zeros((len(known), values.size))
        basis[:, is_known] = known
        return basis


def harmonics(phase: Floats, number: int) -> Floats:
    """Cosines, then sines, of harmonics 1 to `number` of a phase in turns, shape (event,): (2 number, event)."""
    angle = 2 * np.pi * np.outer(np.arange(1, number + 1), phase)
    return np.concatenate([np.cos(angle), np.sin(angle)])


def _unit(values: Floats) -> Floats:
    return np.asarray((values - values.min()) / max(float(np.ptp(values)), 1e-300))


def _polynomials(values: Floats) -> Floats:
    """Legendre polynomials over the range of a covariate, its tails of 1 % clipped."""
    x = 2 * _unit(np.clip(values, *np.quantile(values, TAILS))) - 1
    return np.asarray(np.polynomial.legendre.legvander(x, POLYNOMIALS).T[1:], dtype=float)


def _days(conditions: Conditions) -> Floats | None:
    time_unix = conditions.time_unix
    return np.asarray((time_unix - time_unix.min()) / DAY_S) if conditions.has_dates else None


def _wet(rain: Floats) -> Floats:
    return np.asarray(rain > 0, dtype=float)[None]


def _period(days: float) -> Axis:
    return Axis(
        f"date, period {days:g} d",
        f"day of a period of {days:g} days",
        lambda conditions: np.asarray((conditions.time_unix / DAY_S) % days) if conditions.has_dates else None,
        lambda day: harmonics(day / days, 2),
        "date",
    )


AXES: tuple[Axis, ...] = (
    Axis("lst", "local sidereal time (h)", lambda c: c.lst_hours, lambda h: harmonics(h / 24.0, HARMONICS), "lst"),
    Axis(DATE, "days since the first event", _days, lambda t: harmonics(0.5 * _unit(t), DATE_WAVES), "date"),
    Axis(
        "utc",
        "UTC (h)",
        lambda c: c.utc_hours if c.has_all_hours else None,
        lambda h: harmonics(h / 24.0, HARMONICS),
        "utc",
    ),
    Axis(
        "temperature",
        "temperature (degrees C)",
        lambda c: c.covariate(TEMPERATURE),
        _polynomials,
        "temperature",
        TEMPERATURE,
    ),
    Axis("rain", "rain (mm/h)", lambda c: c.covariate(RAIN), _wet, "rain", RAIN),
    *(_period(days) for days in PERIODS_D),
)
"""Axes of any data; an axis that causes act along is one entry here."""


def list_axes(conditions: Conditions) -> list[Axis]:
    """Every axis along which these data vary: those of the list, and each further column of `env` by its name."""
    named = {axis.name for axis in AXES}
    others = sorted(set(conditions.covariates) - {axis.column for axis in AXES})
    columns = [_column(name, f"env/{name}" if name in named else name) for name in others]
    return [axis for axis in (*AXES, *columns) if axis.values(conditions) is not None]


def _column(column: str, name: str) -> Axis:
    """A column of `env` that no cause knows."""
    return Axis(name, f"env/{column}", lambda conditions: conditions.covariate(column), _polynomials, name, column)


def smooth_functions(
    conditions: Conditions, name: str, column: str | None = None, ends: Sequence[float] | None = None
) -> Floats:
    """Functions of an axis as they were in other data, shape (function, event), 0 where it is unknown.

    Parameters
    ----------
    name
        Name of the axis in a report.
    column, ends
        Column of `env` that it is, and the range of its values in the other data; None for any other axis.
    """
    if column is not None and name != "rain" and ends is not None:
        low, high = ends
        x = 2 * (np.clip(conditions.covariates[column], low, high) - low) / (high - low) - 1
        functions = np.polynomial.legendre.legvander(np.nan_to_num(x), POLYNOMIALS).T[1:]
        return np.asarray(np.where(np.isfinite(x), functions, 0.0), dtype=float)
    # A short window may lack hours or rain, which the term does not mind.
    known = {"utc": conditions.utc_hours, "rain": conditions.covariates.get(RAIN)}
    axis = axis_named(name)
    values = known[name] if name in known else axis.values(conditions)
    if values is None:
        raise ValueError(f"these data have no axis {name}")
    return np.asarray(np.where(np.isfinite(values), axis.functions(np.nan_to_num(values)), 0.0), dtype=float)


def axes_of(conditions: Conditions) -> set[str]:
    """Names, as causes call them, of the axes along which data vary."""
    return {axis.along for axis in AXES if axis.values(conditions) is not None}


def axis_named(name: str) -> Axis:
    """Find one of `AXES` by its name in a report, which must be there."""
    return next(axis for axis in AXES if axis.name == name)


# An empirical term: residual structure along one axis that no cause explains, adopted as what it is.


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
        """All of the recorded power times 1 + amount x term."""
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

    They are `axis`, `by_polarisation`, and for a covariate `column` and `range`.

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
