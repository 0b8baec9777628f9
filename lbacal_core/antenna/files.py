"""Jones tables from files: .npz, text (docs/formats/antenna-models.md), and exports of FEKO, NEC and WIPL-D.

The simulators transmit. By reciprocity the far field of a dipole that carries 1 A is proportional to its effective
height times the frequency, so E/nu is read as the Jones term. Its scale per frequency also holds the input current,
which these files do not give; the direction response D is free of it, the gain G_ant is not. Their angle phi
runs counterclockwise seen from above and is counted from the arm, which must lie along x; azimuth runs the other
way, and with it the direction of e_phi.
"""

from __future__ import annotations

import pickle
import re
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from lbacal_core.antenna.model import Complexes, JonesTable
from lbacal_core.errors import BadInputError, UnreadableFileError, needing, reading
from lbacal_core.foreign import read_npz, read_text
from lbacal_core.grids import Floats

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
    lines = read_text(path).splitlines()
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
    """Rows in any order on a full grid; rows below the horizon are dropped."""
    kept = [row for row in rows if -1e-9 <= row[1] <= 90.0 + 1e-9]
    if not kept:
        raise UnreadableFileError(f"{path}: expected rows of Jones terms, found none above the horizon")
    frequency, zenith, azimuth, theta, phi = (np.array(column) for column in zip(*kept, strict=True))
    axes, grids = grid_rows(str(path), (frequency, zenith, azimuth), (theta, phi))
    return JonesTable(path.stem, axes[0], axes[1], axes[2], grids[0], grids[1], has_level)


# Jones terms in somebody else's coordinates, turned so that the arm is where this package expects it.
#
# Other programs count the angle phi counterclockwise seen from above, from an axis of their own. Which way the arm lies
# is read from the pattern itself: at zenith a dipole answers to the field along its arm.

LEAST_LINEAR = 0.9
"""Share of the response at zenith along one direction, below which an antenna has no arm."""
SAME_RESPONSE = 1e-3
"""Rows of one direction, as of 0 and 360 degrees, may differ by this part of the largest response: by rounding."""


def grid_rows(
    place: str, columns: tuple[Floats, Floats, Floats], values: tuple[Complexes, ...]
) -> tuple[list[Floats], list[Complexes]]:
    """Axes and grids of rows in any order, one of every combination: frequency, zenith angle and phi.

    Parameters
    ----------
    columns
        Frequency (MHz), zenith angle and phi (deg) of each row, shape (row,); 360 degrees of phi are 0.
    values
        What the rows hold, shape (row,) each.

    Returns
    -------
    The three axes, rising, and of each of the values the grid, shape (freq, zenith, phi).

    Raises
    ------
    BadInputError
        Where a combination is missing, or two rows of one say different things.
    """
    frequency, zenith, phi = (np.round(column, 6) for column in columns)
    axes, places = [], []
    for column in (frequency, zenith, phi % 360.0):
        axis, at = np.unique(column, return_inverse=True)
        axes.append(axis)
        places.append(at)
    shape = tuple(axis.size for axis in axes)
    grids = []
    for value in values:
        grid = np.full(shape, np.nan, dtype=complex)
        grid[tuple(places)] = value
        grids.append(grid)
    holes = np.argwhere(np.isnan(grids[0]))
    expected = "row for every frequency, zenith angle and azimuth"
    if holes.size:
        nu, theta, angle = (axis[k] for axis, k in zip(axes, holes[0], strict=True))
        raise BadInputError(place, f"a {expected}", f"none at {nu:g} MHz, {theta:g}, {angle:g} deg")
    apart = np.max([np.abs(grid[tuple(places)] - value) for grid, value in zip(grids, values, strict=True)], axis=0)
    row = int(np.argmax(apart))
    if apart[row] > SAME_RESPONSE * np.abs(values).max():
        where = f"{frequency[row]:g} MHz, {zenith[row]:g}, {phi[row]:g} deg"
        raise BadInputError(place, f"one {expected}", f"two that differ at {where}")
    return axes, grids


def turn_to_arm(
    name: str, place: str, axes: list[Floats], theta: Complexes, phi: Complexes, *, has_level: bool
) -> JonesTable:
    """The table of a dipole, its arm at azimuth 0.

    Parameters
    ----------
    axes
        Frequency (MHz), zenith angle (deg, from 0), and phi (deg, even steps from 0, counterclockwise from above).
    theta, phi
        Response to a field along increasing zenith angle and phi, shape (freq, zenith, phi).
    """
    frequency_mhz, zenith, angles = axes
    if zenith[0] != 0 or angles.size < 8 or not np.allclose(angles, np.arange(angles.size) * 360.0 / angles.size):
        expected = "zenith angles from 0, and 8 or more even steps of phi from 0 to below 360 deg"
        raise BadInputError(place, expected, f"from {zenith[0]:g}; {angles.size} from {angles[0]:g} to {angles[-1]:g}")
    above = zenith <= 90.0
    turned = _along(np.radians(angles), _arm_of(place, np.radians(angles), theta[:, 0], phi[:, 0]))
    return JonesTable(
        name, frequency_mhz, zenith[above], angles, theta[:, above] @ turned, -phi[:, above] @ turned, has_level
    )


