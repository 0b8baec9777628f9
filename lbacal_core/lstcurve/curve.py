"""A measured LST curve: band power against local sidereal time, and its file (docs/formats.md)."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lbacal_core.data.lofar import DIPOLES
from lbacal_core.data.tables import SHIPPED
from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.grids import Floats
from lbacal_core.linear import fit_least_squares
from lbacal_core.provenance import hash_arrays

COLUMNS = ("lst_h", "x_db", "y_db", "error_db")
CENTRE_LINE = "# lst: centre"
FEWEST_POINTS = 4
"""Per dipole: fewer cannot be compared with anything after a noise share and an offset are fitted."""


@dataclass(frozen=True)
class LstCurve:
    """Band power of both dipoles, averaged over antennas, relative to LST 0.

    Attributes
    ----------
    lst_hours
        Shape (point,), hours, the middle of each bin.
    variation_db
        For each polarisation, shape (point,), dB; NaN where there is no point.
    error_db
        Shape (point,), dB, one standard deviation as drawn or stated; NaN where there is no point at all.
    bin_hours
        Width of a bin.
    is_centre_stated
        Whether a comment in the file declares its LST to be bin centres; otherwise they were read as left edges, and
        half a bin is a systematic uncertainty.
    """

    lst_hours: Floats
    variation_db: Mapping[str, Floats]
    error_db: Floats
    bin_hours: float
    is_centre_stated: bool
    origin: str = "LST curve"

    def __post_init__(self) -> None:
        for dipole in DIPOLES:
            found = int(np.isfinite(self.variation_db[dipole]).sum())
            if found < FEWEST_POINTS:
                column = f"{dipole.lower()}_db"
                raise BadInputError(f"{self.origin}: {column}", f"at least {FEWEST_POINTS} points", f"{found}")

    def has_point(self, dipole: str) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Where the dipole was measured, shape (point,)."""
        return np.isfinite(self.variation_db[dipole])

    def digest(self) -> str:
        """Hash of the numbers, which names this curve in provenance."""
        return hash_arrays(self.lst_hours, *(self.variation_db[dipole] for dipole in DIPOLES), self.error_db)


def measured_curve() -> Path:
    """The shipped LST variation of the LOFAR low band, as a file that `read_lst_curve` reads."""
    return Path(str(SHIPPED / "measured_lst_variation.csv"))


