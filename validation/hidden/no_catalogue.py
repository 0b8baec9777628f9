"""Effects that nobody catalogued: it should be said that something is there, along which axis, and no name forced."""

from __future__ import annotations

from collections.abc import Sequence

from lbacal_twin.faults.uncatalogued import uncatalogued_faults
from validation.hidden.data_sets import DataSet, Planted
from validation.hidden.drawn import describe_world, drawn_data
from validation.hidden.finder import Answer
from validation.machinery.claims import Found, rate_of
from validation.machinery.parts import Part, Row
from validation.machinery.tables import by

SNR = 25.0
FIRST_SEED, FIRST_IN_WORLDS = 400_000, 800_000_000
"""Seeds of data sets of these parts; those of others begin elsewhere."""
FIRST_SIZE = 0.02


def is_right_axis(axes: str, axis: str, target: str) -> bool:
    """Whether structure is reported along an axis on which the effect lives.

    Date and event count as one. An effect that differs from antenna to antenna has to be seen in a path.
    """
    accepted = {part.strip() for part in axes.split(",")}
    if accepted & {"date", "event"}:
        accepted |= {"date", "event"}
    is_right_target = "antenna" not in accepted or target != "station"
    return axis.split(",", maxsplit=1)[0] in accepted and is_right_target


def hide_unknown(data: DataSet, axes: str) -> Row:
    """Hide an effect of no catalogue that lives along some axes, and ask; without a verdict no size has the SNR."""
    kind = uncatalogued_faults()[axes]
    planted = data.with_snr(Planted(kind.__name__, kind(size=FIRST_SIZE), "station", "station"), SNR)
    answer = Answer("", (), None, ()) if planted is None else data.ask([planted.fault])
    return {
        "kind": kind.__name__, "axes": axes, "verdict": answer.verdict, "axis": answer.axis, "target": answer.target,
        "named": answer.named, "is_right_axis": is_right_axis(axes, answer.axis, answer.target),
    }  # fmt: skip


def _axes_of(seed: int) -> str:
    """The effects take turns."""
    kinds = list(uncatalogued_faults())
    return kinds[seed % len(kinds)]


def try_unknown(seed: int) -> Row:
    return hide_unknown(DataSet(FIRST_SEED + seed), _axes_of(seed))


def try_in_world(seed: int) -> Row:
    data = drawn_data(FIRST_IN_WORLDS + seed)
    return {**describe_world(data), **hide_unknown(data, _axes_of(seed))}


def judge_in_worlds(rows: Sequence[Row]) -> list[Found]:
    made = [row for row in rows if row["verdict"]]
    right, forced = sum(row["is_right_axis"] for row in made), sum(bool(row["named"]) for row in made)
    return [rate_of("right_axis", right, len(made)), rate_of("forced", forced, len(made))]


def judge(rows: Sequence[Row]) -> list[Found]:
    made = [row for row in rows if row["verdict"]]
    unexplained = sum(row["verdict"] == "unexplained" for row in made)
    return [rate_of("unexplained", unexplained, len(made)), *judge_in_worlds(rows)]


PARTS = (Part("unknown", try_unknown, judge, 40, by("kind"), ("unexplained",)),)
PARTS_IN_WORLDS = (Part("unknown", try_in_world, judge_in_worlds, 200, by("kind")),)
