from __future__ import annotations

import json

import numpy as np
import pytest

from validation.machinery.claims import (
    MEASURED,
    MEASUREMENT,
    REFUTED,
    SHOWN,
    UNDECIDED,
    Claim,
    at_least,
    at_most,
    between,
    claim_exact,
    claim_mean,
    claim_rate,
    claim_worst,
    mean_interval,
    median_interval,
    rate_interval,
    spread_interval,
)


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
        (MEASUREMENT, (-3.0, 100.0), MEASURED),
    ],
)
def test_the_interval_decides(asked, interval, verdict):
    assert asked.verdict(interval) == verdict


def test_a_rate_that_was_called_holding_below_what_was_asked_is_undecided_or_refuted():
    """Asked 0.9 and found 0.80 was recorded as "holds", because the far end of the interval reached 0.9."""
    assert claim_rate("r", "", at_least(0.9), 8, 10).verdict == UNDECIDED
    assert claim_rate("r", "", at_least(0.9), 400, 500).verdict == REFUTED


def test_fewer_trials_decide_less():
    verdicts = [claim_rate("r", "", at_most(0.01), 0, n).verdict for n in (40, 300, 400, 4000)]
    assert verdicts == [UNDECIDED, UNDECIDED, SHOWN, SHOWN]


def test_a_measurement_states_its_figure_and_asks_nothing():
    claim = Claim("size", "", MEASUREMENT, 0.007, (0.006, 0.008), 100, "%")
    assert (claim.words_asked, claim.words_found, claim.verdict) == ("nothing", "0.7 % (0.6 to 0.8)", MEASURED)
    assert Claim.from_dict(claim.as_dict()) == claim
    assert claim.seen_before().verdict == UNDECIDED


def test_data_sets_that_had_been_seen_decide_nothing():
    claim = claim_rate("r", "", at_most(0.01), 0, 4000)
    assert claim.verdict == SHOWN
    assert claim.seen_before().verdict == UNDECIDED


def test_no_trials_decide_nothing():
    assert claim_rate("r", "", at_least(0.0), 0, 0).verdict == UNDECIDED


def test_a_stored_claim_is_the_same_and_its_verdict_is_decided_again():
    claim = claim_rate("r", "Lines are found", at_least(0.9), 99, 100)
    stored = json.loads(json.dumps(claim.as_dict()))
    assert stored["verdict"] == SHOWN
    assert Claim.from_dict(stored | {"verdict": REFUTED}) == claim
    assert Claim.from_dict(stored).verdict == SHOWN


def test_a_claim_without_a_finite_figure_is_refused():
    with pytest.raises(ValueError, match="must be finite"):
        Claim("r", "", at_least(0.0), float("nan"), (0.0, 1.0), 3)
    with pytest.raises(ValueError, match="ends before it begins"):
        Claim("r", "", at_least(0.0), 0.5, (1.0, 0.0), 3)


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


@pytest.mark.parametrize("asked", [at_least(0.9), between(0.9, 2.0)])
def test_a_claim_about_several_figures_is_shown_by_all_and_refuted_by_one(asked):
    good, poor, bad = (0.95, (0.93, 0.97)), (0.92, (0.88, 0.96)), (0.7, (0.6, 0.8))
    for chosen, verdict in (((good, good), SHOWN), ((good, poor), UNDECIDED), ((good, bad), REFUTED)):
        found, intervals = zip(*chosen, strict=True)
        claim = claim_worst("w", "", asked, found, intervals, 10)
        assert claim.verdict == verdict
        assert claim.found == min(found)


def test_the_figure_that_refutes_is_told_though_a_vaguer_one_lies_farther_off():
    found, intervals = (0.5, 0.3), ((-0.2, 1.2), (0.25, 0.35))
    claim = claim_worst("w", "", between(-0.2, 0.2), found, intervals, 10)
    assert (claim.verdict, claim.found) == (REFUTED, 0.3)


def test_figures_are_told_with_their_unit_and_interval():
    claim = claim_rate("r", "", at_most(0.01), 4, 2000)
    assert (claim.words_found, claim.words_asked) == ("0.2 % (0.0778 to 0.513)", "<= 1 %")
    exact = claim_exact("e", "", between(0.95, 1.05), 1.0)
    assert (exact.words_found, exact.words_asked) == ("1", "0.95 to 1.05")
    assert claim_mean("m", "", at_least(0.0), np.array([1.0, 3.0]), "dB").words_found.startswith("2 dB (")
