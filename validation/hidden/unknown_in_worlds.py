"""Effects of no catalogue in drawn worlds: the right axis, and no name beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from lbacal_twin.faults.uncatalogued import uncatalogued_faults
from validation.hidden.data_sets import Planted
from validation.hidden.drawn import describe_world, drawn_data
from validation.hidden.no_catalogue import FIRST_SIZE, SNR, Outcome
from validation.hidden.worlds import OWN, Finder
from validation.machinery.claims import Found, rate_of
from validation.machinery.parts import Part, Row
from validation.machinery.tables import by

FIRST_SEED = 800_000_000
"""Seeds of data sets of this part; those of others begin elsewhere."""


def try_unknown(seed: int, finder: Finder = OWN) -> Row:
    """A drawn world with an effect of no catalogue; the effects take turns."""
    kinds = list(uncatalogued_faults())
    axes = kinds[seed % len(kinds)]
    kind = uncatalogued_faults()[axes]
    data = drawn_data(FIRST_SEED + seed, finder)
    world = describe_world(data)
    planted = data.with_snr(Planted(kind.__name__, kind(size=FIRST_SIZE), "station", "station"), SNR)
    if planted is None:
        return {**world, "kind": kind.__name__, "axes": axes, "verdict": ""}
    answer = data.ask([planted.fault])
    outcome = Outcome(kind.__name__, axes, answer.verdict, answer.axis, answer.target, answer.named)
    return {**world, **asdict(outcome), "is_right_axis": outcome.is_right_axis}


def judge(rows: Sequence[Row]) -> list[Found]:
    """Rates of the right axis, and of names that should not be given."""
    made = [row for row in rows if row["verdict"]]
    right, forced = sum(row["is_right_axis"] for row in made), sum(bool(row["named"]) for row in made)
    return [rate_of("right_axis", right, len(made)), rate_of("forced", forced, len(made))]


PARTS = (Part("unknown", try_unknown, judge, 200, by("kind")),)
