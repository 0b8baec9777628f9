"""What a file of calibration curves holds beside its rows (docs/formats/galcal.md)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lbacal_core.instrument import Instrument

FORMAT = "galcal-1"
KEY = "galcal"
"""Where the head stands: a key of ECSV's metadata, an attribute of the HDF5 root, an image HDU of FITS."""
CARRIED = ("instrument", "models", "provenance")
"""Optional parts of a head."""


def name_path(curve: Mapping[str, Any]) -> str:
    """A path in words, as the key of its covariance: ``CS002 17 X``."""
    return " ".join(str(curve[name]) for name in ("station", "antenna", "dipole") if curve[name] not in (None, "", -1))


def make_head(content: Mapping[str, Any]) -> dict[str, Any]:
    """Everything of an answer or of a fit report that is not a row, as JSON values."""
    return {
        "format": FORMAT,
        "at": content.get("at"),
        "as_of": content.get("as_of"),
        "covariances": {name_path(one): one["covariance"] for one in content["curves"] if one.get("covariance")},
        "budgets": content.get("budgets", {}),
        **{name: content[name] for name in CARRIED if name in content},
    }


def describe_made_with(instrument: Instrument, models: Mapping[str, Any] | None) -> dict[str, Any]:
    """The parts of a head that say where the antennas stand, how their arms point, and what the sky power is made of.

    Parameters
    ----------
    models
        `MadeFor.as_dict` of the sky power; None where it says nothing.
    """
    whole = instrument.as_dict()
    kept = ("name", "latitude_deg", "longitude_deg", "height_m", "dipoles", "sites")
    described = {name: whole[name] for name in kept if name in whole} | {"sha256": instrument.digest()}
    named = {name: value for name, value in (models or {}).items() if name in ("sky", "antenna", "hashes")}
    return {"instrument": described, **({"models": named} if named else {})}
