import json
from dataclasses import fields
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lbacal_core.curves.covariance import (
    MOST_FACTORS,
    Budget,
    BudgetTerm,
    CurveCovariance,
    compress_covariance,
    name_budgets,
    parse_budget,
    parse_covariance,
)
from lbacal_core.curves.curves import MOST_NAMED, NONE, Anomalies, Anomaly, parse_anomalies
from lbacal_core.curves.kept_lines import KeptLines, MemberLines, read_lines, write_lines
from lbacal_core.curves.reference_chain import (
    CableTable,
    GainSpread,
    GainSpreads,
    ReferenceChain,
    parse_cable_table,
    parse_spreads,
)
from lbacal_core.curves.validity import Promotion, Scope, timeline
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.provenance import hash_content
from tests.oracles import answer_path

FREQUENCY = np.linspace(30.0, 80.0, 6)
LEVEL = BudgetTerm("level", "a paper", {"X": np.full((1, 6), 0.1), "Y": np.full((1, 6), 0.1)})
SLOPE = BudgetTerm("slope", "another", {p: np.linspace(-0.04, 0.04, 6)[None] for p in "XY"}, is_of_gain=True)
BUDGET = Budget(FREQUENCY, (LEVEL, SLOPE))


def test_independent_terms_add_in_quadrature_and_each_is_correlated_along_frequency():
    np.testing.assert_allclose(BUDGET.variance("X"), 0.01 + SLOPE.vectors["X"][0] ** 2)
    np.testing.assert_allclose(np.diag(BUDGET.covariance("X")), BUDGET.variance("X"))
    assert BUDGET.covariance("X")[0, -1] == pytest.approx(0.01 - 0.04**2)


def test_a_budget_returns_from_json_with_its_hash():
    again = parse_budget(json.loads(json.dumps(BUDGET.as_dict(), allow_nan=False)))
    assert again.digest == BUDGET.digest
    assert [term.is_of_gain for term in again.terms] == [False, True]
    assert Budget(FREQUENCY, (SLOPE,)).digest != BUDGET.digest


def test_compressing_keeps_every_variance_and_what_moves_together():
    rng = np.random.default_rng(1)
    strong = rng.normal(size=(2, 6))
    covariance = strong.T @ strong + np.diag(rng.uniform(0.001, 0.01, 6))
    factor, diagonal = compress_covariance(covariance)
    assert factor.shape == (MOST_FACTORS, 6)
    np.testing.assert_allclose(np.sum(factor**2, axis=0) + diagonal, np.diag(covariance))
    assert np.max(np.abs(factor.T @ factor + np.diag(diagonal) - covariance)) < 0.01


def test_a_channel_without_a_value_has_no_covariance():
    covariance = np.eye(4)
    covariance[2] = covariance[:, 2] = np.nan
    factor, diagonal = compress_covariance(covariance)
    assert np.isnan(factor[:, 2]).all()
    one = CurveCovariance(factor, diagonal, None, np.zeros((0, 4)))
    text = json.dumps(one.as_dict(), allow_nan=False)
    again = parse_covariance(json.loads(text))
    np.testing.assert_allclose(again.diagonal, diagonal)
    assert again.own.shape == (0, 4)


def test_a_term_of_its_own_is_added_to_a_curve():
    one = CurveCovariance(np.ones((1, 4)), np.zeros(4), "ab", np.zeros((0, 4))).with_own(np.full(4, 0.05))
    again = parse_covariance(one.as_dict())
    assert again.own.tolist() == [[0.05] * 4]
    assert name_budgets([{"covariance": one.as_dict()}, {"covariance": None}, {}]) == ["ab"]


HUGE = Anomaly("e1", "CS003", 5, "X", 947.0)
DEAD = Anomaly("e2", "CS003", 6, "Y", 1e-4, 45.0)
KEPT = Anomaly("e3", "CS003", 5, "X", 1.7, kept="it lasts for 12 events")


