"""G_ant from an antenna model: the power pattern at zenith of a table of voltage per field."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lbacal_core.antenna.model import zenith_gain
from lbacal_core.antenna.names import ANTENNAS, load_antenna
from lbacal_core.antenna_gain import ABSOLUTE, RELATIVE
from lbacal_core.errors import BadInputError
from lbacal_core.json_values import parse_numbers


def take_antenna_gain(
    content: Mapping[str, Any],
    place: str,
    antenna: str,
    source: str,
    *,
    is_absolute: bool,
    shape_error: float | None = None,
    scale_error: float | None = None,
) -> dict[str, Any]:
    """The content of an instrument file with G_ant of an antenna model, which it names and says the provenance of.

    Parameters
    ----------
    content
        What an instrument file holds, with or without `antenna_gain`.
    antenna
        File of Jones terms in V per V/m.
    source
        Who computed or measured the table, and how.
    is_absolute
        Whether the table is in V per V/m at the load; otherwise G_ant is right up to a factor.
    shape_error, scale_error
        One standard deviation of ln G_ant: of its shape over frequency, and of its common factor.
    """
    model = load_antenna(antenna)
    if antenna in ANTENNAS or not getattr(model, "has_level", False):
        raise BadInputError(
            f"antenna {antenna}",
            "a file of voltage per field (.npz or text)",
            "a pattern that does not give the level of G_ant over frequency",
        )
    frequency_mhz = parse_numbers(content.get("frequency_mhz"), f"{place}: frequency_mhz")
    gain = zenith_gain(model, frequency_mhz)
    provenance: dict[str, Any] = {"kind": ABSOLUTE if is_absolute else RELATIVE, "source": source}
    errors = {"shape_error": shape_error, "scale_error": scale_error}
    provenance |= {name: error for name, error in errors.items() if error is not None}
    provenance["antenna_sha256"] = model.digest()
    named = {"antenna": str(Path(antenna).resolve()), "antenna_gain": [float(f"{value:.6g}") for value in gain]}
    return {**content, **named, "antenna_gain_provenance": provenance}
