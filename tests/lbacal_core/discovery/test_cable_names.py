from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.discovery.report import investigate
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.cable import CableLength
from lbacal_twin.faults.fault import Where
from lbacal_twin.gains import NOISES
from tests.lbacal_core.discovery.worlds import look_at

SEEDS = 12


@pytest.fixture(scope="module")
def three_names(world):
    """Nine antennas of three cable names, 400 events: long enough to tell the names apart."""
    return with_names(world, ("50", "80", "115"))


def with_names(world, names):
    records = [r for r in world.instrument.antennas if r.station == "CS002"]
    chosen = [record for name in names for record in [r for r in records if r.cable == name][:3]]
    instrument = replace(world.instrument, antennas=chosen)
    return replace(world, instrument=instrument).with_settings(antennas=None, events_per_year=400)


def look_in(world, noise, seed, faults=()):
    spectra = simulate_campaign(
        world.settings, world.instrument, world.sky, np.random.default_rng(seed), faults, view=world.view,
        gains=NOISES[noise],
    ).spectra  # fmt: skip
    return look_at(spectra, world.instrument, world.sky)


@pytest.mark.long
@pytest.mark.parametrize("noise", ["behind", "front", "resonance"])
def test_gains_that_all_antennas_share_make_no_cable_name_longer(noise, three_names):
    """Errors of single antennas alone gave 5-13 sigma: a gain of an event moves the slopes of a name together."""
    scores = [look_in(three_names, noise, seed).cable_scores() for seed in range(SEEDS)]
    z = np.array([score.z for one in scores for score in one])
    # Three contrasts of which two are independent, in 12 data sets: the spread is known to 15 %.
    assert 0.6 < z.std() < 1.45
    assert min(score.p_value for one in scores for score in one) > 1e-3


@pytest.mark.parametrize("metres", [12.0, -12.0])
def test_a_wrong_length_of_a_cable_name_has_its_name_its_sign_and_its_size(metres, three_names):
    fault = CableLength(size=metres, where=Where(cables=("115",)))
    best = look_in(three_names, "front", 1, [fault]).cable_scores()[0]
    assert best.target.label == "cable 115"
    assert best.size == pytest.approx(metres, abs=3 * best.sigma)
    assert best.sigma < 0.25 * abs(metres)
    assert best.p_value < 1e-3


def test_of_two_cable_names_either_may_be_the_wrong_one(world):
    two = with_names(world, ("50", "115"))
    first, second = look_in(two, "behind", 1, [CableLength(size=12.0, where=Where(cables=("115",)))]).cable_scores()
    assert first.size == pytest.approx(-second.size, rel=1e-6)
    assert first.p_value == pytest.approx(second.p_value, rel=1e-6)
    assert "the other one would look the same" in first.cause.note(first.parameters, first.size)


def test_names_that_are_no_lengths_and_names_of_one_antenna_are_not_compared(world, three_names):
    assert look_in(with_names(world, ("80",)), "behind", 1).cable_scores() == []
    records = [replace(r, cable=f"coil {r.cable}") for r in three_names.instrument.antennas]
    cables = {f"coil {name}": loss for name, loss in three_names.instrument.cables.items()}
    coils = replace(three_names, instrument=replace(three_names.instrument, antennas=records, cables=cables))
    assert look_in(coils, "behind", 1).cable_scores() == []


@pytest.mark.long
def test_a_wrong_cable_table_is_a_finding_for_all_antennas_of_the_name(three_names):
    fault = CableLength(size=25.0, where=Where(cables=("115",)))
    spectra = simulate_campaign(
        three_names.settings, three_names.instrument, three_names.sky, np.random.default_rng(1), [fault]
    ).spectra
    report, _ = investigate(spectra, three_names.instrument, three_names.sky)
    (finding,) = report["findings"]
    assert finding["cause"] == "cable_length"
    members = sorted(r.antenna for r in three_names.instrument.antennas if r.cable == "115")
    assert finding["where"]["antennas"] == members
    assert finding["where"]["dipoles"] == ["X", "Y"]
    assert finding["size"]["value"] == pytest.approx(25.0, abs=3 * finding["size"]["sigma"])
    assert finding["evidence"]["target"] == "cable 115"
