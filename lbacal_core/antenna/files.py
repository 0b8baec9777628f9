"""Jones tables from files: .npz, the text layout of docs/formats.md, and exports of FEKO, NEC and WIPL-D.

The simulators transmit. By reciprocity the far field of a dipole that carries 1 A is proportional to its effective
height times the frequency, so E/nu is read as the Jones term. Its scale per frequency also holds the input current,
which these files do not give; the direction response D is free of it, the gain G_ant is not. Their angle phi
runs counterclockwise seen from above and is counted from the arm, which must lie along x; azimuth runs the other
way, and with it the direction of e_phi.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lbacal_core.antenna.table import JonesTable
from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.grids import Floats
from lbacal_core.npz import read_npz

COLUMNS = ("frequency_mhz", "zenith_deg", "azimuth_deg", "theta_re", "theta_im", "phi_re", "phi_im")

Row = tuple[float, float, float, complex, complex]
"""Frequency in MHz, zenith angle and azimuth from the arm in degrees, J_theta, J_phi."""


def read_jones_npz(path: Path) -> JonesTable:
    """Read arrays frequency_mhz, zenith_deg, azimuth_deg, v_theta, v_phi (freq, zenith, azimuth)."""
    wanted = ("frequency_mhz", "zenith_deg", "azimuth_deg", "v_theta", "v_phi")
    content = read_npz(path, wanted, "Jones terms")
    frequency_mhz, zenith, azimuth = (np.asarray(content[key], dtype=float) for key in wanted[:3])
    theta, phi = (np.asarray(content[key], dtype=complex) for key in wanted[3:])
    if azimuth.size > 1 and azimuth[-1] == 360.0:
        azimuth, theta, phi = azimuth[:-1], theta[..., :-1], phi[..., :-1]
    return JonesTable(path.stem, frequency_mhz, zenith, azimuth, theta, phi)


def read_jones_text(path: Path) -> JonesTable:
    """Read a file of Jones terms, telling its kind from its first lines."""
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise UnreadableFileError(f"{path}: expected text ({error})") from error
    head = "\n".join(lines[:400])
    kinds: list[tuple[bool, Callable[[list[str], Path], Iterator[Row]]]] = [
        (any(line.replace(" ", "") == ",".join(COLUMNS) for line in lines[:100]), _rows_of_text),
        (head.startswith("##File Type: Far Field") or "#Configuration Name" in head, _rows_of_feko),
        ("RADIATION PATTERNS" in "\n".join(lines), _rows_of_nec),
        (bool(lines) and lines[0].lstrip().startswith(">"), _rows_of_wipl),
    ]
    for applies, rows_of in kinds:
        if applies:
            return _table_of_rows(list(rows_of(lines, path)), path, has_level=rows_of is _rows_of_text)
    raise UnreadableFileError(
        f"{path}: expected Jones terms as text with the columns {','.join(COLUMNS)}, a FEKO .ffe file, "
        "a NEC output with radiation patterns or a WIPL-D .ra1 file, found none of these"
    )


def _numbers(fields: list[str], place: str) -> list[float]:
    try:
        values = [float(field) for field in fields]
    except ValueError as error:
        raise BadInputError(place, "numbers", " ".join(fields)[:60]) from error
    if not np.all(np.isfinite(values)):
        raise BadInputError(place, "finite numbers", " ".join(fields)[:60])
    return values


def _rows_of_text(lines: list[str], path: Path) -> Iterator[Row]:
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.startswith("#") or line.replace(" ", "") == ",".join(COLUMNS):
            continue
        values = _numbers(line.split(","), f"{path}, line {number}")
        if len(values) != len(COLUMNS):
            raise BadInputError(f"{path}, line {number}", f"{len(COLUMNS)} columns", f"{len(values)}")
        nu, zenith, azimuth, theta_re, theta_im, phi_re, phi_im = values
        yield nu, zenith, azimuth, complex(theta_re, theta_im), complex(phi_re, phi_im)


def _transmitted(nu: float, theta_deg: float, phi_deg: float, e_theta: complex, e_phi: complex) -> Row:
    return nu, theta_deg, -phi_deg % 360.0, e_theta / nu, -e_phi / nu


def _rows_of_feko(lines: list[str], path: Path) -> Iterator[Row]:
    nu = None
    for number, line in enumerate(lines, start=1):
        if line.startswith("#Frequency:"):
            nu = _numbers([line.split(":")[1]], f"{path}, line {number}")[0] / 1e6
        if not line.strip() or line.lstrip().startswith(("#", "*")):
            continue
        if nu is None:
            raise BadInputError(f"{path}, line {number}", "#Frequency: above the first row", "none")
        values = _numbers(line.split(), f"{path}, line {number}")
        if len(values) < 6:
            raise BadInputError(f"{path}, line {number}", "theta, phi, E_theta and E_phi", f"{len(values)} columns")
        yield _transmitted(nu, values[0], values[1], complex(*values[2:4]), complex(*values[4:6]))


def _rows_of_nec(lines: list[str], path: Path) -> Iterator[Row]:
    nu = None
    is_pattern = False
    for number, line in enumerate(lines, start=1):
        if found := re.search(r"FREQUENCY\s*[=:]\s*([0-9.E+-]+)\s*MHZ", line, re.IGNORECASE):
            nu, is_pattern = _numbers([found[1]], f"{path}, line {number}")[0], False
        elif "RADIATION PATTERNS" in line:
            is_pattern = True
        elif is_pattern and nu is not None:
            fields = [field for field in line.split() if not field.isalpha()]
            if len(fields) == 11 and re.match(r"^-?[\d.]+$", fields[0]):
                values = _numbers(fields, f"{path}, line {number}")
                e_theta = values[7] * np.exp(1j * np.radians(values[8]))
                e_phi = values[9] * np.exp(1j * np.radians(values[10]))
                yield _transmitted(nu, values[0], values[1], complex(e_theta), complex(e_phi))


def _rows_of_wipl(lines: list[str], path: Path) -> Iterator[Row]:
    nu = 0.0
    for number, line in enumerate(lines, start=1):
        if line.lstrip().startswith(">"):
            fields = line.split()
            if len(fields) < 5:
                raise BadInputError(f"{path}, line {number}", "a header with the frequency in GHz as fifth field", line)
            nu = _numbers([fields[4]], f"{path}, line {number}")[0] * 1e3
        elif line.strip():
            values = _numbers(line.split(), f"{path}, line {number}")
            if len(values) < 6:
                raise BadInputError(f"{path}, line {number}", "phi, theta, E_phi and E_theta", f"{len(values)} columns")
            # WIPL-D counts theta from the horizon upwards, so e_theta points up.
            yield _transmitted(nu, 90.0 - values[1], values[0], -complex(*values[4:6]), complex(*values[2:4]))


def _table_of_rows(rows: list[Row], path: Path, *, has_level: bool) -> JonesTable:
    """Rows in any order on a full grid; rows below the horizon and at 360 degrees are dropped."""
    kept = [row for row in rows if -1e-9 <= row[1] <= 90.0 + 1e-9]
    if not kept:
        raise UnreadableFileError(f"{path}: expected rows of Jones terms, found none above the horizon")
    axes: list[Floats] = []
    places: list[NDArray[np.intp]] = []
    for column in range(3):
        values = np.round(np.array([row[column] for row in kept], dtype=float), 6)
        if column == 2:
            values %= 360.0
        axis, place = np.unique(values, return_inverse=True)
        axes.append(axis)
        places.append(place)
    theta = np.full([axis.size for axis in axes], np.nan, dtype=complex)
    phi = theta.copy()
    theta[tuple(places)] = [row[3] for row in kept]
    phi[tuple(places)] = [row[4] for row in kept]
    holes = np.argwhere(np.isnan(theta))
    if holes.size:
        nu, zenith, azimuth = (axis[index] for axis, index in zip(axes, holes[0], strict=True))
        raise BadInputError(
            str(path),
            "a row for every frequency, zenith angle and azimuth",
            f"none at {nu:g} MHz, {zenith:g}, {azimuth:g} deg",
        )
    return JonesTable(path.stem, axes[0], axes[1], axes[2], theta, phi, has_level)
