from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from lbacal_core.errors import UnknownNameError
from lbacal_twin.faults.catalogue import catalogue_faults, draw_fault
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.uncatalogued import uncatalogued_faults
from lbacal_twin.settings import TwinSettings

CAUSES = sorted(catalogue_faults())
SETTINGS = TwinSettings(stations=("CS002",))


@pytest.mark.shared
def test_every_cause_of_the_contract_can_be_planted(shared: Path) -> None:
    text = (shared / "CONTRACT.md").read_text()
    section = text[text.index("Causes: ID") : text.index("## HTTP")]
    named = set(re.findall(r"`([a-z_]+)`[:,]", section))
    assert named == set(CAUSES)
    assert len(CAUSES) == 26


@pytest.mark.parametrize("cause", CAUSES)
def test_every_law_changes_the_power_and_of_size_zero_nothing(cause: str, plant) -> None:
    entry = catalogue_faults()[cause]
    for law in (entry.laws[0], entry.laws[-1]):
        dated = {key: "2014-07-01" if value is None else value for key, value in law.items()}
        size = {"lna": 0.1, "rcu": 1e5, "adc": 1e5}[dated["stage"]] if cause == "missing_noise" else entry.typical
        effect = plant(entry.fault(size=size, **dated)).effect
        assert np.abs(effect).max() > 1e-6
        assert np.isfinite(effect).all()
        np.testing.assert_allclose(plant(entry.fault(size=0.0, **dated)).effect, 0.0, atol=1e-12)


@pytest.mark.parametrize("cause", CAUSES)
def test_small_faults_act_in_proportion_to_their_size(cause: str, plant) -> None:
    size = catalogue_faults()[cause].typical
    halves = [
        plant(draw_fault(cause, np.random.default_rng(2), SETTINGS, size=part * size)).effect for part in (0.5, 1.0)
    ]
    # Second order in the effect itself: typical sizes are of 1 % or less, the cable of 3 m is 8 %.
    np.testing.assert_allclose(2 * halves[0], halves[1], atol=0.1 * np.abs(halves[1]).max())


@pytest.mark.parametrize("cause", CAUSES)
def test_only_the_paths_named_are_touched(cause: str, plant) -> None:
    for where, touched in (
        (Where(antennas=(2,), dipoles=("Y",)), [(2, 1)]),
        (Where(cables=("80",)), [(a, d) for a in (1, 4) for d in (0, 1)]),
        (Where(stations=("CS003",)), []),
    ):
        size = 1.0 if cause == "missing_noise" else None
        effect = plant(draw_fault(cause, np.random.default_rng(3), SETTINGS, size=size, where=where)).effect
        is_changed = np.abs(effect).max(axis=(2, 3)) > 1e-12
        assert sorted(map(tuple, np.argwhere(is_changed).tolist())) == touched


@pytest.mark.parametrize("cause", CAUSES)
def test_a_fault_describes_itself_in_json_and_keeps_to_its_laws(cause: str) -> None:
    rng = np.random.default_rng(4)
    for _ in range(5):
        content = json.loads(json.dumps(draw_fault(cause, rng, SETTINGS).as_dict()))
        assert content["fault"] == catalogue_faults()[cause].fault.__name__
        if content.get("date"):
            assert "2014-03-01" < content["date"] < "2014-11-01"


def test_an_unknown_cause_is_named() -> None:
    with pytest.raises(UnknownNameError, match="gremlins"):
        draw_fault("gremlins", np.random.default_rng(1), SETTINGS)


def test_no_uncatalogued_effect_is_a_cause_of_the_catalogue() -> None:
    known = {entry.fault for entry in catalogue_faults().values()}
    assert len(uncatalogued_faults()) >= 6
    assert not known & set(uncatalogued_faults().values())
