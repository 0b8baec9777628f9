from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lbacal_core.data.lofar import DIPOLES
from lbacal_core.lstcurve.curve import (
    AS_RECORDED,
    BAND_MHZ,
    band_weights,
    in_db,
    published_noise_share,
    simulate_band_power,
)
from lbacal_core.sky.names import load_sky
from lbacal_paper.budget import Budget
from lbacal_paper.results import (
    crossings,
    edge_of_pass_band,
    find_about_calibration,
    find_about_chain,
    find_about_showers,
    find_about_sky,
    find_noise_share,
    find_peak,
    isotropic_temperature,
    mean_temperature,
    smooth_swing,
)
from lbacal_paper.shower_study import ShowerStudy
from lbacal_paper.statements import (
    AGREE,
    BY_CONSTRUCTION,
    DISAGREE,
    UNDECIDED,
    UNTESTED,
    Result,
    Statement,
    describe_verdicts,
    judge,
    load_statements,
    make_claims,
    not_testable,
    round_to_error,
)
from lbacal_paper.study import Study

NEAR = (("equal", 10.0), ("at most", 9.0), ("at least", 11.0))


def statement(relation: str = "equal", precision: float = 1.0) -> Statement:
    return Statement("s", "1", "text", 10.0, "%", precision, relation)


@pytest.mark.parametrize(
    ("relation", "ours", "sigma", "verdict"),
    [
        ("equal", 12.0, 0.0, AGREE),
        ("equal", 12.5, 0.0, DISAGREE),
        ("equal", 7.5, 0.0, DISAGREE),
        ("at most", 1.0, 0.0, AGREE),
        ("at most", 12.5, 0.0, DISAGREE),
        ("at least", 30.0, 0.0, AGREE),
        ("at least", 7.5, 0.0, DISAGREE),
        # our error counts with the precision of the statement
        ("equal", 14.0, 0.0, DISAGREE),
        ("equal", 14.0, 2.0, UNDECIDED),
        # an error above the precision of the statement is no agreement: 0.0 +- 3.5 agreed with slopes equal to 0.2
        *((relation, ours, 0.9, AGREE) for relation, ours in NEAR),
        *((relation, ours, 1.1, UNDECIDED) for relation, ours in NEAR),
        # a limit that is kept by two of our errors is kept
        ("at most", 4.0, 3.0, AGREE),
        ("at least", 16.0, 3.0, AGREE),
    ],
)
def test_a_verdict_follows_the_relation_and_two_standard_deviations(
    relation: str, ours: float, sigma: float, verdict: str
) -> None:
    assert judge(statement(relation), Result(ours, sigma, "")) == verdict


def test_what_follows_by_construction_is_called_that_and_not_counted() -> None:
    result = Result(10.0, 0.0, "", is_constructed=True)
    assert judge(statement(), result) == BY_CONSTRUCTION
    (claim,) = make_claims([statement()], {"s": result})
    assert describe_verdicts([claim, claim | {"verdict": AGREE}]) == (
        "1 of 2 statements judged: 1 agree; not judged: 1 by construction"
    )


def test_what_cannot_be_tested_is_no_agreement() -> None:
    assert judge(statement(), not_testable("needs spectra")) == UNTESTED


def test_a_result_that_is_not_a_number_is_refused() -> None:
    with pytest.raises(ValueError, match="nan"):
        judge(statement(), Result(np.nan, 0.0, ""))


def test_every_statement_needs_a_result_and_every_result_a_statement() -> None:
    with pytest.raises(ValueError, match="'s'"):
        make_claims([statement()], {})
    with pytest.raises(ValueError, match="'t'"):
        make_claims([statement()], {"s": not_testable(""), "t": not_testable("")})


def test_a_number_is_rounded_to_two_digits_of_its_error() -> None:
    assert round_to_error(Result(12.3456, 0.123, "")) == 12.35
    assert round_to_error(Result(12.3456, 0.0, "")) == 12.35
    assert round_to_error(Result(1234.0, 56.0, "")) == 1234.0


