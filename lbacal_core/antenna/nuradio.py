"""Antenna models of NuRadioMC: a pickled list of arrays with the vector effective length by frequency and direction.

A pickle may name any function of any module to be called when it is read. This reader knows the few of NumPy's that an
array is made with, and refuses a file that names another: nothing of a file is executed.
"""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from lbacal_core.antenna.arm import grid_rows, turn_to_arm
from lbacal_core.antenna.table import JonesTable
from lbacal_core.errors import UnreadableFileError

MHZ_PER_UNIT = 1e3
"""NuRadioMC's frequencies are in GHz, its angles in rad, its lengths in m."""
COLUMNS = ("frequency", "theta", "phi", "H_phi", "H_theta")


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
        """What makes an array or a number of NumPy's; a name of NumPy 2 is that of NumPy 1 with an underscore."""
        name = f"{module_name}.{global_name}".replace("numpy._core", "numpy.core")
        if name not in self.known:
            raise pickle.UnpicklingError(f"it names {name}, which is no part of an array")
        return self.known[name]


def read_nuradio_pickle(path: Path) -> JonesTable:
    """Read the effective length of one dipole.

    The list holds four angles of the antenna's orientation, which are not needed, because the arm shows in the pattern,
    and arrays with one row a frequency and direction; azimuth runs counterclockwise from east.
    """
    expected = f"a pickled list of four angles and the arrays {', '.join(COLUMNS)}"
    try:
        with path.open("rb") as file:
            content = _Arrays(file).load()
        frequency, zenith, phi, h_phi, h_theta = (np.asarray(column).ravel() for column in content[4:9])
        rows = (frequency.astype(float) * MHZ_PER_UNIT, np.degrees(zenith.astype(float)), np.degrees(phi.astype(float)))
        values = (h_theta.astype(complex), h_phi.astype(complex))
    except (pickle.UnpicklingError, OSError, EOFError, ValueError, TypeError, LookupError, AttributeError, ImportError,
            MemoryError) as error:  # fmt: skip
        raise UnreadableFileError(f"{path}: expected {expected} ({error})") from error
    if len({column.size for column in (*rows, *values)}) != 1:
        raise UnreadableFileError(f"{path}: expected {expected}, found arrays of different sizes")
    kept = (rows[0] > 0) & (rows[1] <= 90.0 + 1e-6)
    axes, grids = grid_rows(str(path), (rows[0][kept], rows[1][kept], rows[2][kept]), tuple(v[kept] for v in values))
    return turn_to_arm(path.stem, str(path), axes, grids[0], grids[1], has_level=True)
