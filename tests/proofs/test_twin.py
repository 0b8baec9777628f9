from __future__ import annotations

from proofs.twin import CHANNELS, prove


def test_a_small_instance_of_the_proof_measures_every_scope_and_nuisance() -> None:
    _, lines = prove(["3"])
    rows = [line for line in lines if line.startswith(("| none", "| realistic"))]
    assert len(rows) == 4 * len(CHANNELS)
    for row in rows:
        assert float(row.split("|")[6]) < 3  # 3 campaigns: the standard deviation of a station's 6 pulls to 30 %
