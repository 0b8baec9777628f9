from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.antenna.hamaker import load_hamaker
from lbacal_core.instrument.instrument import Instrument
from lbacal_paper.showers.recording import Recording, field_power, record, true_power
from lbacal_paper.showers.signals import draw_signals

C = np.array([1e-5 * (1 + np.arange(51) / 30.0), 1.2e-5 * (1 + np.arange(51) / 40.0)])


def recording(low_band: Instrument, ratio: float, signals: int = 400) -> Recording:
    rng = np.random.default_rng(2)
    background = np.full((2, 51), 3.0)
    drawn = draw_signals(rng, 10, signals)
    return record(drawn, low_band, load_hamaker(), C, background, rng, (ratio, ratio * 1.01))


def test_strong_pulses_come_back_as_the_field_they_were(low_band: Instrument) -> None:
    strong = recording(low_band, 1e9)
    power, _ = field_power(strong, C, low_band.frequency_mhz)
    assert np.median(np.abs(power / true_power(strong) - 1)) < 1e-3


def test_power_without_background_is_unbiased_and_with_it_is_not(low_band: Instrument) -> None:
    weak = recording(low_band, 3.0, 2000)
    truth = true_power(weak).sum()
    subtracted, background = field_power(weak, C, low_band.frequency_mhz)
    assert subtracted.sum() == pytest.approx(truth, rel=0.03)
    plain, _ = field_power(weak, C, low_band.frequency_mhz, subtract=False)
    assert plain.sum() == pytest.approx(truth + background.sum(), rel=0.03)
    assert background.sum() > 0.2 * truth


def test_events_have_the_ratio_of_signal_to_background_that_was_asked_for(low_band: Instrument) -> None:
    made = recording(low_band, 50.0)
    bins = made.signals.frequency_mhz
    middle = (bins > 45) & (bins < 65)
    pulse = np.einsum("sbij,sjb->sib", made.jones, made.signals.field)
    channels = low_band.frequency_mhz
    density = 3.0 * 50.0 * 200.0 * 256 / 2
    ratio = np.abs(pulse / np.array([np.interp(bins, channels, one) for one in C])) ** 2 / density
    by_event = [ratio[made.signals.event == k][:, :, middle].mean() for k in range(10)]
    assert by_event == pytest.approx(np.full(10, 50.0), rel=0.02)


def test_a_calibration_of_each_signal_acts_on_it_alone(low_band: Instrument) -> None:
    made = recording(low_band, 1e6, 20)
    factor = np.linspace(1.0, 2.0, 20)[:, None, None]
    once, _ = field_power(made, C, low_band.frequency_mhz)
    each, _ = field_power(made, C * factor, low_band.frequency_mhz)
    assert each == pytest.approx(once * factor[:, 0] ** 2)
