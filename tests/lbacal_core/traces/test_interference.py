import numpy as np
import pytest
from scipy.signal import welch

from lbacal_core.grids import Floats
from lbacal_core.traces.density import (
    FALSE_FLAG_RATE,
    FineSpectrum,
    bin_weights,
    channel_frequencies,
    effective_channels,
    estimate_baseline,
    find_excess,
    find_lines,
    find_station_excess,
    find_steady_phases,
    hann,
    line_leakage,
    line_response,
    phase_stability,
    power_density,
    transform_in_place,
    unit_phases,
)

FACTOR, SEGMENTS = 16, 25
CHANNEL_MHZ = 200.0 / 1024 / FACTOR
FINE = 8193


def spectrum_of(density: Floats, segments: int = SEGMENTS) -> FineSpectrum:
    return FineSpectrum(density, segments, FACTOR, CHANNEL_MHZ)


def noise(seed: int, segments: int = SEGMENTS, size: int = FINE) -> Floats:
    return np.random.default_rng(seed).gamma(segments, 1 / segments, size)


def test_baseline_follows_a_resonance_without_bias():
    mhz = np.arange(FINE) * CHANNEL_MHZ
    truth = 0.1 + 1 / (1 + ((mhz - 58) / 5) ** 2)
    found = np.mean([estimate_baseline(spectrum_of(truth * noise(k)), np.zeros(FINE, bool)) for k in range(60)], axis=0)
    in_band = (mhz > 29) & (mhz < 81)
    assert np.abs(found / truth - 1)[in_band].max() < 0.02  # 60 x 2 % noise a group, 0.4 % of smoothing
    assert np.mean(found[in_band] / truth[in_band]) == pytest.approx(1.0, abs=2e-3)


def test_a_strong_line_leaves_the_baseline_alone():
    density = noise(1)
    density[4000:4003] += [3e3, 2e4, 5e3]
    is_line, baseline = find_lines(spectrum_of(density))
    clean = find_lines(spectrum_of(noise(1)))[1]
    assert np.all(is_line[4000:4003])
    assert np.abs(baseline / clean - 1).max() < 0.05  # a group loses some of its channels: other noise, no bias


def test_the_feet_of_a_line_do_not_lift_the_baseline():
    """A carrier between two fine channels leaks into many of a group of 0.4 MHz: drawn in one pass, 4 % too high."""
    line = 1e4 * line_response(np.arange(-600, 601) + 0.5) / line_response(np.zeros(1))
    lifted = []
    for seed in range(40):
        density = noise(seed)
        without = find_lines(spectrum_of(density))[1]
        density[3400:4601] += line
        lifted.append(np.log(find_lines(spectrum_of(density))[1] / without)[3960:4060].mean())
    # 0.15 % of noise, and 0.4 % of channels below the limit; 1.1 % with the feet that are no line themselves
    assert np.mean(lifted) == pytest.approx(0.0, abs=0.0075)


def test_interference_wider_than_a_group_is_found():
    density = noise(2)
    density[3000:3050] += 1.5
    is_line, baseline = find_lines(spectrum_of(density))
    assert is_line[3000:3050].mean() > 0.8
    assert np.abs(np.log(baseline[2980:3070])).max() < 0.25


def test_noise_is_flagged_at_the_stated_rate():
    trials = 120
    flagged = sum(int(find_excess(noise(10 + k), SEGMENTS, (1,)).sum()) for k in range(trials))
    assert flagged <= 6  # trials x FINE x FALSE_FLAG_RATE = 1 expected; P(>6) < 1e-4
    assert trials * FINE * FALSE_FLAG_RATE == pytest.approx(1.0, abs=0.1)


def test_many_traces_together_see_what_one_cannot():
    ratios = np.stack([noise(200 + k) for k in range(40)])
    ratios[:, 5000] += 0.4
    assert not np.any([find_excess(ratio, SEGMENTS, (1, 2, 4))[5000] for ratio in ratios[:5]])
    found = find_station_excess(ratios, SEGMENTS)
    assert found[5000]
    assert found.sum() <= 8  # the boxes that reach it


def test_steady_phases_are_told_from_noise_and_from_the_common_sky():
    rng = np.random.default_rng(7)
    shape = (SEGMENTS, 2000)

    def draw() -> np.ndarray:
        return rng.normal(size=shape) + 1j * rng.normal(size=shape)

    sky = draw()
    left, right = (0.3 * sky + draw() for _ in range(2))  # near antennas share 8 % of their power
    left[:, 700] += 2.5
    right[:, 700] += 2.5 * np.exp(1.1j)
    stability = phase_stability(unit_phases(left.astype(np.complex64)), unit_phases(right.astype(np.complex64)))
    found = find_steady_phases(stability, 1, CHANNEL_MHZ)
    assert np.flatnonzero(found).tolist() == [700]


def test_leakage_is_what_a_line_really_leaves_in_each_channel():
    time = np.arange(400 * 1024) / 200e6
    carrier = 900 * np.cos(2 * np.pi * 45.03e6 * time)
    samples = np.rint(carrier + np.random.default_rng(8).normal(scale=8, size=time.size)).astype(np.int16)
    fine = power_density(samples.reshape(-1, 16 * 1024), 200e6)
    coarse = power_density(samples.reshape(-1, 1024), 200e6)
    is_line, baseline = find_lines(spectrum_of(fine))
    leak = line_leakage(is_line, fine / baseline - 1, FACTOR, 513)
    true_noise = (64 + 1 / 12) / 100
    measured = coarse / true_noise - 1
    offset = np.abs(channel_frequencies(1024, 200e6) - 45.03) / (200 / 1024)
    strong = offset < 3
    assert np.allclose(measured[strong], leak[strong], rtol=0.06)
    far = (offset > 3) & (offset < 7)
    assert np.allclose(measured[far], leak[far], rtol=0.1, atol=0.2)  # 5 % noise a channel


