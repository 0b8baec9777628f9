"""Files of calibration curves (docs/formats/galcal.md): JSON, ECSV, FITS and HDF5 hold the same, CSV the rows alone."""

from __future__ import annotations

import json
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from lbacal.files import write_json
from lbacal.tables import ABSENT, COLUMNS, NO_ANTENNA, write_format
from lbacal_core.curves.galcal import FORMAT, KEY, name_path
from lbacal_core.errors import BadInputError, reading, require_parts
from lbacal_core.hdf5 import INTEGERS, NUMBERS, STRINGS, Kind, open_dataset, read_text, read_values

FORMATS = {
    ".ecsv": "ecsv", ".fits": "fits", ".h5": "hdf5", ".hdf5": "hdf5", ".json": "json", ".csv": "csv",
}  # fmt: skip
"""What a file holds, by the end of its name."""
SUFFIXES = tuple(suffix for suffix in FORMATS if suffix != ".csv")
"""Endings of files that can be read back."""
REQUIRED = ("station", "antenna", "dipole", "frequency_mhz", "c", "c_sigma_stat", "c_sigma_sys", "flag")
"""Columns that no file lacks."""
BY_CHANNEL = ("c", "c_sigma_stat", "c_sigma_sys", "factor", "c_over_h", "antenna_gain")
_UNSAID = {
    **dict.fromkeys(("flag_reason", "calibration", "answered_by", "c_over_h", "antenna_gain", "covariance")),
    "valid": {"from": None, "to": None},
}
_KINDS: dict[type, Kind] = {float: NUMBERS, int: INTEGERS, str: STRINGS}


def require_format(option: str, path: Path) -> None:
    """Refuse a name whose end says none of `FORMATS`; what is no file, such as /dev/stdout, needs none."""
    if (path.is_file() or not path.exists()) and path.suffix.lower() not in FORMATS:
        expected = f"a name that ends in {', '.join(FORMATS)} (lbacal export writes others)"
        raise BadInputError(f"{option} {path}", expected, path.suffix or "no ending")


def write_calibrations(content: Mapping[str, Any], path: Path, kind: str) -> None:
    """Write curves with their covariances and budgets in a format of `FORMATS`, or of `lbacal.tables`."""
    if kind == "json":
        write_json(content, path)
    else:
        path.write_bytes(write_format(kind, dict(content)))


def holds_curves(path: Path) -> bool:
    """Whether a file is to be read as calibration curves: by the end of its name, one of `SUFFIXES`.

    A file of HDF5 that is there may hold other things; its head says whether it does.
    """
    if not path.is_file() or path.suffix.lower() not in (".h5", ".hdf5"):
        return path.suffix.lower() in SUFFIXES
    try:
        with h5py.File(path, "r") as root:
            return KEY in root.attrs
    except OSError:
        return False


def read_calibrations(path: Path) -> dict[str, Any]:
    """Curves, covariances and budgets of a file, as in the JSON answer to "in effect at".

    Its keys are `curves`, `budgets`, `at`, `as_of`. What a file does not say is None; curves without a C, which
    fit.json has too, are left out.
    """
    kind = path.suffix.lower()
    if kind not in SUFFIXES:
        raise BadInputError(str(path), f"a name that ends in {', '.join(SUFFIXES)}", kind or "no ending")
    if not path.is_file():
        raise BadInputError(str(path), "a file", "a folder" if path.is_dir() else "nothing")
    if kind == ".json":
        return complete_curves(_parse(path, path.read_bytes()), path)
    columns, head = {".ecsv": _read_ecsv, ".fits": _read_fits}.get(kind, _read_hdf5)(path)
    require_parts(str(path), "columns", REQUIRED, columns)
    if head is None:
        raise BadInputError(f"{path}: {KEY}", f"the head of {FORMAT}, JSON text", "none")
    return join_rows(str(path), columns, _parse(path, head))


