"""Touchstone files of one port or two: S parameters by frequency, as network analysers write them.

Version 1 of the format (IBIS Open Forum 2009, Touchstone File Format Specification 2.0): an option line such as
``# MHz S RI R 50``, then a row a frequency with two numbers for S11, or for each of S11, S21, S12 and S22.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import BadInputError, UnreadableFileError, reading
from lbacal_core.grids import Floats

PORTS = {".s1p": 1, ".s2p": 2}
MHZ = {"HZ": 1e-6, "KHZ": 1e-3, "MHZ": 1.0, "GHZ": 1e3}
FORMS = ("RI", "MA", "DB")
"""Real and imaginary part; size, as it is or in decibels of power, and degrees."""
NOISE_COLUMNS = 5
"""Rows of noise parameters that may stand behind those of two ports."""


def read_touchstone(path: Path) -> tuple[Floats, NDArray[np.complex128], float]:
    """Frequencies, MHz, shape (row,), S parameters, shape (row, port, port), and the reference impedance, ohm.

    Raises
    ------
    UnreadableFileError
        It cannot be read, or has no option line.
    BadInputError
        Neither one port nor two, no S parameters, or rows that are not what these have.
    """
    with reading(f"{path}: expected a Touchstone file", OSError):
        lines = [line.partition("!")[0].strip() for line in path.read_text(encoding="latin-1").splitlines()]
    ports = PORTS.get(path.suffix.lower())
    if ports is None:
        raise BadInputError(str(path), "a Touchstone file of one port (.s1p) or two (.s2p)", repr(path.suffix))
    options = next((line[1:].upper().split() for line in lines if line.startswith("#")), None)
    if options is None:
        raise UnreadableFileError(f"{path}: expected a Touchstone file (a line such as # MHz S RI R 50), found none")
    scale, form, reference = _read_options(options, path)
    rows = [line.split() for line in lines if line and line[0] not in "#["]
    rows = [row for row in rows if ports == 1 or len(row) != NOISE_COLUMNS]
    width = 2 * ports**2 + 1
    try:
        table = np.array(rows, dtype=float).reshape(len(rows), width)
    except ValueError as error:
        raise BadInputError(str(path), f"rows of {width} numbers, {ports} port(s)", "others") from error
    if len(table) == 0 or not np.all(np.isfinite(table)) or np.any(np.diff(table[:, 0]) <= 0):
        raise BadInputError(str(path), "rows of finite numbers, their frequencies rising", f"{len(table)} rows")
    one, other = table[:, 1::2], table[:, 2::2]
    size = 10.0 ** (one / 20.0) if form == "DB" else one
    values = np.asarray(one + 1j * other if form == "RI" else size * np.exp(1j * np.radians(other)), dtype=complex)
    return scale * table[:, 0], values.reshape(-1, ports, ports).swapaxes(1, 2), reference  # S21 stands before S12


def _read_options(options: list[str], path: Path) -> tuple[float, str, float]:
    """Unit in MHz, form of the numbers and reference impedance; what the line leaves out is GHz, MA and 50 ohm."""
    unit, form, reference = "GHZ", "MA", "50"
    rest = iter(options)
    for word in rest:
        if word in MHZ:
            unit = word
        elif word in FORMS:
            form = word
        elif word == "R":
            reference = next(rest, "")
        elif word != "S":
            raise BadInputError(
                f"{path}: {' '.join(options)}", "S parameters by Hz, kHz, MHz or GHz as RI, MA or DB", word
            )
    try:
        return MHZ[unit], form, float(reference)
    except ValueError as error:
        raise BadInputError(f"{path}: R", "the reference impedance in ohm", repr(reference)) from error
