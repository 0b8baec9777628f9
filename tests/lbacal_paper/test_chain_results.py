from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_paper.chain_results import edge_of_pass_band, find_about_chain, find_peak
from lbacal_paper.study import Study

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
    half = replace(study, instrument=replace(study.instrument, antennas=study.instrument.antennas[:144]))
    assert find_about_chain(half)["samples-per-bin"].ours == pytest.approx(7250 * 96 / 144)
