from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from validation.machinery.claims import (
    MEASURED,
    REFUTED,
    SHOWN,
    UNDECIDED,
    Asked,
    Claim,
    One,
    confidence_of_look,
    count_within,
    coverage,
    decide,
    mean_interval,
    median_interval,
    rate_interval,
    rate_of,
    read_claims,
    spread_interval,
    worst_of,
)
from validation.machinery.parts import parts_of


def at_least(low: float) -> Asked:
    return Asked("It is so", at_least=low)


def at_most(high: float) -> Asked:
    return Asked("It is so", at_most=high)


def between(low: float, high: float) -> Asked:
    return Asked("It is so", low, high)


def claim_of(figure, asked: Asked, look: int = 1) -> Claim:
    return decide([figure], {figure.key: asked}, look)[0]


@pytest.mark.parametrize(
    ("asked", "interval", "verdict"),
    [
        (at_least(0.9), (0.91, 0.99), SHOWN),
        (at_least(0.9), (0.85, 0.99), UNDECIDED),
        (at_least(0.9), (0.70, 0.89), REFUTED),
        (at_most(0.01), (0.0, 0.009), SHOWN),
        (at_most(0.01), (0.0, 0.02), UNDECIDED),
        (at_most(0.01), (0.02, 0.05), REFUTED),
        (between(-1, 1), (-0.5, 0.5), SHOWN),
        (between(-1, 1), (0.5, 1.5), UNDECIDED),
        (between(-1, 1), (-3.0, -1.5), REFUTED),
        (Asked("a measurement"), (-3.0, 100.0), MEASURED),
    ],
)
def test_the_interval_decides(asked, interval, verdict):
    assert asked.verdict(interval) == verdict


@pytest.mark.parametrize("limit", [0.9, 0.99])
def test_pooling_until_a_claim_is_decided_shows_a_rate_at_the_limit_in_two_of_a_hundred_cases_at_most(limit: float):
    """With the same 95 % interval after every block 17 % of such claims ended as shown."""
    rng, shown = np.random.default_rng(5), 0
    # the same few hits come again and again
    verdict_of = cache(lambda hits, n, look: claim_of(rate_of("r", hits, n), at_least(limit), look).verdict)
    for _ in range(600):
        hits = n = 0
        for look in range(1, 21):
            hits, n = hits + rng.binomial(130, limit), n + 130
            verdict = verdict_of(int(hits), n, look)
            if verdict != UNDECIDED:
                break
        shown += verdict == SHOWN
    assert shown <= 0.025 * 600


def test_the_chances_of_error_of_all_looks_add_up_to_five_per_cent():
    assert sum(1.0 - confidence_of_look(k) for k in range(1, 20_000)) == pytest.approx(0.05, rel=1e-3)


def test_a_rate_that_was_called_holding_below_what_was_asked_is_undecided_or_refuted():
    """Asked 0.9 and found 0.80 was recorded as "holds", because the far end of the interval reached 0.9."""
    assert claim_of(rate_of("r", 8, 10), at_least(0.9)).verdict == UNDECIDED
    assert claim_of(rate_of("r", 400, 500), at_least(0.9)).verdict == REFUTED
    assert claim_of(rate_of("r", 0, 0), at_least(0.0)).verdict == UNDECIDED


def test_fewer_trials_and_later_looks_decide_less():
    verdicts = [claim_of(rate_of("r", 0, n), at_most(0.01)).verdict for n in (40, 300, 500, 4000)]
    assert verdicts == [UNDECIDED, UNDECIDED, SHOWN, SHOWN]
    assert claim_of(rate_of("r", 0, 500), at_most(0.01), look=3).verdict == UNDECIDED


def test_a_stored_claim_is_the_same_and_its_verdict_is_decided_again():
    for asked in (replace(at_least(0.9), changed="since then"), Asked("a measurement")):
        claim = claim_of(rate_of("r", 99, 100), asked)
        stored = json.loads(json.dumps(claim.as_dict()))
        assert stored["verdict"] == claim.verdict
        assert Claim.from_dict(stored | {"verdict": REFUTED}) == claim
    assert (claim.words_asked, claim.verdict) == ("nothing", MEASURED)


def test_a_claim_without_a_finite_figure_or_a_sentence_is_refused():
    with pytest.raises(ValueError, match="must be finite"):
        Claim("r", at_least(0.0), float("nan"), (0.0, 1.0), 3)
    with pytest.raises(ValueError, match="ends before it begins"):
        Claim("r", at_least(0.0), 0.5, (1.0, 0.0), 3)
    with pytest.raises(ValueError, match=r"claims\.toml has no sentence for r: write it there"):
        decide([rate_of("r", 1, 2)], {})


