"""Small instances of the proof of discovery, with the same code."""

from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.twin.faults.antenna import GainDrift
from proofs import discovery
from proofs.hidden.data_sets import DataSet, Planted, draw_one, moving_causes, realistic
from proofs.hidden.one_effect import Outcome
from proofs.hidden.several_effects import draw_several


@pytest.mark.timeout(600)
@pytest.mark.parametrize(("part", "kinds"), [("clean", 1), ("nuisances", 1), ("clean-other", 3)])
def test_a_small_instance_of_the_proof_finds_nothing_in_clean_data(part, kinds):
    holds, lines = discovery.prove(["--part", part, "--count", "1"])
    assert holds
    assert len(lines) == 3 + kinds
    for line in lines[3:]:
        assert "not consistent in 0 of 1" in line


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


@pytest.mark.timeout(600)
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
    planted = Planted("true", GainDrift(size=0.0), "station", "station")
    assert Outcome(10.0, "true", planted, "explained", [small]).is_named
    assert not Outcome(10.0, "true", planted, "explained", [large]).is_named
    assert Outcome(10.0, "true", planted, "explained", [["true", "a", "b", "c"]]).is_named
    assert not Outcome(10.0, "true", planted, "explained", [["a"], ["true"]]).is_named
