from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.twin.faults.catalogue import draw_fault
from proofs import discovery


@pytest.mark.timeout(600)
def test_a_small_instance_of_the_proof_finds_nothing_in_clean_data():
    holds, lines = discovery.prove(["--clean", "2"])
    assert holds
    assert lines[1].startswith("Nothing hidden, clean: 0 of 2 not consistent")


@pytest.mark.timeout(600)
def test_a_typical_drift_is_named():
    fault = draw_fault("gain_drift", np.random.default_rng(1), discovery.SETTINGS, size=0.08)
    assert "gain_drift" in discovery.ask(3, [fault]).named