def test_every_part_has_claims_and_every_claim_a_part_that_makes_its_headlines():
    claims = read_claims()
    for proof, parts in claims.items():
        assert set(parts) == set(parts_of(proof)), proof
        for name, part in parts_of(proof).items():
            assert parts[name], (proof, name)
            assert set(part.headlines) <= set(parts[name]), (proof, name)


def test_the_interval_of_a_rate_is_wilsons():
    low, high = rate_interval(0, 2000)
    # Wilson, no hits: z^2 / (n + z^2).
    assert low == pytest.approx(0.0, abs=1e-12)
    assert high == pytest.approx(1.96**2 / (2000 + 1.96**2), rel=1e-3)


@pytest.mark.parametrize("name", ["mean", "median", "spread", "rate"])
def test_intervals_hold_the_truth_in_95_percent(name: str):
    rng = np.random.default_rng(1)
    hits = 0
    for _ in range(1000):
        draws = 2.0 + rng.standard_normal(40)
        low, high, truth = {
            "mean": lambda d=draws: (*mean_interval(d), 2.0),
            "median": lambda d=draws: (*median_interval(d), 2.0),
            "spread": lambda d=draws: (*spread_interval(float(np.sqrt(np.mean((d - 2.0) ** 2))), 40), 1.0),
            "rate": lambda d=draws: (*rate_interval(int(np.sum(d > 1.0)), 40), 0.8413),
        }[name]()
        hits += low <= truth <= high
    # 1000 repetitions know 95 % to 0.7 %; a median and a rate of 40 have steps, and theirs are a little wide.
    assert 930 <= hits <= 985


def several(*figures: tuple[float, tuple[float, float]]):
    return worst_of([One("w", found, lambda _, ends=ends: ends, 10) for found, ends in figures], 10)


@pytest.mark.parametrize("asked", [at_least(0.9), between(0.9, 2.0)])
def test_a_claim_about_several_figures_is_shown_by_all_and_refuted_by_one(asked):
    good, poor, bad = (0.95, (0.93, 0.97)), (0.92, (0.88, 0.96)), (0.7, (0.6, 0.8))
    for chosen, verdict in (((good, good), SHOWN), ((good, poor), UNDECIDED), ((good, bad), REFUTED)):
        claim = claim_of(several(*chosen), asked)
        assert claim.verdict == verdict
        assert claim.found == min(found for found, _ in chosen)


def test_the_intervals_of_several_figures_hold_together():
    asked_of = []
    worst_of([One("w", 0.0, lambda c: asked_of.append(c) or (0.0, 0.0), 1)] * 5, 5).at(0.95, at_most(1.0))
    assert asked_of == pytest.approx([0.99] * 5)


def test_the_figure_that_refutes_is_told_though_a_vaguer_one_lies_farther_off():
    claim = claim_of(several((0.5, (-0.2, 1.2)), (0.3, (0.25, 0.35))), between(-0.2, 0.2))
    assert (claim.verdict, claim.found) == (REFUTED, 0.3)


WITHIN = {"c_1": Asked("68 %", 0.60, 0.76), "c_2": Asked("95 %", 0.91, 0.98)}


def test_shares_count_the_numbers_within_one_and_two_sigma() -> None:
    assert count_within("c", np.array([0.5, -1.5, 2.5, -0.1])) == {"c_1": 0.5, "c_2": 0.75}


def test_normal_pulls_are_shown_and_wide_ones_refuted() -> None:
    rng = np.random.default_rng(1)
    good = [count_within("c", rng.standard_normal(40)) for _ in range(200)]
    wide = [count_within("c", 2.0 * rng.standard_normal(40)) for _ in range(200)]
    assert [claim.verdict for claim in decide(coverage(good, "c"), WITHIN)] == [SHOWN, SHOWN]
    assert [claim.verdict for claim in decide(coverage(wide, "c"), WITHIN)] == [REFUTED, REFUTED]


def test_forty_of_forty_leave_room_for_a_few_outside() -> None:
    # the interval of a mean of 40 ones has no width, and refuted 95 %
    within_1, within_2 = decide(coverage([count_within("c", np.array([0.3])) for _ in range(40)], "c"), WITHIN)
    assert within_1.verdict == REFUTED
    assert within_2.verdict == UNDECIDED
    assert 0.89 < within_2.interval[0] < within_2.interval[1] == 1.0
