"""Effects of no catalogue in drawn worlds: the right axis, and no name beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from lbacal_twin.faults.uncatalogued import uncatalogued_faults
from validation.hidden.data_sets import Planted
from validation.hidden.drawn import describe_world, drawn_data
from validation.hidden.no_catalogue import FIRST_SIZE, SNR, Outcome, tell
from validation.hidden.worlds import OWN, Finder
from validation.machinery.claims import Claim, at_least, at_most, claim_rate
from validation.machinery.parts import Part, Row

RIGHT_AXIS, FORCED = 0.9, 0.02
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


def judge(rows: Sequence[Row]) -> list[Claim]:
    """Rates of the right axis, and of names that should not be given."""
    made = [row for row in rows if row["verdict"]]
    what = f"An effect of no catalogue in a drawn world, ideal SNR {SNR:g}"
    right, forced = sum(row["is_right_axis"] for row in made), sum(bool(row["named"]) for row in made)
    return [
        claim_rate(
            "right_axis", f"{what}, is seen along an axis on which it lives", at_least(RIGHT_AXIS), right, len(made)
        ),
        claim_rate("forced", f"{what}, is given a name", at_most(FORCED), forced, len(made)),
    ]


PARTS = (Part("unknown", try_unknown, judge, 200, tell),)
