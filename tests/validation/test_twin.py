from __future__ import annotations

import pytest

from validation.twin import CHANNELS, PARTS, SCOPES


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.name)
def test_a_small_instance_of_the_proof_measures_every_scope_and_nuisance(part) -> None:
    rows = [part.trial(seed) for seed in range(3)]
    for scope in SCOPES:
        assert all(len(row[scope]["mean_square"]) == len(CHANNELS) for row in rows)
        # 3 campaigns: the spread of a station's 6 pulls to 30 %
        assert max(max(row[scope]["mean_square"]) for row in rows) < 9
    assert {claim.key for claim in part.judge(rows)} == {f"{s}_{what}" for s in SCOPES for what in ("mean", "spread")}
