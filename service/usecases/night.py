"""The night's summary: what an investigation of a station says that the one before did not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lbacal_core.errors import write_chance
from service.storage.investigations import Investigation

STRONGER_SIGMA = 2.0
"""A significance that rises by less is no news: it scatters by 1 from one set of events to the next."""
Key = tuple[Any, ...]


@dataclass(frozen=True)
class StationNews:
    """The newest investigation of a station, and how it differs from the one before.

    Attributes
    ----------
    before
        The id of the one before: of the same window where there is one, else of the window before; None for the first.
    new, stronger
        Sentences about findings that the one before did not have, or that are more significant by `STRONGER_SIGMA`.
    gone
        Sentences about findings that only the one before has.
    """

    newest: Investigation
    before: str | None
    new: Sequence[str]
    stronger: Sequence[str]
    gone: Sequence[str]


def tell_news(newest: Investigation, before: Investigation | None) -> StationNews:
    """Compare two investigations of a station, finding by finding."""
    now = _findings(newest.report)
    then = {} if before is None else _findings(before.report)
    stronger = []
    for key, finding in now.items():
        rise = finding["significance_sigma"] - then[key]["significance_sigma"] if key in then else 0.0
        if rise >= STRONGER_SIGMA:
            was, now_is = then[key]["significance_sigma"], finding["significance_sigma"]
            stronger.append(f"{finding['sentence']} ({was:.1f} -> {now_is:.1f} sigma)")
    return StationNews(
        newest,
        None if before is None else before.id,
        new=[one["sentence"] for key, one in now.items() if key not in then],
        stronger=stronger,
        gone=[one["sentence"] for key, one in then.items() if key not in now],
    )


def _findings(report: Mapping[str, Any]) -> dict[Key, dict[str, Any]]:
    """Findings of a report by cause and target, counted where one target has two; and the structure without a cause."""
    found: dict[Key, dict[str, Any]] = {}
    for finding in report["findings"]:
        where = finding["where"]
        key = (finding["cause"], *where["antennas"], *where["dipoles"])
        found[(*key, sum(other[:-1] == key for other in found))] = finding
    rest = report["unexplained"]
    if rest is not None:
        where = rest["where"]
        sentence = f"{rest['description']} ({write_chance(rest['p_value'])})"
        # where all paths show it together, the one that shows most changes from one set of events to the next
        target = "paths" if rest.get("paths") else where["target"]
        # its significance stays out of the comparison: the p-value of a simulated distribution has a floor
        found["unexplained", where["axis"], target, 0] = {"sentence": sentence, "significance_sigma": 0.0}
    return found
