"""NumPy `.npz` files from strangers: named arrays, or one sentence on why not."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import BadInputError, UnreadableFileError

_FAILURES = (OSError, ValueError, EOFError, KeyError, RuntimeError, MemoryError, zipfile.BadZipFile, zlib.error)
"""What NumPy and zipfile raise on broken files."""


def read_npz(path: Path, wanted: tuple[str, ...], words: str) -> dict[str, NDArray[Any]]:
    """Read every array of a file, which must hold the required ones.

    Parameters
    ----------
    words
        What the file should hold, for the message: ``Jones terms``.
    """
    try:
        # Opened here, because np.load leaves a broken file open.
        with path.open("rb") as file:
            arrays = np.load(file, allow_pickle=False)
            content = {key: arrays[key] for key in arrays.files} if isinstance(arrays, np.lib.npyio.NpzFile) else {}
    except _FAILURES as error:
        raise UnreadableFileError(f"{path}: expected a NumPy .npz file of {words}, found a broken one") from error
    missing = [key for key in wanted if key not in content]
    if missing:
        raise BadInputError(str(path), f"the arrays {', '.join(wanted)}", f"no {', '.join(missing)}")
    return content
