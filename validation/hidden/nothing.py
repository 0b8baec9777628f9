"""Nothing hidden in a drawn world: a name is never right, and silence is where the models span the difference.

Where the resonance moves in rain, a resonance that is named as following rain says what the world does
(`docs/decisions/rain-that-moves-the-resonance.md`). It counts as a name all the same; rows of their own tell it apart.
"""

from __future__ import annotations

from collections.abc import Sequence

from validation.hidden.drawn import SPANNED_SIGMA, describe_world, drawn_data, unspanned_sigma
from validation.machinery.claims import Found, rate_of
from validation.machinery.parts import Part, Row
from validation.machinery.tables import by

WET, RESONANCE, RAIN = "wetness", ("resonance_shift", "resonance_width"), "wetness"
"""Form of the gains in which the resonance moves in rain, the causes that say so, and what they then follow."""
FIRST_SEED = 500_000_000
"""Seeds of data sets of this part; those of other parts begin elsewhere."""


def listen(seed: int) -> Row:
    data = drawn_data(FIRST_SEED + seed)
    answer = data.ask()
    return {
        **describe_world(data),
        "unspanned": round(unspanned_sigma(data), 3),
        "verdict": answer.verdict,
        "named": answer.named,
        "axis": answer.axis,
        "follows": [str(finding["parameters"].get("follows", "")) for finding in answer.findings],
    }


def is_spanned(row: Row) -> bool:
    """Whether the models that the finder knows span the difference between its sky and the true one."""
    return bool(row["unspanned"] < SPANNED_SIGMA)


def is_of_rain(row: Row) -> bool:
    """Whether every name is that of a resonance which follows rain, in a world where it moves in rain."""
    told = zip(row["named"], row["follows"], strict=True)
    return row["noise"] == WET and bool(row["named"]) and all(c in RESONANCE and f == RAIN for c, f in told)


def is_silent(row: Row) -> bool:
    return bool(row["verdict"] == "consistent")


def judge(rows: Sequence[Row]) -> list[Found]:
    inside, outside = [r for r in rows if is_spanned(r)], [r for r in rows if not is_spanned(r)]
    honest = sum(is_silent(row) or (not row["named"] and row["axis"] == "lst") for row in outside)
    dry, wet = [r for r in rows if r["noise"] != WET], [r for r in rows if r["noise"] == WET]
    claims = [
        rate_of("named", sum(bool(row["named"]) for row in rows), len(rows)),
        rate_of("alarms", sum(not is_silent(row) for row in inside), len(inside)),
        rate_of("apart", len(outside) - honest, len(outside)),
    ]
    if dry:
        claims.append(rate_of("named_dry", sum(bool(row["named"]) for row in dry), len(dry)))
    if wet:
        claims.append(rate_of("named_wet", sum(bool(row["named"]) and not is_of_rain(row) for row in wet), len(wet)))
    return claims


PARTS = (Part("nothing", listen, judge, 3000, by("noise", "outside"), ("named",)),)