def test_the_published_noise_share_is_that_of_the_published_terms() -> None:
    published = {one.identifier: one for one in load_statements()}["noise-share"]
    assert published.value == pytest.approx(published_noise_share(BAND_MHZ), abs=0.0005)


@pytest.fixture(scope="module")
def results(study: Study, budget: Budget) -> dict[str, Result]:
    return find_about_calibration(study, budget, None)


def test_table_1_follows_for_the_sky_and_in_total(results: dict[str, Result]) -> None:
    statements = {one.identifier: one for one in load_statements()}
    for name in ("sky-quadrature", "table-sky", "table-total"):
        assert judge(statements[name], results[name]) == BY_CONSTRUCTION
        assert judge(statements[name], replace(results[name], is_constructed=False)) == AGREE


def test_what_the_weights_or_the_edge_decide_is_undecided(results: dict[str, Result]) -> None:
    statements = {one.identifier: one for one in load_statements()}
    for name in ("table-antenna", "pattern-limit"):
        assert judge(statements[name], results[name]) == UNDECIDED
    assert "% with weights without event gain" in results["table-antenna"].how


def test_the_limit_of_the_pattern_contains_no_change_or_its_neighbourhood(results: dict[str, Result]) -> None:
    limit = results["pattern-limit"].ours
    assert limit is not None
    assert 2.0 < limit < 15.0


def test_the_spread_of_gain_tables_is_measured(study: Study, budget: Budget, tmp_path: Path) -> None:
    (tmp_path / "caltables").mkdir()
    rng = np.random.default_rng(1)
    for station in (2, 3):
        gains = np.exp(rng.normal(0, 0.05, 96))[None, :] * np.ones((512, 1)) + 0j
        (tmp_path / f"caltables/CalTable_00{station}_mode1.dat").write_bytes(gains.astype("<c16").tobytes())
    found = find_about_calibration(study, budget, tmp_path)["table-electronics"]
    assert found.ours == pytest.approx(5.0, abs=1.2)


@pytest.mark.shared
def test_the_measured_gain_tables_agree_with_the_paper(study: Study, budget: Budget, shared: Path) -> None:
    found = find_about_calibration(study, budget, shared / "data")["table-electronics"]
    assert found.ours is not None
    assert 2.0 < found.ours < 6.5


FREQUENCY = np.arange(30.0, 81.0)


def test_the_edge_of_a_pass_band_is_found_between_channels() -> None:
    level_db = np.where(FREQUENCY < 70, 0.0, -(FREQUENCY - 70.0) * 2.0)
    assert edge_of_pass_band(FREQUENCY, 10 ** (level_db / 10)) == pytest.approx(71.5)


def test_a_peak_between_channels_is_found() -> None:
    gain = np.exp(-(((FREQUENCY - 58.3) / 4.0) ** 2))
    assert find_peak(FREQUENCY, gain) == pytest.approx(58.3)


