"""Effects that look like a vector of the noise, in worlds that have this noise: what is left of their scores.

The noise of an event may lie along three vectors: a gain behind everything, one in front of N_RCU, a resonance that
moves. An effect along one of them is seen only as far as it follows an axis of the data: the efficiency is the score of
the true cause over the ideal SNR, at three sizes, since a large effect must not become noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace

import numpy as np

from validation.hidden.drawn import describe_world, drawn_data
from validation.hidden.one_effect import hide_in, outcomes_of
from validation.machinery.claims import Found, mean_of
from validation.machinery.parts import Part, Row
from validation.machinery.tables import by

ALIKE = (
    ("resonance_shift", "resonance"),
    ("gain_temperature", "front"),
    ("ionospheric_absorption", "station in front"),
)
"""Causes, and the form of the noise that looks like each along frequency."""
SNRS = (10.0, 30.0, 100.0)
FEWEST = 3
FIRST_SEED = 900_000_000
"""Seeds of data sets of this part; those of others begin elsewhere."""


def try_like_noise(seed: int) -> Row:
    """A drawn world with such noise and such an effect on the station; causes and sizes take turns."""
    cause, noise = ALIKE[seed % len(ALIKE)]
    snr = SNRS[seed // len(ALIKE) % len(SNRS)]
    data = drawn_data(FIRST_SEED + seed)
    if data.world is None:
        raise ValueError(f"data set {data.seed} has no world of its own")
    data = replace(data, world=replace(data.world, noise=noise))
    return {**describe_world(data), **asdict(hide_in(data, cause, snr, np.random.default_rng([1, seed]), ("station",)))}


def judge(rows: Sequence[Row]) -> list[Found]:
    claims = []
    for snr in SNRS:
        kept = np.array([o.score / o.snr for o in outcomes_of(rows) if o.snr == snr])
        if len(kept) >= FEWEST:
            claims.append(mean_of(f"kept_{snr:g}", kept))
    return claims


PARTS = (Part("like-noise", try_like_noise, judge, 90, by("cause", "snr")),)