def test_a_summary_counts_and_names_the_worst_first():
    found = Anomalies.of([KEPT, HUGE, DEAD])
    assert (found.left_out, found.fitted) == (2, 1)
    assert found.worst == (DEAD, HUGE, KEPT)
    assert found.name_worst(2) == (
        "e2 of CS003/6/Y (power 0.0001 times the usual at 45 MHz), e1 of CS003/5/X (power 947 times the usual)"
    )
    assert KEPT.reason == "power 1.7 times the usual; fitted: it lasts for 12 events"


def test_a_summary_survives_json_and_names_a_limited_number():
    many = Anomalies.of([HUGE] * (MOST_NAMED + 7))
    assert (many.left_out, len(many.worst)) == (MOST_NAMED + 7, MOST_NAMED)
    for summary in (many, Anomalies.of([KEPT, DEAD]), NONE):
        assert parse_anomalies(json.loads(json.dumps(summary.as_dict(), allow_nan=False))) == summary


def draw(rng: np.random.Generator, members: MemberLines | None) -> KeptLines:
    root = rng.standard_normal((2, 8, 8))
    return KeptLines(
        owners=[("CS002", 3, "X"), (None, None, "X")], events=np.array([400, 12]), has_c=np.array([True, False]),
        is_good=np.array([True, False]),
        slope=rng.random((2, 4)), intercept=rng.random((2, 4)), information=root @ root.transpose(0, 2, 1),
        radiometer=rng.random((2, 4)), constant=rng.random((2, 3, 4)), behind=rng.random((2, 3, 4)),
        scatter=rng.random(2), loss=rng.random((2, 4)),
        spectra=np.array(["a" * 64, "b" * 64]), typical_blocks=100.0, variance_unit=1.5, members=members,
    )  # fmt: skip


@pytest.mark.parametrize("is_mean", [False, True])
def test_lines_are_read_as_they_were_written_but_for_the_rounding_of_the_information(is_mean):
    rng = np.random.default_rng(1)
    members = MemberLines(
        np.array(["CS002", "CS003"]), np.array([3, 4]), rng.random((2, 4)), rng.random((2, 4)), rng.random(2),
        rng.random(2),
    )  # fmt: skip
    written = draw(rng, members if is_mean else None)
    (read,) = read_lines(write_lines([written]))
    assert (read.owners, read.typical_blocks, read.variance_unit) == (written.owners, 100.0, 1.5)
    for one in fields(KeptLines):
        if one.name == "spectra":
            assert read.spectra.tolist() == written.spectra.tolist()
        elif isinstance(getattr(written, one.name), np.ndarray):
            tolerance = 1e-6 if one.name == "information" else 0
            np.testing.assert_allclose(getattr(read, one.name), getattr(written, one.name), rtol=tolerance)
    assert (read.members is None) == (not is_mean)
    if read.members is not None:
        for name, values in vars(members).items():
            np.testing.assert_array_equal(getattr(read.members, name), values)


TABLE = CableTable(
    {"50": np.array([0.5, 0.4]), "80": np.array([0.3, 0.2])},
    (AntennaRecord("CS002", 0, "50", None, 1000.0), AntennaRecord("CS002", 0, "80", 2000.0, None)),
)
ALL = GainSpread(9, np.array([0.0, 0.01]), np.array([0.04, 0.05]))
SPREADS = GainSpreads(
    {"50": GainSpread(5, np.array([0.03, 0.0]), np.array([0.04, 0.04]))}, ALL, 3, np.array([0.02, 0.03])
)


@pytest.mark.parametrize(
    ("instant", "cable"), [(-1e12, "50"), (999.0, "50"), (1000.0, None), (1999.9, None), (2000.0, "80"), (1e12, "80")]
)
def test_the_cable_is_that_of_the_instant_and_none_in_a_gap(instant, cable):
    assert TABLE.cable_of("CS002", 0, instant) == cable


def test_an_antenna_that_is_not_in_the_table_has_no_cable():
    assert TABLE.cable_of("CS002", 1, 0.0) is None


def test_tables_and_spreads_keep_their_hash_through_json():
    for value, parse in ((TABLE, parse_cable_table), (SPREADS, parse_spreads)):
        again = parse(json.loads(json.dumps(value.as_dict())))
        assert again.digest == value.digest == hash_content(value.as_dict())


