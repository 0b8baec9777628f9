"""Files written whole or not at all: beside their place, brought to the disk, then renamed."""

from __future__ import annotations

import json
import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lbacal_core.errors import LbacalError, require_kind

_IN_HDF5 = re.compile(r"errno = [0-9]+, error message = '([^']*)'")
"""How the HDF5 library says what the system said; when it closes a file, in a RuntimeError."""


class UnwritableError(LbacalError, status=500, code="unwritable"):
    """A file that cannot be written, as on a full disk."""

    def __init__(self, path: Path, error: OSError | RuntimeError) -> None:
        of_hdf5 = _IN_HDF5.search(str(error))
        reason = of_hdf5[1] if of_hdf5 else getattr(error, "strerror", None) or str(error)
        super().__init__(f"{path} could not be written: {reason}; what was there before is unchanged")


@contextmanager
def written_beside(path: Path) -> Iterator[Path]:
    """A name beside `path`, of the same suffix, for a file that takes its place when the block has ended well.

    Whatever goes wrong before that (a full disk, Ctrl-C), the file that was there stays as it was. What is no file,
    such as /dev/stdout, is written itself.
    """
    path = path.resolve() if path.is_symlink() else path
    if path.exists() and not path.is_file():
        yield path
        return
    beside = path.with_name(f".{path.stem}.{secrets.token_hex(4)}{path.suffix}")
    try:
        yield beside
        with beside.open("rb+") as file:
            os.fsync(file.fileno())
        if path.exists():
            beside.chmod(path.stat().st_mode & 0o777)
        beside.replace(path)
    except (OSError, RuntimeError) as error:
        is_elsewhere = isinstance(error, OSError) and error.filename is not None and Path(error.filename) != beside
        is_of_hdf5 = isinstance(error, OSError) or _IN_HDF5.search(str(error)) is not None
        if is_elsewhere or not is_of_hdf5:
            raise
        raise UnwritableError(path, error) from error
    finally:
        beside.unlink(missing_ok=True)


def write_json(content: Any, path: Path) -> None:
    """Write JSON for people, which never holds NaN."""
    path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def path_of(place: str, file: Any) -> Path:
    """The path of a file that is named."""
    require_kind(place, file, str | Path, "the name of a file")
    return Path(file)