def read_lst_curve(path: Path) -> LstCurve:
    """Read an LST curve, naming the line of whatever is wrong."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise UnreadableFileError(f"{path}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise UnreadableFileError(f"{path}: expected a CSV file, found something that is not text") from error
    place = path.name
    numbered = [(k, line) for k, line in enumerate(text.splitlines(), start=1) if line.strip()]
    is_centre_stated = any(line.strip().lower() == CENTRE_LINE for _, line in numbered)
    numbered = [(k, line) for k, line in numbered if not line.lstrip().startswith("#")]
    if not numbered:
        raise UnreadableFileError(f"{path}: expected the columns {', '.join(COLUMNS)}, found an empty file")
    header = [name.strip() for name in next(csv.reader([numbered[0][1]]))]
    missing = [name for name in COLUMNS if name not in header]
    if missing:
        raise BadInputError(place, f"the columns {', '.join(COLUMNS)}", f"no {', '.join(missing)}")
    rows = [_parse_row(header, line, f"{place}: line {k}") for k, line in numbered[1:]]
    if not rows:
        raise BadInputError(place, "at least one row below the header", "none")
    table = dict(zip(COLUMNS, np.array(rows).T, strict=True))
    lst = table["lst_h"]
    order = np.argsort(lst, kind="stable")
    twice = order[1:][np.diff(lst[order]) == 0]
    if twice.size:
        raise BadInputError(
            f"{place}: line {numbered[1 + int(twice[0])][0]}", "one row an LST", f"{lst[twice[0]]:g} twice"
        )
    bin_hours = float(np.median(np.diff(lst[order]))) if lst.size > 1 else 0.0
    return LstCurve(
        lst_hours=lst if is_centre_stated else (lst + bin_hours / 2) % 24.0,
        variation_db={"X": table["x_db"], "Y": table["y_db"]},
        error_db=table["error_db"],
        bin_hours=bin_hours,
        is_centre_stated=is_centre_stated,
        origin=place,
    )


def _parse_row(header: list[str], line: str, place: str) -> list[float]:
    cells = next(csv.reader([line]))
    if len(cells) != len(header):
        raise BadInputError(place, f"{len(header)} cells as in the header", f"{len(cells)}")
    row = dict(zip(header, cells, strict=True))
    values = {name: _parse_cell(row[name], f"{place}: {name}") for name in COLUMNS}
    if not 0 <= values["lst_h"] < 24:
        raise BadInputError(f"{place}: lst_h", "hours from 0 to 24", row["lst_h"].strip() or "an empty cell")
    if not (math.isnan(values["x_db"]) and math.isnan(values["y_db"])) and not values["error_db"] > 0:
        raise BadInputError(f"{place}: error_db", "dB > 0 beside a point", row["error_db"].strip() or "an empty cell")
    return [values[name] for name in COLUMNS]


def _parse_cell(text: str, place: str) -> float:
    if not text.strip():
        return math.nan
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise BadInputError(place, "a finite number, or an empty cell for no point", text.strip())
    return value


# The noise of the points of an LST curve, from their scatter about a smooth curve: smaller than drawn bars may be.

SMOOTH_HARMONICS = 6
"""Harmonics of the smooth curve whose residuals estimate the noise of the points: the sky has fewer (|m| <= 4)."""
FEWEST_FREE = 5
"""Degrees of freedom below which a point noise is not worth stating (32 % uncertain)."""
LARGEST_CORRELATION = 0.99
"""Beyond, the difference of the dipoles would count as nearly free of noise because of a few points."""


@dataclass(frozen=True)
class PointNoise:
    """Noise of the points of both dipoles.

    The mean of an LST bin is over the same events for both dipoles, whose common gain fluctuates: what they share
    leaves their difference more precise than either.

    Attributes
    ----------
    sigma_db
        By dipole, dB.
    correlation
        Between the dipoles at one LST.
    free
        Degrees of freedom from which the level is known.
    """

    sigma_db: dict[str, float]
    correlation: float
    free: int

    def covariance(self, curve: LstCurve) -> Floats:
        """Covariance of the points, X then Y, those that exist; dB^2, shape (point, point)."""
        place = [np.flatnonzero(curve.has_point(dipole)) for dipole in DIPOLES]
        sigma = np.concatenate([np.full(at.size, self.sigma_db[d]) for d, at in zip(DIPOLES, place, strict=True)])
        index = np.concatenate(place)
        shared = np.where(index[:, None] == index[None, :], self.correlation, 0.0)
        np.fill_diagonal(shared, 1.0)
        return np.asarray(sigma[:, None] * shared * sigma[None, :])


def estimate_noise(curve: LstCurve, harmonics: int = SMOOTH_HARMONICS) -> PointNoise:
    """Estimate the noise of both dipoles and what they share."""
    left = {dipole: _about_smooth(curve, dipole, harmonics) for dipole in DIPOLES}
    free = {dipole: int(curve.has_point(dipole).sum()) - 1 - 2 * harmonics for dipole in DIPOLES}
    if min(free.values()) < FEWEST_FREE:
        needed = f"{1 + 2 * harmonics + FEWEST_FREE} points or more a dipole to estimate their noise"
        raise BadInputError(curve.origin, needed, f"{min(free.values()) + 1 + 2 * harmonics}")
    sigma = {dipole: float(np.sqrt(np.nansum(left[dipole] ** 2) / free[dipole])) for dipole in DIPOLES}
    both = np.isfinite(left["X"]) & np.isfinite(left["Y"])
    x, y = left["X"][both], left["Y"][both]
    correlation = float(x @ y / np.sqrt((x @ x) * (y @ y)))
    limited = float(np.clip(correlation, -LARGEST_CORRELATION, LARGEST_CORRELATION))
    return PointNoise(sigma, limited, sum(free.values()))


def estimate_point_noise(curve: LstCurve, dipole: str) -> float | None:
    """Scatter of the points of one dipole about a smooth curve, dB; None with too few points."""
    free = int(curve.has_point(dipole).sum()) - 1 - 2 * SMOOTH_HARMONICS
    if free < FEWEST_FREE:
        return None
    left = _about_smooth(curve, dipole, SMOOTH_HARMONICS)
    return float(np.sqrt(np.nansum(left**2) / free))


def _about_smooth(curve: LstCurve, dipole: str, harmonics: int) -> Floats:
    """Measured minus the Fourier series that fits best, shape (point,), NaN where there is no point."""
    has_point = curve.has_point(dipole)
    angle = 2 * np.pi / 24.0 * np.outer(curve.lst_hours[has_point], np.arange(1, harmonics + 1))
    design = np.concatenate([np.ones((angle.shape[0], 1)), np.cos(angle), np.sin(angle)], axis=1)
    measured = curve.variation_db[dipole][has_point]
    left = np.full(curve.lst_hours.shape, np.nan)
    left[has_point] = measured - design @ fit_least_squares(design, measured)
    return left
