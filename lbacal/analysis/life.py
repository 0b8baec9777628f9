"""`lbacal.life`: what was in effect when for a path, a station or the array, what happened to it, and C over time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from astropy import units as u
from astropy.table import QTable

from lbacal.analysis.result import Result
from lbacal.client import Client
from lbacal.lives import ask_life, tell_life
from lbacal.pages.chart import MARK, POINTS, RED, Chart, Series
from lbacal_core.errors import name_path

MIDDLE_S = 14 * 86_400.0
"""From the beginning of a month to its middle."""


@dataclass(frozen=True, repr=False, kw_only=True)
class Life(Result):
    """A life: `content` is the answer of ``GET /v1/paths/{station}/{antenna}/{dipole}/life``.

    `table` holds C of every month over that of the first year, with its error or, of many paths, the middle 68 %.
    """

    content: Mapping[str, Any]


def life(station: str | None = None, antenna: int | None = None, dipole: str | None = None) -> Life:
    """All that the server knows of a path, of a station, or of the array, on one time axis.

    Parameters
    ----------
    station, antenna, dipole
        A path; the station alone, or nothing for the array.

    Examples
    --------
    >>> import lbacal
    >>> found = lbacal.life("CS002", antenna=17, dipole="X")  # doctest: +SKIP
    >>> [change["at"]["value"] for change in found.content["changes"]]  # doctest: +SKIP
    ['2015-05-20T03:12:00Z']
    """
    with Client() as client:
        content = ask_life(client, station, antenna, dipole)
        drift = client.get("/v1/drift", station=station, antenna=antenna, dipole=dipole)
    months = drift["months"]
    names = {"c_ratio": "c_over_first_year", "low": "low", "high": "high"}
    columns = {new: [one[old] for one in months] * u.dimensionless_unscaled for old, new in names.items()}
    return Life(
        title=name_path(station, antenna, dipole),
        rows=[("date", "what happened"), *tell_life(content)],
        words=2,
        notes=[f"versions: {len(content['versions'])}, epochs: {len(content['epochs'])}"],
        charts=lambda: [_draw(content, months)],
        as_dict=lambda: content,
        as_table=lambda: QTable({"month": [one["month"] for one in months], **columns}),
        content=content,
    )


def _draw(content: Mapping[str, Any], months: list[dict[str, Any]]) -> Chart:
    """C of every month with its error, and the changes as lines: those in force whole, others dotted."""
    time = np.array([one["month"] for one in months], dtype="datetime64[M]").astype("datetime64[s]").astype(float)
    ratio, low, high = (np.array([one[name] for one in months], dtype=float) for name in ("c_ratio", "low", "high"))
    series = [Series(POINTS, time + MIDDLE_S, ratio, low, high, "C of a month")]
    for one in content["changes"]:
        style = 0 if one["decision"] == "in_force" and one["ended_at"] is None else 2
        at, name = np.datetime64(one["at"]["value"][:10], "s").astype(float), f"change {one['id']}"
        series.append(Series(MARK, [at], name=name, colour=RED, style=style, titles=[name]))
    return Chart("C over time", "date", "C over that of the first year", series, ("time", "linear"))
