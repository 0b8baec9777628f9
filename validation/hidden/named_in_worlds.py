"""One effect in a drawn world: whether it is named, whom it concerns, and whether another name is given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import partial

import numpy as np

from validation.hidden.data_sets import STATIC, moving_causes
from validation.hidden.drawn import describe_world, drawn_data
from validation.hidden.one_effect import NAMING_SNR, Outcome, detection_curve, hide_in, outcomes_of
from validation.machinery.claims import Found, One, rate_of
from validation.machinery.parts import Part, Row
from validation.machinery.tables import by

SNRS = (10.0, 10.0, 10.0, 10.0, 4.0, 5.0, 6.0, 7.5)
"""Ideal SNR of one data set after the other: half are as strong as names are judged at."""
ONE_FROM, TARGETS_FROM = 600_000_000, 700_000_000
"""Seeds of data sets of these parts; those of others begin elsewhere."""
TARGETS = tuple(
    (cause, scope) for scope in ("cable", "group") for cause in ("gain_step", "gain_drift", "adc_noise_step")
)
FEWEST = 20
"""Weaker data sets from which on a curve of detection is fitted: one SNR, seen almost always, tells no 50 %."""


def hide(seed: int, cause: str, snr: float, scopes: tuple[str, ...] = ()) -> Row:
    """A drawn world with an effect of an ideal SNR, and what is said of it."""
    data = drawn_data(seed)
    return {**describe_world(data), **asdict(hide_in(data, cause, snr, np.random.default_rng([1, seed]), scopes))}


def try_one(seed: int) -> Row:
    causes = [*moving_causes(), *STATIC]
    return hide(ONE_FROM + seed, causes[seed % len(causes)], SNRS[seed // len(causes) % len(SNRS)])


def try_target(seed: int) -> Row:
    """A data set in which a cable name or a group is concerned; the causes take turns."""
    cause, scope = TARGETS[seed % len(TARGETS)]
    return hide(TARGETS_FROM + seed, cause, NAMING_SNR, (scope,))


def judge_one(rows: Sequence[Row]) -> list[Found]:
    outcomes = outcomes_of(rows)
    strong = [o for o in outcomes if o.snr == NAMING_SNR]
    wanted = [row for row in rows if row["snr"] == NAMING_SNR]
    pulls = [abs(o.pull) for o in strong if o.pull is not None]
    claims = [
        *_judge_names(strong),
        rate_of("sizes", sum(pull <= 2.0 for pull in pulls), len(pulls)),
        rate_of("first", len(pulls), len(strong)),
        rate_of("alone", sum(o.sets[:1] == [[o.cause]] for o in strong), len(strong)),
        rate_of("left_out", sum(not row["label"] for row in wanted), len(wanted)),
    ]
    if len(outcomes) - len(strong) >= FEWEST:
        curve = detection_curve(outcomes)
        claims.append(One("snr_50", curve.snr_at(0.5), partial(curve.bounds, 0.5), len(outcomes)))
    return claims


def judge_targets(rows: Sequence[Row]) -> list[Found]:
    outcomes = outcomes_of(rows)
    right = sum(o.said_of == o.label for o in outcomes if o.is_named)
    return [*_judge_names(outcomes), rate_of("target", right, sum(o.is_named for o in outcomes))]


def _judge_names(outcomes: Sequence[Outcome]) -> list[Found]:
    named, wrong = sum(o.is_named for o in outcomes), sum(o.is_misnamed for o in outcomes)
    return [rate_of("named", named, len(outcomes)), rate_of("misnamed", wrong, len(outcomes))]


PARTS = (
    Part("one", try_one, judge_one, 2000, by("cause", "snr"), ("named",)),
    Part("targets", try_target, judge_targets, 200, by("cause", "scope")),
)
