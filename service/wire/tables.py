"""The curves in effect as files: CSV, ECSV, and the text that NuRadio reads. All carry the rows of the JSON answer."""

from __future__ import annotations

import csv
import io
from typing import Any

import numpy as np

from lbacal_core.errors import BadInputError

COLUMNS = (
    "station", "antenna", "dipole", "frequency_mhz", "c", "c_sigma_stat", "c_sigma_sys", "flag", "flag_reason",
    "factor", "calibration", "answered_by", "valid_from", "valid_to",
)  # fmt: skip
NURADIO_MHZ = np.arange(101.0)
FORMATS = {"json": "application/json", "csv": "text/csv", "ecsv": "text/x-ecsv", "nuradio": "text/plain"}

VERSION_FORMATS = tuple(FORMATS)


def choose_format(wanted: str | None, accept: str | None) -> str:
    """The format of an answer: `format=` wins over the header Accept."""
    if wanted is not None:
        if wanted not in FORMATS:
            raise BadInputError("format", f"one of {', '.join(FORMATS)}", repr(wanted[:40]))
        return wanted
    media = {kind: name for name, kind in FORMATS.items() if name != "nuradio"}
    for part in (accept or "").split(","):
        kind = part.partition(";")[0].strip().lower()
        if kind in media:
            return media[kind]
    return "json"


def write_format(name: str, answer: dict[str, Any]) -> bytes:
    """Write an answer to "in effect at" in one of the text formats."""
    return {"csv": write_csv, "ecsv": write_ecsv, "nuradio": write_nuradio}[name](answer)


def rows_of(answer: dict[str, Any]) -> list[dict[str, Any]]:
    """One row per path and frequency; an unknown error and an open end are None."""
    rows = []
    for curve in answer["curves"]:
        system = curve["c_sigma_sys"] or [None] * len(curve["c"])
        for k, frequency in enumerate(curve["frequency_mhz"]):
            rows.append(
                {
                    "station": curve["station"], "antenna": curve["antenna"], "dipole": curve["dipole"],
                    "frequency_mhz": frequency, "c": curve["c"][k], "c_sigma_stat": curve["c_sigma_stat"][k],
                    "c_sigma_sys": system[k], "flag": curve["flag"][k], "flag_reason": curve["flag_reason"],
                    "factor": curve["factor"][k],
                    "calibration": curve["calibration"], "answered_by": curve["answered_by"],
                    "valid_from": curve["valid"]["from"], "valid_to": curve["valid"]["to"],
                }
            )  # fmt: skip
    return rows


def write_csv(answer: dict[str, Any]) -> bytes:
    """Comma-separated, one head line; empty where unknown or open."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows_of(answer))
    return text.getvalue().encode()


def write_ecsv(answer: dict[str, Any]) -> bytes:
    """Enhanced CSV of astropy: units and descriptions in the head."""
    from astropy import units as u
    from astropy.table import Column, Table

    rows = rows_of(answer)
    units = {"frequency_mhz": u.MHz, "c": u.V, "c_sigma_stat": u.V, "c_sigma_sys": u.V}
    described = {
        "c": "calibration factor C(nu), V per ADC unit",
        "c_sigma_stat": "statistical standard deviation of c",
        "c_sigma_sys": "systematic standard deviation of c: of single paths where a wider scope answers; else NaN",
        "frequency_mhz": "centre of the channel",
        "flag": "ok or uncertain",
        "flag_reason": "why it is uncertain",
        "factor": "c over the stored curve's: the path's own cable, (L_ref / L_path)^(1/2)",
        "calibration": "id of the version",
        "answered_by": "scope of the version: antenna, station or array",
        "valid_to": "empty where the interval is open",
    }
    table = Table()
    for name in COLUMNS:
        values = [row[name] for row in rows]
        if name in units or name == "factor":
            column = Column(np.array([np.nan if v is None else v for v in values], dtype=float), unit=units.get(name))
        elif name == "antenna":
            column = Column(np.array([-1 if v is None else v for v in values], dtype=np.int64))
        else:
            column = Column(np.array(["" if v is None else v for v in values], dtype=np.str_))
        column.description = described.get(name)
        table[name] = column
    table.meta = {"at": answer["at"], "as_of": answer["as_of"] or ""}
    text = io.StringIO()
    table.write(text, format="ascii.ecsv")
    return text.getvalue().encode()


def write_nuradio(answer: dict[str, Any]) -> bytes:
    """Head lines and C at 0, 1, ... 100 MHz, interpolated between channels and 0 outside the band, for one curve."""
    if len(answer["curves"]) != 1:
        expected = "station, antenna and dipole for nuradio, or scope=array and dipole"
        raise BadInputError("format", expected, f"{len(answer['curves'])} curves")
    curve = answer["curves"][0]
    values = np.interp(NURADIO_MHZ, curve["frequency_mhz"], curve["c"], left=0.0, right=0.0)
    head = [
        f"lbacal calibration {curve['calibration']}",
        f"{_name_owner(curve)} at {answer['at']}",
        *([f"{curve['flag'][0]}: {curve['flag_reason']}"] if curve["flag_reason"] else []),
        "C in V per ADC unit at 0, 1, ... 100 MHz; 0 outside the band",
    ]
    return "".join([f"# {line}\n" for line in head] + [f"{value!r}\n" for value in values.tolist()]).encode()


def _name_owner(curve: dict[str, Any]) -> str:
    """The path and who answered for it, or that the curve is that of a mean of paths."""
    if curve["antenna"] is None:
        return (
            f"{curve['station'] or 'array'} {curve['dipole']}: reference chain, the mean of its paths: nobody's cable"
        )
    cable = (curve.get("reference") or {}).get("cable")
    through = f", carried through its own cable {cable}" if cable else ""
    path = f"{curve['station']} antenna {curve['antenna']} dipole {curve['dipole']}"
    return f"{path}, answered by {curve['answered_by']}{through}"
