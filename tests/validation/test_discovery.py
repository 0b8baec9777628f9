"""Small instances of the proof of discovery, with the same code."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest

from lbacal_twin.faults.hardware import GainDrift
from validation import discovery
from validation.hidden.data_sets import DataSet, draw_one, moving_causes, realistic
from validation.hidden.one_effect import CYCLE, Outcome
from validation.hidden.several_effects import draw_several
from validation.machinery.records import claims_of

PARTS = {part.name: part for part in discovery.PARTS}


@pytest.mark.parametrize("name", ["clean", "nuisances", "ten-antennas", "own-sky", "lst-curves"])
def test_a_small_instance_of_the_proof_finds_nothing_in_clean_data(name):
    row = PARTS[name].trial(0)
    assert row["verdict"] == "consistent", row
    (claim,) = claims_of("discovery", name, [row])
    assert (claim.found, claim.n) == (0.0, 1)


def test_an_alarm_in_clean_data_counts_and_is_told():
    rows = [{"seed": k, "verdict": "consistent", "named": [], "axis": ""} for k in range(3)]
    rows.append({"seed": 3, "verdict": "explained", "named": ["gain_step"], "axis": ""})
    (claim,) = claims_of("discovery", "clean", rows)
    assert claim.found == 0.25
    table = PARTS["clean"].tell(rows)
    assert "| verdict | consistent 3 (seed 0), explained 1 (seed 3) |" in table
    assert "| named | gain_step 1 (seed 3) |" in table


def outcomes_as_rows(count: int) -> list[dict[str, object]]:
    """Effects that are detected from SNR 5 on, the tenth of each SNR without its name."""
    rows = []
    for seed in range(count):
        snr = CYCLE[seed % len(CYCLE)]
        named = "gain_drift" if seed % 10 else "gain_step"
        verdict = "explained" if snr + np.sin(seed) > 5.0 else "consistent"
        sets = [[named]] if verdict == "explained" else []
        outcome = Outcome(snr, "gain_drift", "path", "antenna 0 X", True, verdict, sets, 0.95 * snr, 0.5)
        rows.append({"seed": seed, **asdict(outcome)})
    return rows


def test_detection_names_and_sizes_are_judged_from_stored_rows():
    claims = {claim.key: claim for claim in claims_of("discovery", "one", outcomes_as_rows(180))}
    assert claims["snr_50"].found == pytest.approx(5.0, abs=0.5)
    assert claims["named"].n == 60
    assert claims["named"].found == pytest.approx(0.9, abs=0.02)
    assert claims["sizes"].found == 1.0


def test_few_data_sets_that_happen_to_separate_do_not_decide_where_effects_are_detected():
    claims = {claim.key: claim for claim in claims_of("discovery", "one", outcomes_as_rows(9))}
    assert claims["snr_50"].verdict == "undecided"


def test_the_worst_cause_decides_what_every_cause_keeps():
    rng = np.random.default_rng(1)
    rows = []
    for seed in range(60):
        cause, kept = ("gain_drift", 1.0) if seed % 2 else ("compression", 0.6)
        score = 12.0 * (kept + 0.03 * rng.standard_normal())
        rows.append({"seed": seed, **asdict(Outcome(12.0, cause, "path", "antenna 0 X", score=score))})
    claims = {claim.key: claim for claim in claims_of("discovery", "efficiency", rows)}
    assert claims["worst_inside"].verdict == "refuted"
    assert claims["worst_inside"].found == claims["compression_inside"].found
    assert claims["gain_drift_inside"].verdict == "shown"


def test_the_size_for_a_wanted_signal_to_noise_has_it():
    data = DataSet(1)
    rng = np.random.default_rng(1)
    for _ in range(3):
        planted = draw_one(data, 6.0, rng, moving_causes())
        assert data.snr(planted) == pytest.approx(6.0, rel=0.01)


def test_the_same_seed_gives_the_same_noise_with_a_fault_and_without():
    data = DataSet(2)
    fault = GainDrift(size=0.05)
    ratio = data.spectra([fault]).power / data.spectra().power
    change = data.detector.template([fault]).reshape(len(ratio), -1)
    np.testing.assert_allclose(np.sort(ratio.ravel()), np.sort(1 + change.ravel()), rtol=1e-12)


def test_halves_share_the_hardware_and_no_event():
    halves = [DataSet(3, events=60, half=half).spectra() for half in (0, 1)]
    assert not set(halves[0].event_id) & set(halves[1].event_id)
    assert len(halves[0]) == len(halves[1]) == 60 / 2 * 12


def test_realistic_data_sets_have_noisy_stations_and_gaps():
    noisy, quiet = realistic(0), realistic(1)
    assert noisy.nuisances.noisy_stations != quiet.nuisances.noisy_stations
    # Two of six antennas die somewhere in the year, a tenth of the rest is missing.
    assert len(quiet.spectra()) < 0.9 * 12 * quiet.events


def test_a_path_with_hardly_an_event_to_compare_breaks_nothing():
    """An antenna that died in the first days of the year: nothing of it is left to look at."""
    assert realistic(459).ask().verdict == "consistent"


def test_several_effects_have_the_signal_to_noise_given_the_others():
    data = DataSet(4)
    rng = np.random.default_rng(1)
    planted, correlation = next(found for _ in range(100) if (found := draw_several(data, 2, rng)))
    assert correlation < 0.9
    information = data.detector.information_together([one.fault for one in planted])
    # Faults of some per cent are linear to some per cent.
    np.testing.assert_allclose(1 / np.sqrt(np.diag(np.linalg.inv(information))), 10.0, rtol=0.1)


def test_a_name_counts_only_from_a_small_set():
    small, large = ["a", "b", "true"], ["a", "b", "c", "true"]
    for sets, is_named in (
        ([small], True),
        ([large], False),
        ([["true", "a", "b", "c"]], True),
        ([["a"], ["true"]], False),
    ):
        assert Outcome(10.0, "true", verdict="explained", sets=sets).is_named == is_named
