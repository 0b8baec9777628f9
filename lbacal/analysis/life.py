"""`lbacal.life`: what was in effect when for a path, a station or the array, what happened to it, and C over time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from astropy import units as u
from astropy.table import QTable

from lbacal.analysis.result import Result
from lbacal.client import Client
from lbacal.lives import ask_life, tell_life
from lbacal_core.errors import name_path


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
        draw_on=partial(_draw, content=content, months=months),
        as_dict=lambda: content,
        as_table=lambda: QTable({"month": [one["month"] for one in months], **columns}),
        content=content,
    )


def _draw(axes: Any, content: Mapping[str, Any], months: list[dict[str, Any]]) -> None:
    """C of every month with its error, and the changes as lines: those in force whole, others dotted."""
    time = np.array([one["month"] for one in months], dtype="datetime64[M]").astype("datetime64[D]") + 14
    ratio, low, high = (np.array([one[name] for one in months], dtype=float) for name in ("c_ratio", "low", "high"))
    axes.errorbar(time, ratio, [ratio - low, high - ratio], fmt="o", ms=3, lw=1, color="black", label="C of a month")
    for one in content["changes"]:
        style = "-" if one["decision"] == "in_force" and one["ended_at"] is None else ":"
        at = np.datetime64(one["at"]["value"][:10])
        axes.axvline(at, color="C3", ls=style, lw=1.2)
        words = f" change {one['id']}"
        axes.text(at, 1.0, words, transform=axes.get_xaxis_transform(), va="top", fontsize=8, color="C3")
    axes.set(xlabel="date", ylabel="C over that of the first year")
    axes.tick_params(axis="x", rotation=30)
