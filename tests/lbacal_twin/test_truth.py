from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lbacal_core.errors import UnreadableFileError
from lbacal_core.instrument import Instrument
from lbacal_core.skypower.table import SkyPower
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings
from lbacal_twin.truth import Truth, seal_truth, unseal_truth


@pytest.fixture
def truth(low_band: Instrument, two_waves: SkyPower) -> Truth:
    return simulate_campaign(TwinSettings(events_per_year=3), low_band, two_waves, np.random.default_rng(1)).truth


def test_a_sealed_truth_opens_to_what_was_planted(truth: Truth, tmp_path: Path) -> None:
    seal_truth(truth, tmp_path / "truth.sealed")
    assert unseal_truth(tmp_path / "truth.sealed").as_dict() == truth.as_dict()


def test_a_seal_shows_nothing_of_what_it_holds(truth: Truth, tmp_path: Path) -> None:
    digest = seal_truth(truth, tmp_path / "truth.sealed")
    text = (tmp_path / "truth.sealed").read_text()
    assert digest in text
    assert "n_lna" not in text


def test_a_broken_seal_is_refused(truth: Truth, tmp_path: Path) -> None:
    path = tmp_path / "truth.sealed"
    digest = seal_truth(truth, path)
    path.write_text(path.read_text().replace(digest, "0" * 64))
    with pytest.raises(UnreadableFileError, match="does not match its seal"):
        unseal_truth(path)
    path.write_text("something else")
    with pytest.raises(UnreadableFileError, match="unreadable"):
        unseal_truth(path)
