"""Named causes that move C: what an investigation found, while the calibrations in effect were made without it.

The gate compares a version with the one before and with the chain test. What moves C of every year alike passes both: a
clock an hour ahead by 1 to 3 %. The investigation of a station's year names it, and the alarm says that C in effect is
off by it, until the cause is adopted or what is wrong is put right.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lbacal_core.causes.model import Model, follows_date
from lbacal_core.curves.curves import OK
from lbacal_core.curves.validity import Scope
from lbacal_core.errors import BadInputError
from service.storage.alarms import NAMED_CAUSE, News
from service.storage.database import Stores
from service.storage.investigations import Investigation
from service.storage.versions import Version
from service.usecases.years import end_of_year
from service.wire.instants import format_instant


@dataclass(frozen=True)
class _Named:
    """A finding that moves C by `moved`, whose statistical error is `error`, both fractions; and who found it."""

    made: Investigation
    number: int
    finding: Mapping[str, Any]
    moved: float
    error: float


def find_named(stores: Stores) -> Iterator[News]:
    """Find the causes that move C in effect by more than its statistical error; years of one cause are one alarm."""
    found: dict[tuple[str, str, str], list[_Named]] = {}
    for made in stores.investigations.newest_with_findings():
        model = stores.models.during(made.station, made.since, made.until)
        is_of_model = made.inputs.get("model") == (None if model.is_plain else model.id)
        if not is_of_model or made.until != end_of_year(made.since):
            continue
        for number, finding in enumerate(made.report["findings"]):
            moved, error = finding["calibration_change"]["median_fraction"], _find_error(stores, made, finding)
            if error is not None and moved > error and _can_be_adopted(model, made, number):
                key = made.station, str(finding["cause"]), str(finding["evidence"]["target"])
                found.setdefault(key, []).append(_Named(made, number, finding, moved, error))
    for (station, cause, target), years in found.items():
        yield _tell(station, f"{cause} {target}", sorted(years, key=lambda one: one.made.since))


def _find_error(stores: Stores, made: Investigation, finding: Mapping[str, Any]) -> float | None:
    """The statistical error of C in effect for what a finding is about, without the cause; None where nothing is.

    What follows the date has alarms of steps and slopes, and windows are cut there.
    """
    if follows_date(finding["cause"], finding["parameters"]):
        return None
    antennas, dipoles = finding["where"]["antennas"], finding["where"]["dipoles"]
    scope = Scope(made.station, antennas[0], dipoles[0]) if len(antennas) == 1 else Scope(made.station)
    standing = stores.ledger.decisive(scope.widening, (made.since + made.until) // 2, None)
    names = [standing[one].calibration for one in scope.widening if one in standing]
    name = next((one for one in names if one is not None), None)
    return None if name is None else _typical_error(stores.versions.get(name))


def _typical_error(version: Version) -> float | None:
    """The largest error of its curves in the median of their good channels, as a fraction of C."""
    errors = [
        float(np.median((curve.c_sigma_stat / curve.c)[curve.flags == OK]))
        for curve in version.curves
        if curve.c is not None and curve.c_sigma_stat is not None and np.any(curve.flags == OK)
    ]
    return max(errors, default=None)


def _can_be_adopted(model: Model, made: Investigation, number: int) -> bool:
    """Whether the model can have it: what is static is in C already, or belongs into the instrument file."""
    try:
        model.adopt(made.report, number, made.since // 1_000_000)
    except BadInputError:
        return False
    return True


def _tell(station: str, subject: str, years: Sequence[_Named]) -> News:
    """The alarm of a cause, in the words of the year in which it moves C by most of its errors."""
    worst = max(years, key=lambda one: one.moved / one.error)
    named = ", ".join(format_instant(one.made.since)[:4] for one in years)
    sentence = (
        f"{station} in {named}: {worst.finding['sentence']} C in effect was made without it and is off by "
        f"{worst.moved:.1%}, {worst.moved / worst.error:.1f} of its statistical errors: adopt it (investigation "
        f"{worst.made.id[:10]}, finding {worst.number}), or put right what is wrong"
    )
    content = {
        "cause": worst.finding["cause"],
        "years": [
            {
                "since": format_instant(one.made.since), "investigation": one.made.id, "finding": one.number,
                "fraction": one.moved, "statistical_error": one.error,
            }
            for one in years
        ],
    }  # fmt: skip
    return News(NAMED_CAUSE, Scope(station), subject, sentence, content, years[0].made.since)