def test_a_line_counts_with_both_neighbours_whether_or_not_they_are_flagged():
    """Under a Hann window a carrier stands in three fine channels, a quarter of its power in each of the outer two."""
    excess, is_line = np.zeros(FINE), np.zeros(FINE, bool)
    excess[3999:4002] = [25.0, 100.0, 25.0]
    is_line[4000] = True
    alone = line_leakage(is_line, excess, FACTOR, 513)
    together = line_leakage(excess > 0, excess, FACTOR, 513)
    assert alone == pytest.approx(together)
    excess[[3999, 4001]] = 0.0
    assert line_leakage(is_line, excess, FACTOR, 513)[250] == pytest.approx(alone[250] / 1.5, rel=0.02)


RATE = 200e6
WIDTH_MHZ = 200.0 / 1024


def test_sum_over_the_band_is_the_mean_square_of_the_windowed_samples_exactly():
    blocks = np.random.default_rng(4).normal(scale=20, size=(300, 1024)).astype(np.int16)
    density = power_density(blocks, RATE)
    window = hann(1024).astype(float)
    expected = np.mean(np.sum((blocks * window) ** 2, axis=1)) / np.sum(window**2)
    assert density.sum() * WIDTH_MHZ == pytest.approx(expected, rel=3e-6)  # single precision
    # The window weighs samples, so the mean square of all samples is met within its statistics: 1/sqrt(n/2 x 18/35).
    assert density.sum() * WIDTH_MHZ == pytest.approx(np.mean(blocks.astype(float) ** 2), rel=4 / np.sqrt(300 * 263))


def test_density_equals_a_plain_double_precision_transform():
    blocks = np.random.default_rng(5).integers(-2000, 2000, size=(7, 2048)).astype(np.int16)
    time = np.arange(2048)
    wave = np.exp(-2j * np.pi * np.outer(time, np.arange(1025)) / 2048)
    window = np.sin(np.pi * time / 2048) ** 2
    power = np.mean(np.abs((blocks * window) @ wave) ** 2, axis=0) * 2 / (200.0 * np.sum(window**2))
    power[[0, -1]] /= 2
    assert np.allclose(power_density(blocks, RATE), power, rtol=2e-5)


def test_density_is_that_of_welch_in_scipy():
    blocks = np.random.default_rng(15).integers(-2000, 2000, size=(40, 1024)).astype(np.int16)
    frequency_hz, density = welch(blocks.ravel().astype(float), RATE, nperseg=1024, noverlap=0, detrend=False)
    assert np.allclose(channel_frequencies(1024, RATE), frequency_hz / 1e6)
    assert np.allclose(power_density(blocks, RATE), density * 1e6, rtol=2e-5)  # single precision


def test_a_line_shows_its_power_once_and_in_the_shape_of_the_window():
    time = np.arange(64 * 1024) / RATE
    for offset in (0.0, 0.3, 0.5):
        frequency = (300 + offset) * RATE / 1024
        samples = np.rint(1500 * np.cos(2 * np.pi * frequency * time + 0.4)).astype(np.int16).reshape(-1, 1024)
        density = power_density(samples, RATE) * WIDTH_MHZ
        assert density.sum() == pytest.approx(1500**2 / 2, rel=1e-3)
        near = np.arange(295, 306)
        share = line_response(near - 300 - offset)
        assert np.allclose(density[near] / density.sum(), share, atol=2e-4)
    assert line_response(np.arange(-50.0, 51.0)).sum() == pytest.approx(1.0, abs=1e-9)
    assert line_response(np.array([1.0 - 1e-5]))[0] == pytest.approx(1 / 6, rel=1e-3)


def test_noise_of_neighbouring_channels_correlates_as_the_window_says():
    blocks = np.random.default_rng(6).normal(scale=30, size=(20_000, 256)).astype(np.int16)
    power = np.abs(transform_in_place(blocks.astype(np.float32))[:, 20:100]) ** 2
    power /= power.mean(axis=0)
    for apart, expected in ((1, 4 / 9), (2, 1 / 36), (3, 0.0)):
        found = np.mean((power[:, apart:] - 1) * (power[:, :-apart] - 1))
        assert found == pytest.approx(expected, abs=0.01)  # 20,000 x 80 products, correlated: 0.002


def test_every_bin_holds_5_12_channels_centred_on_it():
    channels = channel_frequencies(1024, RATE)
    bins = np.arange(30.0, 81.0)
    weights = bin_weights(channels, bins, 1.0)
    assert np.allclose(weights.sum(axis=1), 5.12)
    assert np.allclose(weights @ channels / 5.12, bins, atol=0.01)  # whole channels would be up to 0.1 MHz off


def test_effective_channels_of_a_bin_and_of_one_channel():
    weights = np.zeros((2, 50))
    weights[0, 7] = 1.0
    weights[1, 10:40] = 1.0
    single, many = effective_channels(weights)
    assert single == pytest.approx(1.0)
    assert many == pytest.approx(30 / (1 + 2 * (29 * 4 / 9 + 28 / 36) / 30), rel=1e-9)
    assert effective_channels(np.zeros(5)) == 0.0
