"""One hidden effect: how strong it must be to be detected, whether it is named, and what each cause loses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from functools import partial

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import norm

from lbacal_core.grids import Floats
from validation.hidden.data_sets import ALIKE, SMALL, STATIC, DataSet, Planted, draw_one, is_in_family, moving_causes
from validation.hidden.detection import DetectionCurve, fit_detection
from validation.hidden.sizes import size_pull
from validation.machinery.claims import Found, Interval, One, mean_of, rate_interval, rate_of, worst_of
from validation.machinery.parts import Part, Row
from validation.machinery.tables import by

GRID = (4.0, 5.0, 5.5, 6.0, 6.75, 7.5, 10.0)
NAMING_SNR, EFFICIENCY_SNR = 10.0, 12.0
CYCLE = (*GRID, NAMING_SNR, NAMING_SNR)
"""Ideal SNR of one data set after the other: names and sizes are judged at SNR 10."""
LARGEST_SET, TRIES = 3, 10
FIRST_SEED = 100_000
"""Seeds of data sets with one effect; those of other parts begin elsewhere."""
EFFICIENCY_FROM, STATIC_FROM = 100_000_000, 200_000_000
"""What is added to the seed, so that parts share no data set."""
INSIDE, BESIDE = 0.9, 0.75
"""Fraction of the ideal SNR that is asked for where the law is in the documented family, and beside it."""
FEWEST_OF_CURVE, LARGEST_SNR = 50, 30.0
"""Data sets from which on the curve of detection has an interval of its own: fewer may separate without an overlap."""
FEWEST = 3
"""Data sets behind the mean efficiency of a cause."""


@dataclass(frozen=True)
class Outcome:
    """The result for one data set with one effect; without a label the data set cannot show the cause.

    Attributes
    ----------
    scope, label
        Whom the planted effect concerns, as a kind and in the words of a report.
    is_in_family
        Whether the planted law is one that the docs list.
    sets
        Each cause named, with those that the data cannot tell from it.
    score
        Score of the true cause for the true target.
    pull
        (Size reported - size planted) / its error, where the true cause is named first.
    said_of
        Target of the first finding.
    """

    snr: float
    cause: str
    scope: str = ""
    label: str = ""
    is_in_family: bool = True
    verdict: str = ""
    sets: Sequence[Sequence[str]] = ()
    score: float = 0.0
    pull: float | None = None
    said_of: str = ""

    @property
    def is_made(self) -> bool:
        """Whether the data set can show the cause."""
        return bool(self.label)

    @property
    def is_detected(self) -> bool:
        """Whether anything is said."""
        return self.verdict in {"explained", "unexplained"}

    @property
    def is_named(self) -> bool:
        """Whether the first finding is the true cause, or one that cannot be told from it and at most one more."""
        first = self.sets[0] if self.sets else []
        return self.cause in first[:1] or (self.cause in first and len(first) <= LARGEST_SET)

    @property
    def is_misnamed(self) -> bool:
        """Whether a finding is neither the true cause nor one that cannot be told from it."""
        return any(self.cause not in names for names in self.sets)


def hide_one(number: int, snr: float, cause: str | None = None) -> Outcome:
    """Make one data set with one effect, of a drawn cause unless it is given, and ask the finder."""
    rng = np.random.default_rng([1, number])
    drawn = str(rng.choice([*moving_causes(), *STATIC])) if cause is None else cause
    data = DataSet(FIRST_SEED + number, ALIKE if drawn in STATIC else SMALL)
    if cause is None and drawn not in STATIC:
        return ask_about(data, draw_one(data, snr, rng, moving_causes()), snr)
    return hide_in(data, drawn, snr, rng)


def hide_in(data: DataSet, cause: str, snr: float, rng: np.random.Generator, scopes: tuple[str, ...] = ()) -> Outcome:
    """Hide an effect of a cause in a data set, at the first of some draws that it can show, and ask the finder."""
    tried = (data.with_snr(data.draw(cause, rng, scopes), snr) for _ in range(TRIES))
    planted = next((sized for sized in tried if sized is not None), None)
    return Outcome(snr, cause) if planted is None else ask_about(data, planted, snr)


def ask_about(data: DataSet, planted: Planted, snr: float) -> Outcome:
    """Search a data set with an effect."""
    answer = data.ask([planted.fault])
    is_first = answer.named[:1] == [planted.cause]
    return Outcome(
        snr,
        planted.cause,
        planted.scope,
        planted.label,
        is_in_family(planted),
        answer.verdict,
        answer.sets,
        answer.score(planted.cause, planted.label),
        size_pull(data, planted, answer.findings[0]) if is_first else None,
        answer.first_target,
    )


def try_one(seed: int) -> Row:
    return asdict(hide_one(seed, CYCLE[seed % len(CYCLE)]))


def try_efficiency(seed: int) -> Row:
    """A data set with an effect of SNR 12; the causes take turns."""
    causes = moving_causes()
    return asdict(hide_one(EFFICIENCY_FROM + seed, EFFICIENCY_SNR, causes[seed % len(causes)]))


def try_static(seed: int) -> Row:
    """A data set with a static cause of one antenna; the causes take turns."""
    return asdict(hide_one(STATIC_FROM + seed, NAMING_SNR, STATIC[seed % len(STATIC)]))


def outcomes_of(rows: Sequence[Row]) -> list[Outcome]:
    """Outcomes of the data sets that can show their cause."""
    names = {field.name for field in fields(Outcome)}
    outcomes = [Outcome(**{name: value for name, value in row.items() if name in names}) for row in rows]
    return [outcome for outcome in outcomes if outcome.is_made]


def detection_curve(outcomes: Sequence[Outcome]) -> DetectionCurve:
    snr = np.array([o.snr for o in outcomes])
    return fit_detection(snr, np.array([float(o.is_detected) for o in outcomes]))


def judge_one(rows: Sequence[Row]) -> list[Found]:
    outcomes = outcomes_of(rows)
    curve = detection_curve(outcomes)

    def bounds(share: float, confidence: float) -> Interval:
        return curve.bounds(share, confidence) if len(outcomes) >= FEWEST_OF_CURVE else (0.0, LARGEST_SNR)

    at = [
        One(f"snr_{100 * share:g}", curve.snr_at(share), partial(bounds, share), len(outcomes)) for share in (0.5, 0.95)
    ]
    return [*at, *judge_names([o for o in outcomes if o.snr == NAMING_SNR])]


def judge_names(outcomes: Sequence[Outcome]) -> list[Found]:
    claims = [rate_of("named", sum(o.is_named for o in outcomes), len(outcomes))]
    for key, inside in (("", None), ("_inside", True), ("_beside", False)):
        pulls = [abs(o.pull) for o in outcomes if o.pull is not None and inside in (None, o.is_in_family)]
        if pulls or not key:
            claims.append(rate_of(f"sizes{key}", sum(pull <= 2.0 for pull in pulls), len(pulls)))
    return claims


def judge_static(rows: Sequence[Row]) -> list[Found]:
    return judge_names(outcomes_of(rows))


def ratios_of(rows: Sequence[Row]) -> dict[tuple[str, bool], Floats]:
    """Score over ideal SNR by cause and whether the law is in the documented family."""
    ratios: dict[tuple[str, bool], list[float]] = {}
    for o in outcomes_of(rows):
        ratios.setdefault((o.cause, o.is_in_family), []).append(o.score / o.snr)
    return {key: np.array(values) for key, values in sorted(ratios.items())}


def judge_efficiency(rows: Sequence[Row]) -> list[Found]:
    ratios = {key: values for key, values in ratios_of(rows).items() if values.size >= FEWEST}
    claims, details = [], []
    for is_inside, where in ((True, "inside"), (False, "beside")):
        here = {cause: values for (cause, inside), values in ratios.items() if inside == is_inside}
        if here:
            each = [mean_of(f"worst_{where}", values) for values in here.values()]
            claims.append(worst_of(each, sum(values.size for values in here.values())))
            details += [mean_of(f"{cause}_{where}", values) for cause, values in here.items()]
    return [*claims, *details]


def draw_detection(one: Sequence[Row], efficiency: Sequence[Row]) -> Figure:
    """Draw both panels from the trials of both parts."""
    outcomes, ratios = outcomes_of(one), ratios_of(efficiency)
    figure = Figure(figsize=(10, 5.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.1, 1))
    curve = detection_curve(outcomes)
    snr = np.linspace(3.5, 10.5, 200)
    chance = norm.cdf((snr - curve.draws[:, :1]) / curve.draws[:, 1:])
    left.fill_between(snr, *np.quantile(chance, [0.025, 0.975], axis=0), color="C0", alpha=0.2, label="95 % interval")
    left.plot(snr, curve.probability(snr), color="C0", label="fit")
    for point in GRID:
        here = [o.is_detected for o in outcomes if o.snr == point]
        share, (low, high) = sum(here) / max(len(here), 1), rate_interval(sum(here), len(here))
        left.errorbar(
            point, share, [[share - low], [high - share]], fmt="o", color="k", capsize=3,
            label=f"{len(outcomes)} data sets" if point == GRID[0] else None,
        )  # fmt: skip
    for asked, at in ((0.5, 5.5), (0.95, 7.5)):
        left.plot(at, asked, "x", color="C3", ms=10, mew=2, label="asked" if asked == 0.5 else None)
    left.set_xlabel("ideal signal-to-noise ratio of the planted effect")
    left.set_ylabel("probability that it is detected")
    left.legend(loc="lower right")
    causes = sorted({cause for cause, _ in ratios}, reverse=True)
    for is_inside, marker, colour, name in ((True, "o", "C0", "law in the family"), (False, "s", "C1", "beside it")):
        rows = [k for k, cause in enumerate(causes) if (cause, is_inside) in ratios]
        values = [ratios[causes[k], is_inside] for k in rows]
        error = [max(v.std(), 1 / 12) / v.size**0.5 for v in values]
        shift = 0.12 if is_inside else -0.12
        right.errorbar(
            [v.mean() for v in values], np.array(rows) + shift, xerr=error, fmt=marker, color=colour, label=name
        )
    right.axvline(INSIDE, color="C0", ls=":", lw=1)
    right.axvline(BESIDE, color="C1", ls=":", lw=1)
    right.set_yticks(range(len(causes)), causes, fontsize=8)
    right.set_xlim(0, 1.15)
    right.set_xlabel("score of the true cause / ideal signal-to-noise ratio")
    right.legend(loc="lower left")
    return figure


PARTS = (
    Part("one", try_one, judge_one, 135, by("cause"), ("named",), has_figure=True),
    Part("efficiency", try_efficiency, judge_efficiency, 276, by("cause"), ("worst_inside",), has_figure=True),
    Part("static", try_static, judge_static, 60, by("cause")),
)
