from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.curves.covariance import Budget, BudgetTerm, CurveCovariance
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.data.tables import read_table
from lbacal_core.errors import BadInputError
from lbacal_core.traces.voltage import calibrate_trace, relative_errors

CHANNELS = np.arange(30.0, 81.0)
C = 1e-5 * (1.0 + (CHANNELS - 30.0) / 20.0)
RATE = 200.0
SAMPLES = 4096
RECORDED_V = 1e-6 * np.array(
    [
        83.06974, 74.33752, 316.09703, 77.66920, -530.99788, -58.85100, 278.50474, 376.86378,
        -407.90568, -384.55475, 814.74723, -375.08628, -390.55618, 692.85525, -410.23492, -17.19827,
        282.63622, -308.21109, 212.99989, -139.08168, 17.35469, 154.31178, -262.34974, 257.95030,
        -111.65991, -58.58787, 141.08638, -238.27612, 316.24359, -237.11739, -42.10495, 495.00385,
        -702.27719, 250.57401, 499.23282, -811.87876, 261.09956, 512.30998, -269.65260, -337.00228,
        -112.30557, 519.34526, 61.13550, -257.18734, -4.23009, -201.54977, 186.84999, 136.30547,
        -50.70806, 42.37127, -205.30170, 75.69878, -10.30214, -29.24241, 224.64045, -146.24558,
        26.85775, -35.36792, -160.08762, 145.75405, -14.44499, 239.62706, -37.43636, -415.53904,
    ]
)  # fmt: skip


def curve(stat: float | None = 0.01, sys: float | None = 0.05) -> CalibrationCurve:
    errors = [None if value is None else value * C for value in (stat, sys)]
    return CalibrationCurve("CS002", 3, "X", "converged", 900, CHANNELS, C, errors[0], errors[1], 1.0, 1.0, {})


def noise(seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 20, SAMPLES)


def test_a_line_between_two_channels_gets_the_mean_of_their_c():
    time = np.arange(SAMPLES) / RATE
    found = calibrate_trace(7.0 * np.cos(2 * np.pi * 50.048828125 * time), RATE, curve())
    at = int(np.argmax(np.abs(found.spectrum)))
    assert found.frequency_mhz[at] == 50.048828125
    assert found.samples == pytest.approx(7.0 * found.c[at] * np.cos(2 * np.pi * 50.048828125 * time), abs=1e-9)
    assert found.c[at] == pytest.approx(1e-5 * (1 + 20.048828125 / 20))


def test_what_lies_outside_the_band_is_zero_and_flagged():
    found = calibrate_trace(noise(), RATE, curve())
    outside = (found.frequency_mhz < 30) | (found.frequency_mhz > 80)
    assert np.array_equal(found.is_inside, ~outside)
    assert np.all(found.spectrum[outside] == 0)
    assert np.all(np.fft.rfft(found.samples)[found.frequency_mhz < 29] == pytest.approx(0, abs=1e-12))
    assert np.all(found.c_sigma[outside] == 0)


def test_inside_the_band_it_is_what_nuradioreco_does():
    # NuRadioReco: interp1d over 101 values at 0, 1, ... 100 MHz, zeros outside 30-80, times the Fourier transform
    file = np.zeros(101)
    file[30:81] = C
    found = calibrate_trace(noise(), RATE, curve())
    theirs = np.fft.rfft(noise()) * np.interp(found.frequency_mhz, np.arange(101.0), file)
    assert found.spectrum[found.is_inside] == pytest.approx(theirs[found.is_inside], rel=1e-12)
    # theirs ramps to zero over one channel beyond each edge; ours ends at the edge
    beyond = ~found.is_inside & (np.abs(theirs) > 0)
    assert np.all((found.frequency_mhz[beyond] > 29) & (found.frequency_mhz[beyond] < 81))


def test_a_trace_comes_out_as_nuradioreco_3_1_0_gave_it():
    # Recorded: NuRadioMC 3.1.0 (PyPI), stationGalacticCalibrator._calibrate_channel on the trace below at 200 MHz with
    # its own curve for LOFAR_LBA, its relative calibration set to 1; V at samples 0 to 63, eight digits. Its bins are
    # 3.125 MHz wide, so none lies in the channel beyond the edge where its curve falls to 0.
    k = np.arange(64)
    trace = np.round(20 * np.sin(0.9 * k + 0.05 * k**2), 3)
    published = read_table("published_calibration")
    ours = calibrate_trace(trace, RATE, replace(curve(None, None), c=published["c"]))
    assert np.max(np.abs(ours.samples - RECORDED_V)) < 1e-6 * np.max(np.abs(RECORDED_V))


def test_nuradioreco_itself_gives_the_same_inside_the_band():
    module = pytest.importorskip("NuRadioReco.modules.LOFAR.stationGalacticCalibrator")
    theirs = module.stationGalacticCalibrator()
    theirs.begin()
    published = read_table("published_calibration")
    ours = calibrate_trace(noise(), RATE, replace(curve(None, None), c=published["c"], c_sigma_stat=None))
    inside = ours.frequency_mhz[ours.is_inside]
    assert ours.c[ours.is_inside] == pytest.approx(theirs._get_absolute_calibration(inside / 1e3), rel=1e-6)


