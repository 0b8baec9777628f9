"""Where a station stands, if that is not where its instrument stands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from lbacal_core.errors import BadInputError
from lbacal_core.json_values import parse_number

RANGES = {"latitude_deg": (-90.0, 90.0), "longitude_deg": (-180.0, 360.0), "height_m": (-500.0, 9000.0)}


@dataclass(frozen=True)
class Site:
    """Geodetic latitude and longitude, degrees, east positive, and height above the ellipsoid, m."""

    latitude_deg: float
    longitude_deg: float
    height_m: float

    def require_on_earth(self, place: str) -> None:
        """Refuse a site that is nowhere."""
        for field, (low, high) in RANGES.items():
            value = getattr(self, field)
            if not low <= value <= high:
                raise BadInputError(f"{place}: {field}", f"{low:g} to {high:g}", f"{value}")

    def as_dict(self) -> dict[str, float]:
        """The fields of an instrument file."""
        return asdict(self)


def parse_sites(content: Any, place: str, height_m: float) -> dict[str, Site]:
    """Read the sites of stations, by name; a station without a height stands at that of the instrument."""
    if content is None:
        return {}
    if not isinstance(content, Mapping) or not all(isinstance(one, Mapping) for one in content.values()):
        raise BadInputError(place, "an object of latitude_deg and longitude_deg by station", "another shape")
    return {
        str(station): Site(
            parse_number(one.get("latitude_deg"), f"{place}.{station}.latitude_deg"),
            parse_number(one.get("longitude_deg"), f"{place}.{station}.longitude_deg"),
            parse_number(one.get("height_m", height_m), f"{place}.{station}.height_m"),
        )
        for station, one in content.items()
    }