def complete_curves(content: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """A JSON answer or fit report with what it does not say as None, without curves that have no values."""
    curves = content.get("curves")
    if not isinstance(curves, list) or not all(isinstance(curve, dict) for curve in curves):
        raise BadInputError(f"{path}: curves", "a list of curves", repr(curves)[:60])
    kept = []
    for curve in curves:
        if curve.get("c") is None:
            continue
        missing = [name for name in REQUIRED if name not in curve]
        if missing:
            raise BadInputError(
                f"{path}: {name_path(curve)}", f"the fields {', '.join(REQUIRED)}", f"no {', '.join(missing)}"
            )
        kept.append(_UNSAID | {"factor": [1.0] * len(curve["c"])} | curve)
    return {"at": None, "as_of": None, "budgets": {}, **content, "curves": kept}


def _parse(path: Path, text: str | bytes) -> dict[str, Any]:
    with reading(f"{path}: the JSON text in it cannot be read", ValueError):
        content = json.loads(text)
    if not isinstance(content, dict):
        raise BadInputError(str(path), "a JSON object", type(content).__name__)
    return content


def _read_ecsv(path: Path) -> tuple[dict[str, Any], str | None]:
    from astropy.table import Table

    with reading(f"{path}: not an ECSV table", OSError, ValueError, KeyError):
        table = Table.read(path, format="ascii.ecsv")
    return _columns_of(table), table.meta.get(KEY)


def _read_fits(path: Path) -> tuple[dict[str, Any], str | None]:
    from astropy.io import fits
    from astropy.table import Table

    with reading(f"{path}: not a FITS file", OSError, ValueError), fits.open(path) as hdus:
        names = [hdu.name for hdu in hdus]
        table = Table.read(hdus["EFFECTIVE"]) if "EFFECTIVE" in names else Table()
        columns = {name: _unescape(values) for name, values in _columns_of(table).items()}
        return columns, hdus[KEY.upper()].data.tobytes().decode() if KEY.upper() in names else None


def _columns_of(table: Any) -> dict[str, Any]:
    """Columns of an astropy table as arrays."""
    columns = {}
    for name in table.colnames:
        kind = COLUMNS[name].kind if name in COLUMNS else str
        columns[name] = np.asarray(np.ma.filled(table[name], ABSENT[kind]))
    return columns


def _unescape(values: Any) -> Any:
    """Texts as they were before FITS, which holds ASCII with escapes."""
    if values.dtype.kind not in "SU":
        return values
    return np.char.decode(values if values.dtype.kind == "S" else np.char.encode(values, "ascii"), "unicode_escape")


def _read_hdf5(path: Path) -> tuple[dict[str, Any], str | None]:
    with reading(f"{path}: not an HDF5 file", OSError), h5py.File(path, "r") as root:
        columns = {}
        for name in (name for name in COLUMNS if name in root):
            kind, place = _KINDS[COLUMNS[name].kind], f"{path}: {name}"
            columns[name] = read_values(open_dataset(root, name, kind, place), kind, place)
        head = root.attrs.get(KEY)
        return columns, None if head is None else read_text(head, f"{path}: {KEY}")


def join_rows(place: str, columns: Mapping[str, Any], head: Mapping[str, Any]) -> dict[str, Any]:
    """Join arrays by column (`REQUIRED` and others) and a head to one content: adjoining rows of a path are a curve."""
    rows = len(columns["c"])
    if any(len(values) != rows for values in columns.values()):
        raise BadInputError(place, f"{rows} rows in every column", "another number")
    keys = list(zip(*(columns[name].tolist() for name in ("station", "antenna", "dipole")), strict=True))
    edges = [k for k in range(rows) if k == 0 or keys[k] != keys[k - 1]]
    curves = [_make_curve(columns, slice(a, b)) for a, b in pairwise([*edges, rows])]
    covariances = head.get("covariances", {})
    for curve in curves:
        curve["covariance"] = covariances.get(name_path(curve))
    kept = {name: value for name, value in head.items() if name != "covariances"}
    return {"at": None, "as_of": None, "budgets": {}, **kept, "curves": curves}


def _make_curve(columns: Mapping[str, Any], rows: slice) -> dict[str, Any]:
    def texts(name: str) -> str | None:
        return str(columns[name][rows][0]) or None if name in columns else None

    def numbers(name: str) -> list[float | None] | None:
        if name not in columns or not np.any(np.isfinite(columns[name][rows])):
            return None
        return [value if np.isfinite(value) else None for value in columns[name][rows].tolist()]

    antenna = int(columns["antenna"][rows][0])
    curve: dict[str, Any] = {name: numbers(name) for name in BY_CHANNEL}
    curve["factor"] = curve["factor"] or [1.0] * len(columns["c"][rows])
    return curve | {
        "station": texts("station"),
        "antenna": None if antenna == NO_ANTENNA else antenna,
        "dipole": texts("dipole"),
        "frequency_mhz": columns["frequency_mhz"][rows].tolist(),
        "flag": [str(flag) for flag in columns["flag"][rows].tolist()],
        "flag_reason": texts("flag_reason"),
        "calibration": texts("calibration"),
        "answered_by": texts("answered_by"),
        "valid": {"from": texts("valid_from"), "to": texts("valid_to")},
    }