def test_a_cable_that_was_not_measured_has_the_departures_of_all_paths():
    np.testing.assert_allclose(SPREADS.variance_of("50", has_station=True), SPREADS.by_cable["50"].variance)
    np.testing.assert_allclose(SPREADS.variance_of("80", has_station=True), ALL.variance)


@pytest.mark.parametrize("paths", [3, 5, 40])
def test_one_path_more_departs_as_far_as_its_error_says_however_few_were_measured(paths):
    """Of three paths the fourth was 4 sigma off in one station of four: their spread was believed."""
    drawn = 0.05 * np.random.default_rng(paths).standard_normal((paths + 1, 20_000))
    known, other = drawn[:-1], drawn[-1]
    sigma = GainSpread(paths, np.zeros(20_000), known.std(axis=0, ddof=1)).variance ** 0.5
    assert np.mean(np.abs(other - known.mean(axis=0)) < sigma) == pytest.approx(0.683, abs=0.01)


def test_another_station_departs_further_and_from_one_station_nobody_knows_how_far():
    near, far = SPREADS.variance_of("80", has_station=True), SPREADS.variance_of("80", has_station=False)
    np.testing.assert_allclose(far - near, 2 / 3 * SPREADS.between_stations**2)
    assert GainSpreads({}, ALL, 1, None).variance_of("80", has_station=False) is None


def test_jensens_term_is_three_eighths_of_the_variance_of_power_gains():
    chain = ReferenceChain((("CS002", 0),), TABLE.cables["50"], TABLE, SPREADS)
    np.testing.assert_allclose(chain.jensen, 3 / 8 * ALL.spread**2)
    gains = 1 + 0.05 * np.random.default_rng(1).standard_normal(1_000_000)
    assert np.mean(gains**-0.5) / np.mean(gains) ** -0.5 - 1 == pytest.approx(3 / 8 * 0.05**2, rel=0.1)


PATH = Scope("CS001", 0, "X")
SCOPES = (PATH, Scope("CS001"), Scope(), Scope("CS001", 0, "Y"), Scope("CS002"))


@st.composite
def ledgers(draw: st.DrawFn) -> list[Promotion]:
    lines = draw(
        st.lists(
            st.tuples(
                st.sampled_from(SCOPES), st.integers(0, 9), st.one_of(st.none(), st.integers(1, 9)),
                st.sampled_from([None, "a", "b", "c"]), st.integers(0, 6),
            ),
            max_size=12,
        )
    )  # fmt: skip
    return [
        Promotion(k, scope, start, None if length is None else start + length, version, at)
        for k, (scope, start, length, version, at) in enumerate(lines)
    ]


@given(ledgers(), st.integers(-1, 20))
def test_the_timeline_agrees_with_asking_at_each_instant(ledger, instant):
    stretches = timeline(ledger, PATH)
    assert stretches[0].start is None
    assert stretches[-1].end is None
    assert all(a.end == b.start and a.promotion != b.promotion for a, b in pairwise(stretches))
    holding = [s for s in stretches if (s.start is None or s.start <= instant) and (s.end is None or instant < s.end)]
    assert len(holding) == 1
    assert holding[0].promotion == answer_path(ledger, PATH, instant)


def test_the_narrowest_scope_with_a_version_answers():
    ledger = [
        Promotion(1, Scope(), 0, None, "array", 1),
        Promotion(2, Scope("CS001"), 10, 20, "station", 2),
        Promotion(3, PATH, 12, 14, "path", 3),
        Promotion(4, PATH, 13, 14, None, 4),
    ]
    answers = [answer_path(ledger, PATH, t) for t in (-1, 0, 10, 12, 13, 14, 20)]
    assert [a and a.calibration for a in answers] == [None, "array", "station", "path", "station", "station", "array"]


@pytest.mark.parametrize("parts", [(None, 1, "X"), ("CS001", 1, None), ("CS001", None, "X"), ("CS001", 1, "?")])
def test_a_scope_is_the_array_a_station_or_one_path(parts):
    with pytest.raises(BadInputError):
        Scope(*parts)


def test_an_interval_of_validity_is_not_empty():
    with pytest.raises(BadInputError, match="valid_to"):
        Promotion(1, Scope(), 5, 5, "a", 1)
