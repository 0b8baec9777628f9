"""The curves in effect as files: CSV, ECSV, FITS, HDF5, and NuRadio's text. All carry the rows of the JSON answer."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from numpy.typing import NDArray

from lbacal_core.curves.galcal import KEY, make_head
from lbacal_core.errors import BadInputError, name_path
from lbacal_core.provenance import canonical_json

if TYPE_CHECKING:
    from astropy.table import Table

FORMAT = "lbacal-effective-1"
LAYOUT = ("v108", "v108")
"""HDF5's file format: the first that has room for long attributes."""
NURADIO_MHZ = np.arange(101.0)
NO_ANTENNA = -1
ABSENT: dict[type, Any] = {float: np.nan, int: NO_ANTENNA, str: ""}
"""What a column has where there is no value, by the kind of the column."""


@dataclass(frozen=True)
class _Column:
    """How a field is written where columns have a type: numbers are NaN, texts empty where there is none."""

    kind: type[float | int | str]
    description: str
    unit: str = ""

    def convert(self, values: list[Any]) -> NDArray[Any]:
        """The values of all rows."""
        absent = ABSENT[self.kind]
        return np.array([absent if value is None else value for value in values], dtype=self.kind)


COLUMNS = {
    "station": _Column(str, "station; empty for the reference chain of the array"),
    "antenna": _Column(int, "antenna; -1 for a reference chain"),
    "dipole": _Column(str, "letter of the dipole"),
    "frequency_mhz": _Column(float, "centre of the channel", "MHz"),
    "c": _Column(float, "calibration factor C(nu), V per ADC unit", "V"),
    "c_sigma_stat": _Column(float, "statistical standard deviation of c", "V"),
    "c_sigma_sys": _Column(
        float, "systematic standard deviation of c, by the budget that its covariance names; NaN in old versions", "V"
    ),
    "flag": _Column(str, "ok, uncertain, interference, or outside (C is not determined)"),
    "flag_reason": _Column(str, "why the whole curve is uncertain"),
    "factor": _Column(float, "c over the stored curve's: the path's own cable, (L_ref / L_path)^(1/2)"),
    "calibration": _Column(str, "id of the version"),
    "answered_by": _Column(str, "scope of the version: antenna, station or array"),
    "valid_from": _Column(str, "from this instant on it is in effect, UTC"),
    "valid_to": _Column(str, "until then; empty where the interval is open"),
    "c_over_h": _Column(float, "C/|H_zenith|, field along the arm from the zenith: G_ant cancels", "V / m"),
    "antenna_gain": _Column(float, "G_ant that c belongs to; NaN in versions made before it was kept", "m2"),
}


def write_format(name: str, answer: dict[str, Any]) -> bytes:
    """Write an answer to "in effect at" in a format other than JSON: csv, ecsv, fits, hdf5 or nuradio."""
    writers = {"csv": write_csv, "ecsv": write_ecsv, "fits": write_fits, "hdf5": write_hdf5, "nuradio": write_nuradio}
    return writers[name](answer)


def _values_of(curve: dict[str, Any]) -> dict[str, list[Any]]:
    """The values of every column in a curve, one a frequency, or one for all; None where unknown or open."""
    told = curve | {"valid_from": curve["valid"]["from"], "valid_to": curve["valid"]["to"]}
    return {name: value if isinstance(value := told.get(name), list) else [value] for name in COLUMNS}


def rows_of(answer: dict[str, Any]) -> list[dict[str, Any]]:
    """One row per path and frequency, its values by the names in `COLUMNS`.

    An unknown error and an open end are None.
    """
    rows = []
    for curve in answer["curves"]:
        size = len(curve["c"])
        columns = (values if len(values) == size else values * size for values in _values_of(curve).values())
        rows += [dict(zip(COLUMNS, row, strict=True)) for row in zip(*columns, strict=True)]
    return rows


def make_columns(answer: dict[str, Any]) -> dict[str, NDArray[Any]]:
    """Every column as an array by its name, shape (path x freq,): numbers are NaN, texts empty where there is none."""
    columns = {name: [column.convert([])] for name, column in COLUMNS.items()}
    for curve in answer["curves"]:
        for name, values in _values_of(curve).items():
            columns[name].append(np.broadcast_to(COLUMNS[name].convert(values), len(curve["c"])))
    return {name: np.concatenate(parts) for name, parts in columns.items()}


