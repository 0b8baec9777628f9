"""Which format an answer has: `format=` decides, else the header Accept, as far as we can serve it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, TypeVar

from service.errors import NotAcceptableError

Format = Literal["json", "csv", "ecsv", "fits", "hdf5", "nuradio"]
FORMATS: dict[Format, str] = {
    "json": "application/json",
    "csv": "text/csv",
    "ecsv": "text/x-ecsv",
    "fits": "application/fits",
    "hdf5": "application/x-hdf5",
    "nuradio": "text/plain",
}
"""Media type of each format of a calibration. The first that a client takes is served."""
Name = TypeVar("Name")
_BY_NAME_ONLY = ("nuradio",)
"""Its 101 numbers are not what somebody means who takes any text."""


def choose_format(wanted: Format | None, accept: str | None) -> Format:
    """The format of an answer about calibrations."""
    if wanted is not None:
        return wanted
    return choose_media({name: media for name, media in FORMATS.items() if name not in _BY_NAME_ONLY}, accept)


def choose_media(offered: Mapping[Name, str], accept: str | None) -> Name:
    """The name of the offered media type that a client likes best, the first of those it likes equally.

    RFC 9110, 12.5.1: `type/subtype` goes before `type/*`, and that before `*/*`; what has quality 0 is refused.
    """
    ranges = _parse_accept(accept or "*/*")
    quality = {name: _quality(media, ranges) for name, media in offered.items()}
    best = max(quality, key=lambda name: quality[name])
    if quality[best] <= 0.0:
        raise NotAcceptableError(f"this answer is {' or '.join(offered.values())}, not {str(accept)[:60]}")
    return best


def _quality(media: str, ranges: Mapping[str, float]) -> float:
    family = media.partition("/")[0]
    return next((ranges[name] for name in (media, f"{family}/*", "*/*") if name in ranges), 0.0)


def _parse_accept(accept: str) -> dict[str, float]:
    """Quality of each media range; one that cannot be read has quality 0."""
    ranges: dict[str, float] = {}
    for part in accept.split(","):
        name, *parameters = (piece.strip().lower() for piece in part.split(";"))
        if name:
            given = [value for key, _, value in (p.partition("=") for p in parameters) if key.strip() == "q"]
            ranges[name] = max(ranges.get(name, 0.0), _parse_quality(given[0].strip() if given else "1"))
    return ranges or {"*/*": 1.0}


def _parse_quality(text: str) -> float:
    try:
        quality = float(text)
    except ValueError:
        return 0.0
    return quality if 0.0 <= quality <= 1.0 else 0.0