@pytest.mark.long
def test_errors_are_interpolated_and_fully_correlated_along_frequency():
    found = calibrate_trace(noise(), RATE, curve(stat=0.03, sys=0.04))
    inside = found.is_inside
    assert found.c_sigma[inside] == pytest.approx(0.05 * found.c[inside])
    covariance = found.covariance()
    assert covariance.shape == (found.is_inside.sum(),) * 2
    assert covariance == pytest.approx(np.full_like(covariance, 0.0025))
    # an amplitude known to 5 % is an energy known to 10 %, less a bit because the two errors are independent
    assert found.sigma_of_energy() == pytest.approx(0.10)


def test_the_error_of_the_energy_covers_wrong_calibrations():
    rng = np.random.default_rng(8)
    right = calibrate_trace(noise(), RATE, curve(stat=0.02, sys=0.03))
    energies = []
    for _ in range(400):
        wrong = C * np.exp(0.02 * rng.normal() + 0.03 * rng.normal())
        energies.append(np.sum(np.abs(calibrate_trace(noise(), RATE, replace(curve(), c=wrong)).spectrum) ** 2))
    energy = np.sum(np.abs(right.spectrum) ** 2)
    # 400 draws know a standard deviation to 3.5 %
    assert np.std(np.array(energies) / energy) == pytest.approx(right.sigma_of_energy(), rel=0.12)


def known_to(slope: float, alone: float) -> tuple[CalibrationCurve, Budget]:
    """A curve with a covariance, and the budget that it names: a level of 3 %, and a slope."""
    x = (CHANNELS - 55.0) / 25.0
    budget = Budget(
        CHANNELS,
        (
            BudgetTerm("level", "a test", {"X": np.full((1, 51), 0.03)}),
            BudgetTerm("slope", "a test", {"X": slope * x[None]}),
        ),
    )
    covariance = CurveCovariance(np.full((1, 51), 0.01), np.full(51, alone**2), budget.digest, np.full((1, 51), 0.02))
    stat, sys = C * np.hypot(0.01, alone), C * np.sqrt(0.03**2 + 0.02**2 + (slope * x) ** 2)
    return replace(curve(), c_sigma_stat=stat, c_sigma_sys=sys, covariance=covariance), budget


def test_with_its_budget_a_curve_has_the_covariance_of_the_budget_along_frequency():
    one, budget = known_to(slope=0.1, alone=0.004)
    found = calibrate_trace(noise(), RATE, one, budget)
    (low,), (high,) = (np.flatnonzero(found.frequency_mhz == mhz) for mhz in (31.25, 78.125))
    between = found.factors[:, low] @ found.factors[:, high]
    x = (found.frequency_mhz[[low, high]] - 55.0) / 25.0
    assert between == pytest.approx(0.01**2 + 0.02**2 + 0.03**2 + 0.1**2 * x[0] * x[1])
    # a standard deviation that were fully correlated would be positive here, and the energy's error larger
    assert between < 0
    assert found.sigma_of_energy() < calibrate_trace(noise(), RATE, one).sigma_of_energy()


def test_at_the_channels_a_covariance_gives_the_standard_deviations_of_the_curve():
    one, budget = known_to(slope=0.05, alone=0.004)
    expected = np.hypot(one.c_sigma_stat, one.c_sigma_sys) / one.c
    for named in (budget, None):
        total = np.sqrt(np.sum(np.square(relative_errors(one, named)), axis=0))
        assert total == pytest.approx(expected)


@pytest.mark.parametrize(
    ("samples", "rate", "message"),
    [
        (np.zeros((2, 8)), RATE, "samples"),
        (np.array([1.0, np.nan]), RATE, "finite"),
        (np.zeros(64), 40.0, "in the band"),
        (np.zeros(64), 0.0, "sample_rate_mhz"),
    ],
)
def test_unusable_traces_are_refused(samples, rate, message):
    with pytest.raises(BadInputError, match=message):
        calibrate_trace(samples, rate, curve())
    failed = replace(curve(), status="not_converged", c=None, c_sigma_stat=None, c_sigma_sys=None)
    with pytest.raises(BadInputError, match="converged"):
        calibrate_trace(noise(), RATE, failed)


def test_a_channel_without_a_value_is_not_calibrated_through():
    c, stat = C.copy(), 0.01 * C
    c[20] = stat[20] = np.nan
    flag = ("ok",) * 20 + ("outside",) + ("ok",) * 30
    found = calibrate_trace(noise(), RATE, replace(curve(), c=c, c_sigma_stat=stat, c_sigma_sys=None, flag=flag))
    beside = (found.frequency_mhz > 49) & (found.frequency_mhz < 51)
    assert not np.any(found.is_inside[beside])
    assert np.all(found.spectrum[beside] == 0)
    assert np.all(np.isfinite(found.samples))
    assert np.all(found.is_inside[(found.frequency_mhz >= 51) & (found.frequency_mhz <= 80)])
