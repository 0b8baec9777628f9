from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.calibration.years import gain_modes
from lbacal_core.curves.curves import CalibrationCurve, Parameter
from lbacal_core.drift.events import EventModes, add_events, average_months, measure_event_modes
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.instrument.chain import calibration_factor
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.table import SkyPower
from lbacal_core.spectra.blocks import SpectraBlock
from tests.oracles import chain_power

MHZ = np.array([30.0, 40.0, 55.0, 70.0])
GAIN = np.array([0.1, 0.3, 1.0, 0.2])
RECEIVER = np.array([0.7, 1.0, 1.1, 0.8])
CABLE = np.array([0.8, 0.75, 0.7, 0.65])
N_LNA, N_RCU, N_ADC, SCALE = 2e-19, 1.5e-19, 0.02, 3e17


def make_case(gain_of_event, rng, noise):
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


def measure_monthly_ratios(block, curves, instrument, sky):
    return average_months(measure_event_modes(block, curves, Simulation(instrument, sky)))


def test_a_gain_of_the_chain_is_measured_exactly_without_noise():
    gain = np.where(np.arange(365) < 181, 1.0, 1.21)
    block, curve, instrument, sky = make_case(gain, np.random.default_rng(1), noise=0.0)
    found = measure_monthly_ratios(block, {7: curve}, instrument, sky)
    assert found.months.size == 12
    assert found.c_ratio[0, :6] == pytest.approx(1.0, rel=1e-12)
    assert found.c_ratio[0, 6:] == pytest.approx(1.0 / 1.1, rel=1e-12)
    assert found.events.sum() == 365


def test_the_error_of_a_month_is_its_scatter():
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


def test_the_error_of_months_of_few_events_is_on_average_the_true_one():
    """Each month takes one of the events' degrees of freedom: six events in each of twelve months leave sixty."""
    rng, months = np.random.default_rng(5), np.arange("2014-01", "2015-01", dtype="datetime64[M]")
    days = months.astype("datetime64[s]").astype(float)[:, None] + 86_400.0 * np.arange(6)
    ln_c = 0.03 * rng.standard_normal((400, days.size, 3))
    found = average_months(EventModes(np.arange(400), days.ravel(), ln_c))
    assert found.months.tolist() == months.tolist()
    assert (found.events == 6).all()
    # 400 paths of 60 degrees of freedom know a variance to 1 %
    true = 0.03**2 / 6
    assert np.mean(found.shape_sigma**2, axis=(0, 1)) == pytest.approx([true, true], rel=0.03)
    assert np.mean(found.c_ratio_sigma**2) == pytest.approx(true, rel=0.05)
    assert np.var(found.shape, axis=(0, 1)) == pytest.approx([true, true], rel=0.1)


def test_a_path_with_four_times_the_gain_has_the_error_of_its_own_scatter():
    block, curve, instrument, sky = make_case(np.full(730, 4.0), np.random.default_rng(2), noise=0.05)
    found = measure_monthly_ratios(block, {7: curve}, instrument, sky)
    assert np.median(found.c_ratio) == pytest.approx(0.5, rel=0.01)
    # An event of +5 % in P = g S + B looks like a gain of g + 5 % (g + B / S); C goes as g^-1/2.
    signal = (sky.power["X"].mean(axis=0) + N_LNA) * GAIN * CABLE * RECEIVER * SCALE
    behind = N_RCU * RECEIVER * SCALE + N_ADC
    weight = (signal / (signal + behind)) ** 2
    of_gain = 0.05 * np.sum(weight * (4.0 + behind / signal)) / weight.sum()
    assert np.median(found.c_ratio_sigma) == pytest.approx(0.5 * of_gain * 4.0**-1.5 / np.sqrt(30), rel=0.1)


def test_a_month_with_few_events_has_no_value_and_an_antenna_without_reference_no_row():
    block, curve, instrument, sky = make_case(np.ones(34), np.random.default_rng(3), noise=0.01)
    found = measure_monthly_ratios(block, {7: curve}, instrument, sky)
    assert np.isfinite(found.c_ratio[0]).tolist() == [True, False]
    assert measure_monthly_ratios(block, {}, instrument, sky).c_ratio.shape == (0, 2)


