"""The figure of the proof of discovery: detection against the ideal SNR, and what each cause keeps of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import norm

from validation.hidden.one_effect import BESIDE, GRID, INSIDE, detection_curve, outcomes_of, ratios_of
from validation.machinery.claims import rate_interval
from validation.machinery.parts import Row


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