def _arm_of(place: str, angle: Floats, theta: Complexes, phi: Complexes) -> float:
    """The direction of the arm from the axis phi = 0, rad, from the response at zenith, shape (freq, phi) each.

    A field along the horizontal vector e gives h e; e_theta is (cos, sin) of phi there, and e_phi (-sin, cos).
    """
    along_x = np.mean(theta * np.cos(angle) - phi * np.sin(angle), axis=1)
    along_y = np.mean(theta * np.sin(angle) + phi * np.cos(angle), axis=1)
    size = np.maximum(np.abs(along_x) ** 2 + np.abs(along_y) ** 2, 1e-300)
    response = np.stack([along_x, along_y]) / np.sqrt(size)
    share, directions = np.linalg.eigh(np.mean((response[:, None] * response[None].conj()).real, axis=2))
    if not share[1] >= LEAST_LINEAR:
        expected = f"one arm: {LEAST_LINEAR:.0%} of the response at zenith to a field along one direction"
        raise BadInputError(place, expected, f"{max(share[1], 0.0):.0%}")
    return float(np.arctan2(directions[1, 1], directions[0, 1]))


def _along(angle: Floats, arm: float) -> NDArray[np.complex128]:
    """What takes values at phi to the azimuths from the arm: phi = arm - azimuth; shape (phi, azimuth).

    Interpolation between the steps of phi is by the Fourier series through them.
    """
    size = angle.size
    order = np.arange(-(size // 2), size // 2 + 1)
    weight = np.where((2 * np.abs(order) == size), 0.5, 1.0)
    there = np.exp(-1j * np.outer(angle, order)) * weight / size
    return np.asarray(there @ np.exp(1j * np.outer(order, arm - angle)))


# Antenna models of the Pierre Auger Observatory's Offline: XML with the vector effective height by direction.
#
# `<frequency>`, `<theta>` and `<phi>` list frequencies and directions, `<EAHTheta_amp idfreq="...">` and its three like
# the height towards each direction, amplitude in m and phase in degrees, for one frequency. There is no root element.

TERM = re.compile(r"<(frequency|theta|phi|EAH(?:Theta|Phi)_(?:amp|phase))\b([^>]*)>(.*?)</\1>", re.DOTALL)
IDENTIFIER = re.compile(r"idfreq\s*=\s*[\"']\s*([0-9.eE+-]+)")
COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)


def read_aera_xml(path: Path) -> JonesTable:
    """Read the heights of one dipole."""
    text = COMMENT.sub("", read_text(path))
    lists: dict[str, Floats] = {}
    of_frequency: dict[tuple[str, float], Floats] = {}
    for name, attributes, values in TERM.findall(text):
        numbers = np.array(_numbers(values.split(), f"{path}: {name}"))
        named = IDENTIFIER.search(attributes)
        if named is None:
            lists[name] = numbers
        else:
            of_frequency[name, round(float(named[1]), 2)] = numbers
    missing = [name for name in ("frequency", "theta", "phi") if name not in lists]
    if missing:
        expected = "an antenna model of Auger Offline with frequency, theta, phi and EAHTheta_amp"
        raise UnreadableFileError(f"{path}: expected {expected}, found no {', '.join(missing)}")
    frequency_mhz, zenith, phi = (lists[name] for name in ("frequency", "theta", "phi"))
    if zenith.shape != phi.shape:
        raise BadInputError(f"{path}: phi", f"{zenith.size} numbers as theta has", f"{phi.size}")
    heights = [
        np.concatenate([_height(of_frequency, name, nu, zenith.size, path) for nu in frequency_mhz])
        for name in ("EAHTheta", "EAHPhi")
    ]
    rows = (
        np.repeat(frequency_mhz, zenith.size),
        np.tile(zenith, frequency_mhz.size),
        np.tile(phi, frequency_mhz.size),
    )
    axes, grids = grid_rows(str(path), rows, (heights[0], heights[1]))
    return turn_to_arm(path.stem, str(path), axes, grids[0], grids[1], has_level=True)


def _height(
    of_frequency: dict[tuple[str, float], Floats], name: str, nu: float, directions: int, path: Path
) -> Complexes:
    """One component of the height at one frequency, shape (direction,), m."""
    parts = []
    for part in ("amp", "phase"):
        values = of_frequency.get((f"{name}_{part}", round(float(nu), 2)))
        if values is None or values.size != directions:
            found = "none" if values is None else f"{values.size}"
            raise BadInputError(f"{path}: {name}_{part} at {nu:g} MHz", f"{directions} numbers", found)
        parts.append(values)
    return np.asarray(parts[0] * np.exp(1j * np.radians(parts[1])))


# Antenna models of NuRadioMC: a pickled list of arrays with the vector effective length by frequency and direction.
#
# A pickle may name any function of any module to be called when it is read. This reader knows the few of NumPy's that
# an array is made with, and refuses a file that names another: nothing of a file is executed.

MHZ_PER_UNIT = 1e3
"""NuRadioMC's frequencies are in GHz, its angles in rad, its lengths in m."""
NURADIO_COLUMNS = ("frequency", "theta", "phi", "H_phi", "H_theta")
_UNPICKLING = (
    pickle.UnpicklingError, OSError, EOFError, ValueError, TypeError, LookupError, AttributeError, ImportError,
    MemoryError,
)  # fmt: skip


def _encode(text: str, encoding: str) -> bytes:
    """Bytes as an old protocol writes them."""
    return text.encode("latin1" if encoding == "latin1" else "ascii")


def _from_buffer(
    content: bytes, dtype: np.dtype[Any], shape: tuple[int, ...], order: Literal["C", "F"]
) -> NDArray[Any]:
    """An array as protocol 5 writes it."""
    return np.frombuffer(content, dtype=dtype).reshape(shape, order=order)


class _Arrays(pickle.Unpickler):
    """Reads arrays and numbers, and nothing else."""

    known: ClassVar[dict[str, Any]] = {
        "numpy.ndarray": np.ndarray,
        "numpy.dtype": np.dtype,
        "numpy.core.multiarray._reconstruct": np.empty(0).__reduce__()[0],
        "numpy.core.multiarray.scalar": np.float64(0.0).__reduce__()[0],
        "numpy.core.numeric._frombuffer": _from_buffer,
        "_codecs.encode": _encode,
    }

    def find_class(self, module_name: str, global_name: str, /) -> Any:
        """Find the class of an array or number of NumPy's; a name of NumPy 2 is that of NumPy 1 with an underscore."""
        name = f"{module_name}.{global_name}".replace("numpy._core", "numpy.core")
        if name not in self.known:
            raise pickle.UnpicklingError(f"it names {name}, which is no part of an array")
        return self.known[name]


def read_nuradio_pickle(path: Path) -> JonesTable:
    """Read the effective length of one dipole.

    The list holds four angles of the antenna's orientation, which are not needed, because the arm shows in the pattern,
    and arrays with one row a frequency and direction; azimuth runs counterclockwise from east.
    """
    expected = f"a pickled list of four angles and the arrays {', '.join(NURADIO_COLUMNS)}"
    with reading(f"{path}: expected {expected}", *_UNPICKLING), path.open("rb") as file:
        content = _Arrays(file).load()
        frequency, zenith, phi, h_phi, h_theta = (np.asarray(column).ravel() for column in content[4:9])
        rows = (frequency.astype(float) * MHZ_PER_UNIT, np.degrees(zenith.astype(float)), np.degrees(phi.astype(float)))
        values = (h_theta.astype(complex), h_phi.astype(complex))
    if len({column.size for column in (*rows, *values)}) != 1:
        raise UnreadableFileError(f"{path}: expected {expected}, found arrays of different sizes")
    kept = (rows[0] > 0) & (rows[1] <= 90.0 + 1e-6)
    axes, grids = grid_rows(str(path), (rows[0][kept], rows[1][kept], rows[2][kept]), tuple(v[kept] for v in values))
    return turn_to_arm(path.stem, str(path), axes, grids[0], grids[1], has_level=True)


# Antenna models of pyuvdata: E-field beams in BeamFITS files (UVBeam), by azimuth and zenith angle.


def read_uvbeam(path: Path) -> JonesTable:
    """Read the first feed of a beam.

    Azimuth of a UVBeam runs from east through north; of its two components the first is along azimuth, the second along
    the zenith angle. Levels of beams come from a transmitter of unknown input and say nothing of G_ant.
    """
    with needing(f"{path}, a beam of pyuvdata,", "import"):
        from pyuvdata import UVBeam
    broken = reading(f"{path}: expected a BeamFITS file", OSError, LookupError, ValueError, TypeError, AttributeError)
    with broken, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        beam = UVBeam.from_file(str(path))
    found = f"a {beam.beam_type} beam on {beam.pixel_coordinate_system}"
    if beam.beam_type != "efield" or beam.pixel_coordinate_system != "az_za":
        raise BadInputError(str(path), "an E-field beam by azimuth and zenith angle (efield, az_za)", found)
    zenith, phi = np.degrees(beam.axis2_array), np.degrees(beam.axis1_array)
    basis = beam.basis_vector_array
    if not np.allclose(basis[0, 0], 1.0) or not np.allclose(basis[1, 1], 1.0):
        raise BadInputError(f"{path}: basis_vector_array", "components along azimuth and zenith angle", "others")
    # axes of the data are component, feed, freq, zenith, azimuth
    along_phi, along_theta = beam.data_array[0, 0], beam.data_array[1, 0]
    if np.isclose(phi[-1] - phi[0], 360.0):
        phi, along_phi, along_theta = phi[:-1], along_phi[..., :-1], along_theta[..., :-1]
    axes = [np.asarray(beam.freq_array, dtype=float) / 1e6, np.round(zenith, 9), phi]
    return turn_to_arm(path.stem, str(path), axes, along_theta, along_phi, has_level=False)
