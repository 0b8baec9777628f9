"""What is known of an antenna gain: where its numbers come from, and how far they may be off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.json_values import parse_name, parse_number, parse_numbers, parse_optional_name

ABSOLUTE, RELATIVE = "absolute", "relative"
"""What an antenna gain is: in m^2 by itself, or tied to something else by a factor or a shape."""


@dataclass(frozen=True)
class GainProvenance:
    """Where the numbers of an antenna gain come from, and how far they may be off.

    Attributes
    ----------
    kind
        ``absolute``: G_ant is in m^2 by itself, from a table of voltage per field. ``relative``: its level or its shape
        was chosen so that something else agrees.
    source
        What it was made from, in words.
    shape_error, scale_error
        One standard deviation of ln G_ant, shape (freq,), and that of its common factor; None where nobody knows.
    antenna_sha256
        Digest of the antenna model that it was taken from; None where it is that of no model.
    """

    kind: str
    source: str
    shape_error: Floats | None = None
    scale_error: float | None = None
    antenna_sha256: str | None = None

    def __str__(self) -> str:
        """What a user is told."""
        known = [
            "unknown" if error is None else f"{100 * error:.0f} % ({name})"
            for name, error in (
                ("shape, at most", None if self.shape_error is None else float(self.shape_error.max())),
                ("common factor", self.scale_error),
            )
        ]
        return f"{self.kind}: {self.source}; error of ln G_ant {', '.join(dict.fromkeys(known))}"

    def as_dict(self) -> dict[str, Any]:
        """The provenance as JSON values; what is not known is absent."""
        values = {
            "kind": self.kind,
            "source": self.source,
            "shape_error": None if self.shape_error is None else self.shape_error.tolist(),
            "scale_error": self.scale_error,
            "antenna_sha256": self.antenna_sha256,
        }
        return {name: value for name, value in values.items() if value is not None}


def parse_gain_provenance(content: Any, channels: int, place: str) -> GainProvenance | None:
    """Make the provenance from the content of an instrument file; None where it says nothing."""
    if content is None:
        return None
    if not isinstance(content, dict):
        raise BadInputError(place, "an object with kind and source", type(content).__name__)
    kind = content.get("kind")
    if kind not in (ABSOLUTE, RELATIVE):
        raise BadInputError(f"{place}: kind", f"{ABSOLUTE} or {RELATIVE}", repr(kind))
    shape, scale = content.get("shape_error"), content.get("scale_error")
    errors = np.empty(0) if shape is None else parse_numbers(shape if isinstance(shape, list) else [shape], place)
    scale_error = None if scale is None else parse_number(scale, f"{place}: scale_error")
    if np.any(errors < 0) or (scale_error is not None and scale_error < 0):
        raise BadInputError(place, "errors >= 0", "a negative one")
    return GainProvenance(
        kind=kind,
        source=parse_name(content.get("source"), f"{place}: source"),
        shape_error=None if shape is None else (errors if isinstance(shape, list) else np.full(channels, errors[0])),
        scale_error=scale_error,
        antenna_sha256=parse_optional_name(content.get("antenna_sha256"), f"{place}: antenna_sha256"),
    )
