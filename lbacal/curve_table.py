"""Calibration curves as a table with units, which knows how the errors of its channels move together."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from astropy import units as u
from astropy.table import QTable

from lbacal.units import convert_number, convert_numbers
from lbacal.voltages import budget_of, curve_of
from lbacal_core.curves.curves import INTERFERENCE, CalibrationCurve, statistical_errors, systematic_errors
from lbacal_core.errors import BadInputError, UnknownNameError, name_path
from lbacal_core.grids import Floats

SHOWN_NAMES = 12
_SHOWN = ("station", "antenna", "dipole", "calibration", "answered_by", "valid_from", "valid_to", "flag_reason")
"""Columns of a page, a row a curve."""


@dataclass(frozen=True, repr=False)
class CalibrationValue:
    """C at some frequencies, or its mean over a band, with errors.

    Attributes
    ----------
    frequency
        Where; of a mean its channels.
    c, c_sigma_stat, c_sigma_sys
        V per ADC unit; one number, or one for each frequency.
    covariance
        Statistical and systematic covariance together, V^2.
    """

    frequency: Any
    c: Any
    c_sigma_stat: Any
    c_sigma_sys: Any
    covariance: Any

    @property
    def sigma(self) -> Any:
        """Standard deviation by both."""
        return np.hypot(self.c_sigma_stat, self.c_sigma_sys)

    def __repr__(self) -> str:
        """In microvolts."""
        parts = (np.atleast_1d(one.to_value(u.uV)) for one in (self.c, self.c_sigma_stat, self.c_sigma_sys))
        return "\n".join(
            f"({c:.4g} ± {stat:.2g} (stat) ± {sys:.2g} (syst)) µV" for c, stat, sys in zip(*parts, strict=True)
        )


class CurveTable(QTable):  # type: ignore[misc] # astropy has no types
    """The rows of `lbacal.effective` or of a fit; of one path it gives means and values between channels.

    Examples
    --------
    >>> import lbacal
    >>> curve = lbacal.effective("CS002", antenna=17, dipole="X", at="2014-05-01")  # doctest: +SKIP
    >>> curve.mean(30, 80)  # doctest: +SKIP
    (23.17 ± 0.2 (stat) ± 2.3 (syst)) µV
    >>> lbacal.read("C.ecsv")["CS002", 17, "X"].mean(30, 80)  # doctest: +SKIP
    """

    def __getitem__(self, item: Any) -> Any:
        """As of any table; and by (station, antenna, dipole), (station, dipole) or (dipole,) the rows of one curve."""
        is_name = isinstance(item, tuple) and 0 < len(item) <= 3 and all(isinstance(part, str | int) for part in item)
        if not is_name or not isinstance(item[-1], str) or set(item) <= set(self.colnames):
            return super().__getitem__(item)
        return self.find_curve(item)

    def find_curve(self, name: tuple[Any, ...]) -> CurveTable:
        """The rows of (station, antenna, dipole), (station, dipole) or (dipole,)."""
        station, antenna, dipole = (name[0] if len(name) > 1 else None, name[1] if len(name) > 2 else None, name[-1])
        rows = self.of_path(station, antenna, dipole)
        if len(rows) == 0:
            owners = zip(self["station"].tolist(), self["antenna"].tolist(), self["dipole"].tolist(), strict=True)
            names = [name_path(s or None, None if a < 0 else a, d or None) for s, a, d in dict.fromkeys(owners)]
            raise UnknownNameError("curve", " ".join(map(str, name)), names[:SHOWN_NAMES])
        return rows

    def of_path(self, station: str | None, antenna: int | None, dipole: str | None) -> CurveTable:
        """The rows of one path; None where a curve belongs to a station or the array."""
        own = {"station": station or "", "antenna": -1 if antenna is None else antenna, "dipole": dipole or ""}
        rows: CurveTable = self[np.all([self[name] == value for name, value in own.items()], axis=0)]
        return rows

    def mean(self, low: Any, high: Any) -> CalibrationValue:
        """The mean of C over the channels of a band, interference left out, with the error by their covariance.

        Parameters
        ----------
        low, high
            First and last channel, MHz or a Quantity.
        """
        curve, first, last = curve_of(self), *(convert_number(one, u.MHz) for one in (low, high))
        nu = curve.frequency_mhz
        step = np.diff(nu).max(initial=0.0)
        inside = (nu >= first) & (nu <= last) & curve.has_value & (curve.flags != INTERFERENCE)
        if not np.any(inside) or first <= nu[0] - step or last >= nu[-1] + step:
            expected = f"a band with a channel that has C, within {nu[0]:g} to {nu[-1]:g} MHz"
            raise BadInputError("mean", expected, f"{first:g} to {last:g} MHz")
        return _combine(self, curve, inside[None] / inside.sum(), nu[inside] * u.MHz, is_one=True)

    def at(self, frequency: Any) -> CalibrationValue:
        """C between channels, linear as `lbacal.calibrate_trace` has it, with its covariance.

        Parameters
        ----------
        frequency
            One or several, MHz or a Quantity.
        """
        curve, wanted = curve_of(self), convert_numbers(frequency, u.MHz)
        known = curve.frequency_mhz[curve.has_value]
        if wanted.size == 0 or not np.all((wanted >= known[0]) & (wanted <= known[-1])):
            raise BadInputError("at", f"{known[0]:g} to {known[-1]:g} MHz, where C is known", f"{wanted} MHz")
        weights = np.zeros((wanted.size, curve.frequency_mhz.size))
        weights[:, curve.has_value] = np.array([np.interp(wanted.ravel(), known, row) for row in np.eye(known.size)]).T
        return _combine(self, curve, weights, wanted * u.MHz, is_one=np.ndim(frequency) == 0)

    @property
    def shown(self) -> Any:
        """How it is drawn and saved: as any result of `lbacal`."""
        from lbacal.calibration_files import FORMATS, join_rows, write_calibrations

        def write(kind: str, file: Path) -> None:
            columns = {name: np.asarray(self[name]) for name in self.colnames}
            write_calibrations(join_rows("the table", columns, self.meta), file, kind)

        # by their names: whoever asks a server imports this module, and need not have the extra that draws
        def draw() -> Iterator[Any]:
            yield import_module("lbacal.pages.fit").draw_c([curve_of(self.of_path(*path)) for path in paths])

        rows = list(dict.fromkeys(zip(*(self[name].astype(str).tolist() for name in _SHOWN), strict=True)))
        paths = list(dict.fromkeys((row["station"], row["antenna"], row["dipole"]) for row in self))
        return import_module("lbacal.analysis.result").Result(
            title=f"C, {len(paths)} curves",
            rows=[_SHOWN, *rows],
            words=len(_SHOWN),
            charts=draw,
            more={suffix: partial(write, kind) for suffix, kind in FORMATS.items()},
        )

    def plot(self, ax: Any = None) -> Any:
        """C with both errors; of many paths the medians and the middle 68 % of each dipole."""
        return self.shown.plot(ax)

    def save(self, path: str | Path, form: str | None = None) -> None:
        """Write a calibration file with covariances, a figure or a page, as the end of the name says, or `form`."""
        self.shown.save(path, form)


def _combine(
    table: CurveTable, curve: CalibrationCurve, weights: Floats, frequency: Any, *, is_one: bool
) -> CalibrationValue:
    """Sums of C over channels, with weights of shape (sum, freq), and how their errors move together."""
    channels = np.where(curve.has_value, np.asarray(curve.c), 0.0)
    parts = [
        np.reshape([weights @ (channels * np.nan_to_num(error)) for error in errors], (-1, len(weights)))
        for errors in (statistical_errors(curve), systematic_errors(curve, budget_of(table, curve)))
    ]
    stat, sys = (np.sqrt(np.sum(part**2, axis=0)) * u.V for part in parts)
    covariance = sum(part.T @ part for part in parts) * u.V**2
    c = weights @ channels * u.V
    values = (c[0], stat[0], sys[0], covariance[0, 0]) if is_one else (c, stat, sys, covariance)
    return CalibrationValue(frequency, *values)