def write_csv(answer: dict[str, Any]) -> bytes:
    """Comma-separated, one head line; empty where unknown or open."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows_of(answer))
    return text.getvalue().encode()


def write_ecsv(answer: dict[str, Any]) -> bytes:
    """Enhanced CSV of astropy: units and descriptions in the head, with covariances and budgets as JSON text."""
    table = make_table(answer)
    table.meta = {"at": answer["at"] or "", "as_of": answer["as_of"] or "", KEY: _write_head(answer)}
    table.meta |= {name: answer[name] for name in ("provenance", "status") if name in answer}
    text = io.StringIO()
    table.write(text, format="ascii.ecsv")
    return text.getvalue().encode()


def write_fits(answer: dict[str, Any]) -> bytes:
    """One binary table, AT and AS_OF in its header. FITS holds ASCII: other characters are written as escapes.

    Covariances and budgets are JSON text, whose bytes are the image GALCAL.
    """
    from astropy.io import fits

    table = make_table(answer)
    escape_texts(table)
    hdu = fits.table_to_hdu(table)
    hdu.header["EXTNAME"] = "EFFECTIVE"
    hdu.header["AT"] = (answer["at"] or "", "when the data were taken, UTC")
    hdu.header["AS_OF"] = (answer["as_of"] or "", "as known at this instant")
    for k, name in enumerate(table.colnames, start=1):
        hdu.header[f"TCOMM{k}"] = COLUMNS[name].description
    head = np.frombuffer(_write_head(answer).encode(), dtype=np.uint8)
    file = io.BytesIO()
    fits.HDUList([fits.PrimaryHDU(), hdu, fits.ImageHDU(head, name=KEY.upper())]).writeto(file)
    return file.getvalue()


def write_hdf5(answer: dict[str, Any]) -> bytes:
    """One dataset [N] a column, with its unit and description as attributes; texts are UTF-8.

    Covariances and budgets are JSON text, an attribute: of more than 64 kB only files of HDF5 1.8 and later hold one.
    """
    file = io.BytesIO()
    with h5py.File(file, "w", libver=LAYOUT) as root:
        root.attrs.update({"format": FORMAT, "at": answer["at"] or "", "as_of": answer["as_of"] or ""})
        root.attrs[KEY] = _write_head(answer)
        for name, values in make_columns(answer).items():
            dataset = root.create_dataset(name, data=_encode_texts(values))
            dataset.attrs.update({"unit": COLUMNS[name].unit, "description": COLUMNS[name].description})
    return file.getvalue()


def escape_texts(table: Table) -> None:
    """Write the texts of a table in ASCII, other characters as escapes: what FITS and astropy's HDF5 hold."""
    for name in table.colnames:
        if table[name].dtype.kind == "U":
            table[name] = np.char.encode(np.asarray(table[name]), "ascii", "backslashreplace")


def _write_head(answer: dict[str, Any]) -> str:
    return canonical_json(make_head(answer))


def _encode_texts(values: NDArray[Any]) -> NDArray[Any]:
    if values.dtype.kind != "U":
        return values
    encoded = np.char.encode(values, "utf-8")
    return encoded.astype(h5py.string_dtype("utf-8", encoded.dtype.itemsize))


def make_table(answer: dict[str, Any]) -> Table:
    """The rows as a table of astropy with units and descriptions."""
    from astropy.table import Column, Table

    return Table(
        [
            Column(values, name, description=COLUMNS[name].description, unit=COLUMNS[name].unit or None)
            for name, values in make_columns(answer).items()
        ]
    )


def write_nuradio(answer: dict[str, Any]) -> bytes:
    """Head lines and C at 0, 1, ... 100 MHz, interpolated between channels and 0 outside the band, for one curve."""
    if len(answer["curves"]) != 1:
        expected = "station, antenna and dipole for nuradio, or scope=array and dipole"
        raise BadInputError("format", expected, f"{len(answer['curves'])} curves")
    curve = answer["curves"][0]
    known = [(frequency, c) for frequency, c in zip(curve["frequency_mhz"], curve["c"], strict=True) if c is not None]
    frequency_mhz, c = np.array(known, dtype=float).T
    values = np.interp(NURADIO_MHZ, frequency_mhz, c, left=0.0, right=0.0)
    gain = curve.get("antenna_gain_sha256")
    head = [
        f"lbacal calibration {curve['calibration'] or 'from a file'}",
        f"{_name_owner(curve)}{' at ' if answer['at'] else ''}{answer['at'] or ''}",
        *([f"uncertain: {curve['flag_reason']}"] if curve["flag_reason"] else []),
        *([f"C belongs to the antenna gain {gain[:12]}: not for the height of another (c_over_h)"] if gain else []),
        "C in V per ADC unit at 0, 1, ... 100 MHz; 0 outside the band",
    ]
    return "".join([f"# {line}\n" for line in head] + [f"{value!r}\n" for value in values.tolist()]).encode()


def mean_curve(answer: dict[str, Any]) -> dict[str, Any]:
    """An answer whose one curve is that of the mean recorded power of its curves, C = (mean of C^-2)^(-1/2).

    A program that scales every channel to one mean Galaxy, such as NuRadioReco's stationGalacticCalibrator, needs this
    one curve for all of them, both dipoles included.
    """
    curves = answer["curves"]
    first = curves[0]
    if any(curve["frequency_mhz"] != first["frequency_mhz"] for curve in curves):
        raise BadInputError("frequency_mhz", "the same channels in every curve", "others")
    c = np.array([curve["c"] for curve in curves], dtype=float)
    known = np.isfinite(c).all(axis=0)
    mean = np.mean(np.where(known, c, 1.0) ** -2.0, axis=0) ** -0.5
    stations = {curve["station"] for curve in curves}
    names = sorted({(curve["calibration"] or "from a file")[:12] for curve in curves})
    return answer | {
        "curves": [
            first | {
                "station": stations.pop() if len(stations) == 1 else None, "antenna": None,
                "dipole": "/".join(sorted({str(one["dipole"]) for one in curves})),
                "calibration": f"{', '.join(names)}: mean recorded power of {len(curves)} curves",
                "c": [value if inside else None for value, inside in zip(mean.tolist(), known, strict=True)],
                "antenna_gain_sha256": None,
            }
        ]
    }  # fmt: skip


def _name_owner(curve: dict[str, Any]) -> str:
    """The path and who answered for it, or that the curve is that of a mean of paths."""
    if curve["antenna"] is None:
        return (
            f"{curve['station'] or 'array'} {curve['dipole']}: reference chain, the mean of its paths: nobody's cable"
        )
    cable = (curve.get("reference") or {}).get("cable")
    through = f", carried through its own cable {cable}" if cable else ""
    path = name_path(curve["station"], curve["antenna"], curve["dipole"])
    answered = f", answered by {curve['answered_by']}" if curve["answered_by"] else ""
    return f"{path}{answered}{through}"
