"""Effects that nobody catalogued: it should be said that something is there, along which axis, and no name forced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

from lbacal_twin.faults.uncatalogued import uncatalogued_faults
from validation.hidden.data_sets import DataSet, Planted
from validation.machinery.claims import Found, rate_of
from validation.machinery.parts import Part, Row
from validation.machinery.tables import by

SNR = 25.0
FIRST_SEED = 400_000
FIRST_SIZE = 0.02


@dataclass(frozen=True)
class Outcome:
    """What was said of one data set with an effect of no catalogue."""

    kind: str
    axes: str
    verdict: str
    axis: str
    target: str
    named: Sequence[str]

    @property
    def is_right_axis(self) -> bool:
        """Whether structure is reported along an axis on which the effect lives.

        Date and event count as one. An effect that differs from antenna to antenna has to be seen in a path.
        """
        accepted = {part.strip() for part in self.axes.split(",")}
        if accepted & {"date", "event"}:
            accepted |= {"date", "event"}
        is_right_target = "antenna" not in accepted or self.target != "station"
        return self.axis.split(",")[0] in accepted and is_right_target


def hide_unknown(task: tuple[str, int]) -> Outcome | None:
    """Make one data set with an effect of no catalogue and ask the finder."""
    axes, number = task
    kind = uncatalogued_faults()[axes]
    data = DataSet(FIRST_SEED + number)
    planted = data.with_snr(Planted(kind.__name__, kind(size=FIRST_SIZE), "station", "station"), SNR)
    if planted is None:
        return None
    answer = data.ask([planted.fault])
    return Outcome(kind.__name__, axes, answer.verdict, answer.axis, answer.target, answer.named)


def try_unknown(seed: int) -> Row:
    """A data set with an effect of no catalogue; the effects take turns."""
    kinds = list(uncatalogued_faults())
    axes = kinds[seed % len(kinds)]
    outcome = hide_unknown((axes, seed))
    if outcome is None:
        return {"kind": uncatalogued_faults()[axes].__name__, "axes": axes, "verdict": ""}
    return {**asdict(outcome), "is_right_axis": outcome.is_right_axis}


def judge(rows: Sequence[Row]) -> list[Found]:
    """Rates of what should be said, and of names that should not be given."""
    made = [row for row in rows if row["verdict"]]
    return [
        rate_of("unexplained", sum(row["verdict"] == "unexplained" for row in made), len(made)),
        rate_of("right_axis", sum(row["is_right_axis"] for row in made), len(made)),
        rate_of("forced", sum(bool(row["named"]) for row in made), len(made)),
    ]


PARTS = (Part("unknown", try_unknown, judge, 40, by("kind"), ("unexplained",)),)
