"""Cables that are named by their length."""

import numpy as np
import pytest

from lbacal_core.causes.cable import log_loss_per_metre


@pytest.mark.parametrize("names", [("50", "80"), ("50 m", "80 m"), ("50m", "80m")])
def test_a_name_of_a_cable_is_its_length_with_its_unit_or_without(names):
    """The example of docs/formats/instrument.md was refused: its cables are `50 m` and `80 m`."""
    cables = {name: np.exp([-0.01 * length]) for name, length in zip(names, (50, 80), strict=True)}
    assert log_loss_per_metre(cables) == pytest.approx([-0.01])
    assert log_loss_per_metre({**cables, "long": np.ones(1)}) is None
