from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.chain.model import calibration_factor, chain_power
from lbacal_core.curves.curves import CalibrationCurve, Parameter
from lbacal_core.drift.events import MonthlyRatios, average_months, measure_event_modes
from lbacal_core.grids import Floats
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra.blocks import SpectraBlock

MHZ = np.array([30.0, 40.0, 55.0, 70.0])
GAIN = np.array([0.1, 0.3, 1.0, 0.2])
RECEIVER = np.array([0.7, 1.0, 1.1, 0.8])
CABLE = np.array([0.8, 0.75, 0.7, 0.65])
N_LNA, N_RCU, N_ADC, SCALE = 2e-19, 1.5e-19, 0.02, 3e17


def make_case(
    gain_of_event: Floats, rng: np.random.Generator, noise: float
) -> tuple[SpectraBlock, CalibrationCurve, Instrument, SkyPower]:
    lst = np.arange(24.0)
    shape = 1.0 + 0.4 * np.cos(2 * np.pi / 24 * (lst[:, None] - 18.0))
    power = 1e-18 * shape * (MHZ / 50.0) ** -2.5
    sky = SkyPower(MHZ, lst, {"X": power, "Y": power})
    instrument = Instrument(
        "one antenna", 52.9, 6.9, 50.0, MHZ, {"X": 45.0, "Y": 135.0}, GAIN, RECEIVER, {"c": CABLE},
        (AntennaRecord("CS001", 7, "c"),),
    )  # fmt: skip
    time_unix = (
        np.datetime64("2014-01-01").astype("datetime64[s]").astype(float) + np.arange(gain_of_event.size) * 86_400.0
    )
    p_sky = sky.at("X", local_sidereal_time(time_unix, 6.9))
    recorded = chain_power(
        p_sky, antenna_gain=GAIN, correction=gain_of_event[:, None], cable_loss=CABLE, receiver_gain=RECEIVER,
        scale=SCALE, n_lna=N_LNA, n_rcu=N_RCU, n_adc=N_ADC,
    )  # fmt: skip
    recorded = recorded * (1.0 + noise * rng.standard_normal((gain_of_event.size, 1)))
    events = gain_of_event.size
    block = SpectraBlock(
        "CS001", "X", MHZ, np.array([7]), np.arange(events).astype(str), time_unix, recorded[None],
        np.ones((1, events), dtype=bool), np.full((1, events), 100),
    )  # fmt: skip
    c = calibration_factor(GAIN * CABLE * RECEIVER * SCALE, GAIN)
    levels = {"n_lna": N_LNA, "n_rcu": N_RCU * SCALE, "n_adc": N_ADC}
    curve = CalibrationCurve(
        "CS001", 7, "X", "converged", events, MHZ, c, 0.01 * c, None, 1.0, 1.0,
        {name: Parameter(value, 0.1 * value) for name, value in levels.items()},
    )  # fmt: skip
    return block, curve, instrument, sky


def measure_monthly_ratios(
    block: SpectraBlock, curves: dict[int, CalibrationCurve], instrument: Instrument, sky: SkyPower
) -> MonthlyRatios:
    return average_months(measure_event_modes(block, curves, instrument, sky))


def test_a_gain_of_the_chain_is_measured_exactly_without_noise() -> None:
    gain = np.where(np.arange(365) < 181, 1.0, 1.21)
    block, curve, instrument, sky = make_case(gain, np.random.default_rng(1), noise=0.0)
    found = measure_monthly_ratios(block, {7: curve}, instrument, sky)
    assert found.months.size == 12
    assert found.c_ratio[0, :6] == pytest.approx(1.0, rel=1e-12)
    assert found.c_ratio[0, 6:] == pytest.approx(1.0 / 1.1, rel=1e-12)
    assert found.events.sum() == 365


def test_the_error_of_a_month_is_its_scatter() -> None:
    block, curve, instrument, sky = make_case(np.ones(730), np.random.default_rng(2), noise=0.05)
    found = measure_monthly_ratios(block, {7: curve}, instrument, sky)
    pull = (found.c_ratio[0] - 1.0) / found.c_ratio_sigma[0]
    # 24 pulls: their variance is 1 within 3 x sqrt(2/24)
    assert np.mean(pull**2) == pytest.approx(1.0, abs=0.9)
    # the noise multiplies all of P, the gain only S: where S is a share q of P, an event of +5 % looks like a gain of
    # +5 % / q, in the mean over channels weighted by q^2; C moves by half of that
    sky_part = (sky.power["X"].mean(axis=0) + N_LNA) * GAIN * CABLE * RECEIVER * SCALE
    share = sky_part / (sky_part + N_RCU * RECEIVER * SCALE + N_ADC)
    of_gain = 0.05 * share.sum() / np.sum(share**2)
    # 730 events know their scatter to 2.6 %
    assert np.median(found.c_ratio_sigma) == pytest.approx(0.5 * of_gain / np.sqrt(30), rel=0.1)


def test_a_path_with_four_times_the_gain_has_the_error_of_its_own_scatter() -> None:
    block, curve, instrument, sky = make_case(np.full(730, 4.0), np.random.default_rng(2), noise=0.05)
    found = measure_monthly_ratios(block, {7: curve}, instrument, sky)
    assert np.median(found.c_ratio) == pytest.approx(0.5, rel=0.01)
    # An event of +5 % in P = g S + B looks like a gain of g + 5 % (g + B / S); C goes as g^-1/2.
    signal = (sky.power["X"].mean(axis=0) + N_LNA) * GAIN * CABLE * RECEIVER * SCALE
    behind = N_RCU * RECEIVER * SCALE + N_ADC
    weight = (signal / (signal + behind)) ** 2
    of_gain = 0.05 * np.sum(weight * (4.0 + behind / signal)) / weight.sum()
    assert np.median(found.c_ratio_sigma) == pytest.approx(0.5 * of_gain * 4.0**-1.5 / np.sqrt(30), rel=0.1)


def test_a_month_with_few_events_has_no_value_and_an_antenna_without_reference_no_row() -> None:
    block, curve, instrument, sky = make_case(np.ones(34), np.random.default_rng(3), noise=0.01)
    found = measure_monthly_ratios(block, {7: curve}, instrument, sky)
    assert np.isfinite(found.c_ratio[0]).tolist() == [True, False]
    assert measure_monthly_ratios(block, {}, instrument, sky).c_ratio.shape == (0, 2)