def test_a_misplaced_resonance_is_recognised_as_a_shift(study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    # the published C that a resonance 1 MHz too low would have made
    instrument = study.instrument
    shifted = np.exp(np.interp(FREQUENCY - 1.0, FREQUENCY, np.log(instrument.antenna_gain)))
    loss = np.mean([instrument.cables[record.cable] for record in instrument.antennas], axis=0)
    c = (shifted / instrument.antenna_gain * loss * instrument.receiver_gain) ** -0.5
    monkeypatch.setattr(Study, "published_c", lambda _: c)
    result = find_about_chain(study)["feature-at-58"]
    assert result.ours is not None
    assert result.ours > 0.9
    assert "+1.0 MHz" in result.how


def test_a_c_that_follows_the_cable_alone_is_explained_by_it(study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    loss = np.mean([study.instrument.cables[record.cable] for record in study.instrument.antennas], axis=0)
    monkeypatch.setattr(Study, "published_c", lambda _: loss**-0.5)
    assert find_about_chain(study)["rise-by-cable"].ours == pytest.approx(1.0)


def test_the_events_behind_a_bin_scale_with_the_antennas(study: Study) -> None:
    few = replace(study.instrument, antennas=study.instrument.antennas[:144])
    half = replace(study, simulation=replace(study.simulation, instrument=few))
    assert find_about_chain(half)["samples-per-bin"].ours == pytest.approx(7250 * 96 / 144)


def test_crossings_of_a_ratio_are_interpolated() -> None:
    ratio = np.exp(1.0 - ((FREQUENCY - 55.0) / 12.0) ** 2)
    low, high = crossings(FREQUENCY, ratio)
    assert (low, high) == pytest.approx((43.0, 67.0), abs=0.05)


def test_a_noise_share_that_was_put_in_is_found_within_its_error(study: Study) -> None:
    weights = band_weights(study.instrument, AS_RECORDED, BAND_MHZ)
    rng = np.random.default_rng(5)
    planted = {
        dipole: in_db(simulate_band_power(study.sky_power, dipole, study.curve.lst_hours, weights), 0.4)
        + rng.normal(0, 0.05, study.curve.lst_hours.size)
        for dipole in DIPOLES
    }
    error_db = np.full(study.curve.lst_hours.size, 0.05)
    curve = replace(study.curve, variation_db=planted, error_db=error_db)
    share, sigma = find_noise_share(study, curve, is_exchanged=False)
    assert share == pytest.approx(0.4, abs=0.03)
    assert 0.01 < sigma < 0.3


def test_one_question_has_one_noise_share(study: Study) -> None:
    """0.17 +- 0.12 stood here, and n = 0.42 +- 0.09 (a share of 0.30) on the page of the measured curve."""
    free, sigma = find_noise_share(study, study.curve, is_exchanged=True)
    informed, _ = find_noise_share(study, study.curve, is_exchanged=True, is_published_known=True)
    assert informed / (1 - informed) == pytest.approx(0.42, abs=0.005)
    assert abs(free - informed) < sigma


def test_the_swing_of_a_sine_is_twice_its_amplitude(study: Study) -> None:
    wave = 0.7 * np.sin(2 * np.pi * study.curve.lst_hours / 24.0)
    curve = replace(study.curve, variation_db={"X": wave, "Y": wave})
    assert smooth_swing(curve, "X") == pytest.approx(1.4, abs=0.002)


def test_the_choice_of_the_sky_cannot_be_tested_without_lfmap_and_the_models_at_hand_are_told() -> None:
    sky = load_sky("gsm")
    found = find_about_sky([sky, sky.changed(scale=1.1)], FREQUENCY)["sky-models"]
    assert found.ours is None
    assert "needs LFmap" in found.how
    assert "+10.0 %" in found.how  # the map holds the CMB, which is scaled with it
    assert find_about_sky([sky], FREQUENCY)["sky-models"].ours is None


def test_the_isotropic_share_is_that_of_the_formula_in_the_paper() -> None:
    sky = load_sky("gsm")
    share = 100 * isotropic_temperature(FREQUENCY) / mean_temperature(sky, FREQUENCY)
    assert isotropic_temperature(np.array([150.0])) == pytest.approx(50.0)
    assert find_about_sky([sky], FREQUENCY)["isotropic-share"].ours == pytest.approx(share.max())


def test_results_on_showers_name_what_is_missing(showers: ShowerStudy) -> None:
    found = find_about_showers(showers)
    for name in ("source-off-diagonal", "source-ratio", "source-difference"):
        assert found[name].ours is None
        assert "VSQ 1000" in found[name].how
    assert "nuradiomc" in found["coreas-straight"].how
    statements = {one.identifier: one for one in load_statements()}
    expected = {
        "background-subtraction": BY_CONSTRUCTION, "galaxy-on-diagonal": UNDECIDED, "source-far-field": AGREE,
        "signals-per-event": BY_CONSTRUCTION,
    }  # fmt: skip
    assert {name: judge(statements[name], found[name]) for name in expected} == expected
