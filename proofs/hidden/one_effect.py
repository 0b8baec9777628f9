"""One hidden effect: how strong it must be to be detected, whether it is named, and what each cause loses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from proofs.hidden.data_sets import ALIKE, SMALL, STATIC, DataSet, Planted, draw_one, is_in_family, moving_causes
from proofs.hidden.sizes import size_pull
from proofs.machinery.trials import DetectionCurve, Rate, fit_detection, run_trials

GRID = (4.0, 5.0, 5.5, 6.0, 6.75, 7.5, 10.0)
NAMING_SNR, EFFICIENCY_SNR = 10.0, 12.0
LARGEST_SET = 3
FIRST_SEED = 100_000
"""Seeds of data sets with one effect; those of other parts begin elsewhere."""
INSIDE, BESIDE = 0.9, 0.75
"""Fraction of the ideal SNR that is asked for where the law is in the documented family, and beside it."""


@dataclass(frozen=True)
class Wanted:
    """One data set to be made: its number, the ideal SNR, and the cause, drawn if None."""

    number: int
    snr: float
    cause: str | None = None


@dataclass(frozen=True)
class Outcome:
    """What came of one data set with one effect; without `planted` the data set cannot show the cause."""

    snr: float
    cause: str
    planted: Planted | None
    verdict: str = ""
    sets: Sequence[Sequence[str]] = ()
    score: float = 0.0
    pull: float | None = None
    """(Size reported - size planted) / its error, where the true cause is named first."""

    @property
    def is_detected(self) -> bool:
        """Whether anything is said."""
        return self.verdict in {"explained", "unexplained"}

    @property
    def is_named(self) -> bool:
        """Whether the first finding is the true cause, or one that cannot be told from it and at most one more."""
        first = self.sets[0] if self.sets else []
        return self.cause in first[:1] or (self.cause in first and len(first) <= LARGEST_SET)


def hide_one(wanted: Wanted) -> Outcome:
    """Make one data set with one effect and ask the finder."""
    rng = np.random.default_rng([1, wanted.number])
    drawn = str(rng.choice([*moving_causes(), *STATIC])) if wanted.cause is None else wanted.cause
    data = DataSet(FIRST_SEED + wanted.number, ALIKE if drawn in STATIC else SMALL)
    if wanted.cause is None and drawn not in STATIC:
        planted: Planted | None = draw_one(data, wanted.snr, rng, moving_causes())
    else:
        planted = next((sized for _ in range(10) if (sized := data.with_snr(data.draw(drawn, rng), wanted.snr))), None)
    if planted is None:
        return Outcome(wanted.snr, drawn, None)
    answer = data.ask([planted.fault])
    is_first = answer.named[:1] == [planted.cause]
    pull = size_pull(data, planted, answer.findings[0]) if is_first else None
    return Outcome(
        wanted.snr,
        planted.cause,
        planted,
        answer.verdict,
        answer.sets,
        answer.score(planted.cause, planted.label),
        pull,
    )


def prove_detection(each: int) -> tuple[bool, list[str], list[Outcome]]:
    """The curve of detection against the ideal SNR, and names and sizes at SNR 10, of causes drawn at random.

    Parameters
    ----------
    each
        Data sets at each SNR of the grid; three times as many at SNR 10.
    """
    strengths = [snr for snr in GRID for _ in range(3 * each if snr == NAMING_SNR else each)]
    wanted = [Wanted(number, snr) for number, snr in enumerate(strengths)]
    outcomes = [o for o in run_trials(hide_one, wanted, "one effect") if o.planted]
    curve = detection_curve(outcomes)
    at_50, at_95 = curve.snr_at(0.5), curve.snr_at(0.95)
    holds = [at_50[1] <= 5.5, at_95[1] <= 7.5]
    lines = [
        "",
        f"**One effect** of a cause drawn among those that the data can show ({len(outcomes)} data sets).",
        "",
        "| ideal SNR | detected |",
        "|---|---|",
    ]
    for snr in GRID:
        here = [o.is_detected for o in outcomes if o.snr == snr]
        lines.append(f"| {snr:g} | {Rate(sum(here), len(here))} |")
    half = f"Detected in 50 % at SNR {at_50[0]:.2f} ({at_50[1]:.2f}-{at_50[2]:.2f}), asked 5.5"
    lines += ["", f"{half}; in 95 % at {at_95[0]:.2f} ({at_95[1]:.2f}-{at_95[2]:.2f}), asked 7.5."]
    named_holds, named_lines = _names([o for o in outcomes if o.snr == NAMING_SNR])
    return all(holds) and named_holds, lines + named_lines, outcomes


def detection_curve(outcomes: Sequence[Outcome]) -> DetectionCurve:
    """The fitted curve of detection."""
    snr = np.array([o.snr for o in outcomes])
    return fit_detection(snr, np.array([float(o.is_detected) for o in outcomes]))


def _names(outcomes: Sequence[Outcome]) -> tuple[bool, list[str]]:
    named = Rate(sum(o.is_named for o in outcomes), len(outcomes))
    place = f"the true cause is the one named, or in its set of at most {LARGEST_SET}"
    lines = ["", f"At SNR {NAMING_SNR:g} {place}, in {named}; asked 95 %."]
    holds = named.is_at_least(0.95)
    for what, is_inside in (("in the documented family", True), ("beside it", False)):
        here = [o for o in outcomes if o.planted and is_in_family(o.planted) == is_inside]
        pulls = [abs(o.pull) for o in here if o.pull is not None]
        named_here = Rate(sum(o.is_named for o in here), len(here))
        close = Rate(sum(pull <= 2.0 for pull in pulls), len(pulls))
        lines.append(f"Law {what}: named in {named_here}; size within 2 sigma in {close} of those named first.")
    pulls = [abs(o.pull) for o in outcomes if o.pull is not None]
    close = Rate(sum(pull <= 2.0 for pull in pulls), len(pulls))
    lines += [f"Size within 2 sigma in {close}; asked 90 %.", "", *_confusion(outcomes)]
    return holds and close.is_at_least(0.9), lines


def _confusion(outcomes: Sequence[Outcome]) -> list[str]:
    lines = [
        "| planted | data sets | named | size within 2 sigma | what was said where it was not named |",
        "|" + "---|" * 5,
    ]
    for cause in sorted({o.cause for o in outcomes}):
        here = [o for o in outcomes if o.cause == cause]
        pulls = [abs(o.pull) for o in here if o.pull is not None]
        said = Counter(_saying(o) for o in here if not o.is_named)
        others = "; ".join(f"{count} x {what}" if count > 1 else what for what, count in said.most_common())
        close = f"{sum(pull <= 2 for pull in pulls)} of {len(pulls)}"
        lines.append(f"| {cause} | {len(here)} | {sum(o.is_named for o in here)} | {close} | {others} |")
    return lines


def _saying(outcome: Outcome) -> str:
    if outcome.sets:
        return f"{outcome.verdict}: {' or '.join(outcome.sets[0])}"
    return outcome.verdict


def prove_static(each: int) -> tuple[bool, list[str]]:
    """Names and sizes of static causes at SNR 10, `each` data sets of either."""
    wanted = [Wanted(20_000 + 1000 * i + k, NAMING_SNR, cause) for i, cause in enumerate(STATIC) for k in range(each)]
    holds, lines = _names([o for o in run_trials(hide_one, wanted, "static") if o.planted])
    return holds, ["", "**Static causes** of one antenna, compared with the others of its cable.", *lines]


def prove_efficiency(each: int, only: str | None = None) -> tuple[bool, list[str], dict[tuple[str, bool], list[float]]]:
    """The score of the true cause and target over the ideal SNR, cause by cause, or of one cause alone.

    Returns
    -------
    Whether it holds, the table, and the single ratios by cause and whether the law is in the family.
    """
    causes = moving_causes()
    wanted = [
        Wanted(10_000 + 1000 * i + k, EFFICIENCY_SNR, cause)
        for i, cause in enumerate(causes)
        for k in range(each)
        if only in (None, cause)
    ]
    outcomes = run_trials(hide_one, wanted, "efficiency")
    ratios: dict[tuple[str, bool], list[float]] = {}
    for o in outcomes:
        if o.planted is not None:
            ratios.setdefault((o.cause, is_in_family(o.planted)), []).append(o.score / EFFICIENCY_SNR)
    ratio = f"score of the true cause for the true target over the ideal SNR ({EFFICIENCY_SNR:g}), mean +- its error"
    lines = [
        "",
        f"**Efficiency**: {ratio}. Asked: {INSIDE:g} where the law is in the documented family, {BESIDE:g} beside it.",
        "",
        "| cause | in the family | data sets | beside it | data sets |",
        "|---|---|---|---|---|",
    ]
    holds = True
    for cause in causes if only is None else [only]:
        cells = []
        for is_inside, asked in ((True, INSIDE), (False, BESIDE)):
            values = np.array(ratios.get((cause, is_inside), []))
            if not values.size:
                cells.append("- | 0")
                continue
            error = max(float(values.std(ddof=1)) if values.size > 1 else 0.0, 1 / EFFICIENCY_SNR) / values.size**0.5
            is_good = values.mean() + 2 * error >= asked
            holds &= bool(is_good)
            cells.append(f"{values.mean():.2f} +- {error:.2f}{'' if is_good else ' (!)'} | {values.size}")
        lines.append(f"| {cause} | {' | '.join(cells)} |")
    lines += _by_scope(outcomes)
    absent = [o.cause for o in outcomes if o.planted is None]
    if absent:
        lines += ["", f"Not to be shown at SNR {EFFICIENCY_SNR:g} by these data: {_counted(absent)}."]
    return holds, lines, ratios


def _by_scope(outcomes: Sequence[Outcome]) -> list[str]:
    """The same by whom an effect concerns."""
    ratios: dict[str, list[float]] = {}
    for o in outcomes:
        if o.planted is not None:
            ratios.setdefault(o.planted.scope, []).append(o.score / o.snr)
    means = [f"{scope} {np.mean(values):.2f} ({len(values)})" for scope, values in sorted(ratios.items())]
    return ["", f"By whom it concerns, mean (data sets): {', '.join(means)}."]


def _counted(names: Sequence[str]) -> str:
    return ", ".join(f"{name} ({count} of the draws)" for name, count in Counter(names).most_common())