def test_a_tilt_in_front_of_the_receiver_is_measured_as_such():
    block, curve, instrument, sky = make_case(np.ones(40), np.random.default_rng(1), noise=0.0)
    modes = gain_modes(MHZ)[1:]
    tilt = 1.0 + 0.02 * modes[0] - 0.01 * modes[1]
    behind = N_RCU * RECEIVER * SCALE + N_ADC
    weight = np.mean((1.0 - behind / block.power[0]) ** 2, axis=0)
    centre = modes @ weight / weight.sum()
    block.power[:] = (block.power - behind) * tilt + behind
    found = measure_event_modes(block, {7: curve}, Simulation(instrument, sky))
    # ln g = ln of the weighted mean, which is 1 + 0.02 <L1> - 0.01 <L2>; modes are relative to it, and half in C
    level = 1.0 + 0.02 * centre[0] - 0.01 * centre[1]
    # the weights, and with them the mean of a tilt, follow the sky: by a hundredth of the tilt over these 40 days
    assert found.ln_c[0, :, 0] == pytest.approx(-0.5 * np.log(level), abs=2e-4)
    assert found.ln_c[0, :, 1] == pytest.approx(-0.5 * 0.02 / level, abs=2e-5)
    assert found.ln_c[0, :, 2] == pytest.approx(0.5 * 0.01 / level, abs=2e-5)


def test_a_gain_of_all_channels_has_neither_tilt_nor_curvature():
    block, curve, *simulated = make_case(np.full(40, 1.3), np.random.default_rng(1), noise=0.0)
    found = measure_event_modes(block, {7: curve}, Simulation(*simulated))
    assert found.ln_c[0, :, 0] == pytest.approx(-0.5 * np.log(1.3), rel=1e-9)
    assert np.abs(found.ln_c[0, :, 1:]).max() < 1e-9


def test_an_event_with_less_power_than_the_noise_of_the_receiver_has_no_value():
    block, curve, instrument, sky = make_case(np.ones(10), np.random.default_rng(1), noise=0.0)
    block.power[0, 3] = 0.5 * (N_RCU * RECEIVER * SCALE + N_ADC)
    found = measure_event_modes(block, {7: curve}, Simulation(instrument, sky))
    assert np.isnan(found.ln_c[0, :, 0]).tolist() == [k == 3 for k in range(10)]


def test_an_event_of_the_receiver_alone_has_the_value_of_a_dead_antenna():
    block, curve, instrument, sky = make_case(np.ones(10), np.random.default_rng(1), noise=0.0)
    block.power[0, 3] = 0.99 * (N_RCU * RECEIVER * SCALE + N_ADC)
    found = measure_event_modes(block, {7: curve}, Simulation(instrument, sky))
    assert (np.abs(found.ln_c[0]) > 1e-6).tolist() == [[k == 3, False, False] for k in range(10)]
    assert found.ln_c[0, 3, 0] == pytest.approx(0.5 * np.log(10.0)), "a tenth of its power"


LAST = np.array([11, 57])
"""Numbers of the events that came later: one between others."""


def pick(block: SpectraBlock, events: np.ndarray) -> SpectraBlock:
    """Some events of a block."""
    return replace(
        block, power=block.power[:, events], is_present=block.is_present[:, events], blocks=block.blocks[:, events],
        time_unix=block.time_unix[events], event_id=block.event_id[events],
    )  # fmt: skip


@pytest.fixture
def case():
    block, curve, *rest = make_case(
        np.random.default_rng(3).normal(1.0, 0.05, 58), np.random.default_rng(2), noise=0.04
    )
    return block, {7: curve}, Simulation(*rest)


@pytest.fixture
def kept(case) -> EventModes:
    block, *others = case
    return measure_event_modes(pick(block, np.setdiff1d(np.arange(58), LAST)), *others)


def test_a_year_with_two_events_more_is_the_whole_year(case, kept):
    block, *others = case
    whole, found = measure_event_modes(block, *others), add_events(kept, pick(block, LAST), *others)
    assert np.array_equal(found.antennas, whole.antennas)
    assert np.array_equal(found.time_unix, whole.time_unix)
    np.testing.assert_allclose(found.ln_c, whole.ln_c, rtol=1e-12)


@pytest.mark.parametrize(("channels", "factor"), [(slice(None), 2.0), (slice(None), 0.5), (2, 3.0)])
def test_a_spectrum_that_may_be_left_out_is_left_to_the_whole_year(case, kept, channels, factor):
    block, *others = case
    odd = pick(block, LAST)
    odd.power[:, 1, channels] *= factor
    assert add_events(kept, odd, *others) is None


def test_a_path_without_events_before_and_one_that_may_be_screened_now_are_left_to_the_whole_year(case, kept):
    block, *others = case
    few = measure_event_modes(pick(block, np.arange(19)), *others)
    for before in (few, replace(kept, antennas=kept.antennas + 1)):
        assert add_events(before, pick(block, LAST), *others) is None
