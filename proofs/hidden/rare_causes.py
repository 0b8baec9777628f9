"""Causes that few drawn years can show at an ideal SNR of 10: what is said where one is that strong.

Where the causes take turns (`named_in_worlds`) these come up too seldom to be told one by one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from proofs.hidden.named_in_worlds import hide, tell
from proofs.hidden.one_effect import NAMING_SNR, outcomes_of
from proofs.machinery.claims import MEASUREMENT, Claim, claim_mean, claim_rate
from proofs.machinery.parts import Part, Row

RARE = ("adc_jitter",)
RARE_FROM = 1_000_000_000
"""Seeds of data sets of this part; those of others begin elsewhere."""
FEWEST = 3


def try_rare(seed: int) -> Row:
    """A drawn world with one of these causes; they take turns."""
    return hide(RARE_FROM + seed, RARE[seed % len(RARE)], NAMING_SNR)


def judge(rows: Sequence[Row]) -> list[Claim]:
    """Names, wrong names and the score of each cause: figures without a limit."""
    claims = []
    outcomes = outcomes_of(rows)
    for cause in RARE:
        here = [o for o in outcomes if o.cause == cause]
        if len(here) < FEWEST:
            continue
        what = f"`{cause}` of ideal SNR {NAMING_SNR:g} in a drawn world"
        named, wrong = sum(o.is_named for o in here), sum(o.is_misnamed for o in here)
        kept = np.array([o.score / o.snr for o in here])
        claims += [
            claim_rate(f"{cause}_named", f"{what}: named, or in the set", MEASUREMENT, named, len(here)),
            claim_rate(f"{cause}_misnamed", f"{what}: another cause is named", MEASUREMENT, wrong, len(here)),
            claim_mean(f"{cause}_kept", f"Part of the ideal SNR that its score keeps, {what}", MEASUREMENT, kept),
        ]
    return claims


PARTS = (Part("rare", try_rare, judge, 130, tell),)
