"""Effects that nobody catalogued: it should be said that something is there, along which axis, and no name forced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lbacal_core.twin.faults.uncatalogued import uncatalogued_faults
from proofs.hidden.data_sets import DataSet, Planted
from proofs.machinery.trials import Rate, run_trials

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


def prove_unknown(each: int) -> tuple[bool, list[str]]:
    """`each` data sets of every effect in no catalogue."""
    kinds = list(uncatalogued_faults())
    tasks = [(axes, 1000 * i + k) for i, axes in enumerate(kinds) for k in range(each)]
    outcomes = [o for o in run_trials(hide_unknown, tasks, "not catalogued") if o is not None]
    unexplained = Rate(sum(o.verdict == "unexplained" for o in outcomes), len(outcomes))
    right = Rate(sum(o.is_right_axis for o in outcomes), len(outcomes))
    forced = Rate(sum(bool(o.named) for o in outcomes), len(outcomes))
    summary = (
        f"**Not catalogued**, SNR {SNR:g}: unexplained in {unexplained}, asked 90 %; right axis in {right}, asked "
        f"90 %; a name forced in {forced}, asked < 10 %."
    )
    lines = [
        "",
        summary,
        "",
        "| effect | lives along | data sets | unexplained | right axis | axes said | name forced |",
        "|" + "---|" * 7,
    ]
    for axes in kinds:
        here = [o for o in outcomes if o.axes == axes]
        if not here:
            lines.append(f"| {uncatalogued_faults()[axes].__name__} | {axes} | 0 | | | not to be shown | |")
            continue
        said = ", ".join(sorted({o.axis for o in here if o.axis}))
        names = ", ".join(sorted({name for o in here for name in o.named}))
        forced_here = sum(bool(o.named) for o in here)
        lines.append(
            f"| {here[0].kind} | {axes} | {len(here)} | {sum(o.verdict == 'unexplained' for o in here)} | "
            f"{sum(o.is_right_axis for o in here)} | {said} | {forced_here}{f': {names}' if names else ''} |"
        )
    return unexplained.is_at_least(0.9) and right.is_at_least(0.9) and forced.is_at_most(0.1), lines
