"""Spectra from traces: unbiased, as noisy as theory says, which lines are found, and whether pulses leak.

Voltages are simulated, digitised and measured back. The suite runs small instances of the same functions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from lbacal_core.grids import Floats
from lbacal_core.traces.background import CleaningSettings, PathBackground, measure_traces
from lbacal_core.traces.density import bin_weights, effective_channels
from lbacal_core.traces.selection import select_background
from lbacal_core.traces.trace import BLOCK_SAMPLES, Trace, TraceReference
from lbacal_twin.voltages import Shower, Transmitter, digitise, draw_noise
from validation.machinery.claims import Found, One, mean_of, rate_of, spread_interval, worst_of
from validation.machinery.parts import Part, Row

SETTINGS = CleaningSettings()
BINS = SETTINGS.frequency_mhz
GRID_MHZ = np.arange(25.0, 86.0)
ROUNDING = 1.0 / 12.0 / 100.0
"""Density of the converter's rounding noise: 1/12 ADC^2 over 100 MHz."""


@cache
def band_shape(rms_adc: float = 15.0) -> Floats:
    """A resonant band of some r.m.s., ADC^2/MHz, on `GRID_MHZ`: steeper than the real one at both edges."""
    shape = (0.1 + 1 / (1 + ((GRID_MHZ - 58) / 5) ** 2)) / (1 + (GRID_MHZ / 78) ** 12)
    fine = draw_noise(shape, GRID_MHZ, 1 << 20, np.random.default_rng(0))
    return shape * (rms_adc / float(np.std(fine))) ** 2


def true_bins(density: Floats) -> Floats:
    """Expected power of every bin, ADC^2/MHz: the mean of what was drawn over each MHz, and the rounding noise."""
    step = np.arange(BINS[0] - 0.5, BINS[-1] + 0.5, 1e-3) + 5e-4
    drawn = np.exp(np.interp(step, GRID_MHZ, np.log(density)))
    return np.asarray(drawn.reshape(BINS.size, -1).mean(axis=1) + ROUNDING)


def trace_of(voltage: Floats, rcu: int, disturbances: Sequence[Transmitter | Shower] = ()) -> Trace:
    blocks = digitise(voltage, disturbances).reshape(-1, BLOCK_SAMPLES)
    reference = TraceReference(Path("simulated"), str(rcu), "CS011", rcu, 1_311_073_541, 7_283_712, 200e6)
    return Trace(reference, blocks, 7113 + np.arange(len(blocks)), np.ones(len(blocks), dtype=bool), {})


def measure(trace: Trace, settings: CleaningSettings = SETTINGS) -> PathBackground:
    return measure_traces([trace], settings, is_station=False)[0]


def power_of(background: PathBackground) -> Floats:
    """Power of every bin, ADC^2/MHz."""
    return background.power * SETTINGS.resistance_ohm


def _measure_everything(trace: Trace) -> PathBackground:
    """Measure a trace as if nobody had thought of pulses or of anything else that comes and goes."""
    from unittest.mock import patch

    everything = replace(
        select_background(trace), is_background=np.ones(len(trace.samples), dtype=bool), dropped={}, pulses=()
    )
    no_block = np.zeros(len(trace.samples), dtype=bool)
    with (
        patch("lbacal_core.traces.background.select_background", return_value=everything),
        patch("lbacal_core.traces.background.find_keyed_blocks", return_value=no_block),
    ):
        return measure(trace)


RMS_ADC = np.array([0.4, 0.5, 0.7, 1.0, 1.5, 3.0, 6.0, 15.0])
PEAKS = np.array([0.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0])


def try_noise(blocks: int, seed: int) -> Row:
    """A trace of noise alone: measured over true power of every bin, its theoretical noise, lines found in the band."""
    density, rng = band_shape(), np.random.default_rng([1, blocks, seed])
    found = measure(trace_of(draw_noise(density, GRID_MHZ, blocks * BLOCK_SAMPLES, rng), 10))
    theory = 1 / np.sqrt(found.blocks * effective_channels(bin_weights(found.channel_mhz, BINS, 1.0)))
    return {
        "ratio": np.round(power_of(found) / true_bins(density), 4).tolist(),
        "theory": round(float(np.sqrt(np.mean(theory**2))), 5),
        "false_lines": int(np.sum(np.abs(found.line_mhz - 55) < 25.5)),
    }


def noise_over_theory(rows: Sequence[Row]) -> float:
    """Measured scatter over the expected one, r.m.s. over the bins."""
    ratio = np.array([row["ratio"] for row in rows])
    return float(np.sqrt(np.mean((ratio.std(axis=0, ddof=1) / ratio.mean(axis=0) / rows[-1]["theory"]) ** 2)))


def judge_noise(rows: Sequence[Row]) -> list[Found]:
    bias, n = np.array([row["ratio"] for row in rows]) - 1, len(rows)
    # Neighbouring bins share channels: half of the 51 are counted as independent.
    ratio, draws = noise_over_theory(rows), n * BINS.size // 2
    return [
        mean_of("bias", bias.mean(axis=1), "%"),
        worst_of([mean_of("bin", one) for one in bias.T], n, "%"),
        One("scatter", ratio, partial(spread_interval, ratio, draws), n),
        rate_of("false_lines", sum(bool(row["false_lines"]) for row in rows), n),
    ]


def try_gains(seed: int, rms_adc: Floats = RMS_ADC, blocks: int = 400) -> Row:
    """Band power over true, without and with 1/12 ADC^2 of rounding noise in the truth, of a trace of each gain."""
    ratios, rng = np.zeros((2, rms_adc.size)), np.random.default_rng([30, seed])
    for row, rms in enumerate(rms_adc):
        density = band_shape(float(rms))
        truth = true_bins(density)
        power = power_of(measure(trace_of(draw_noise(density, GRID_MHZ, blocks * BLOCK_SAMPLES, rng), 10)))
        ratios[:, row] = power.sum() / np.array([np.sum(truth - ROUNDING), np.sum(truth)])
    return {"ratio": np.round(ratios, 5).tolist()}


def judge_gains(rows: Sequence[Row]) -> list[Found]:
    bias = np.array([row["ratio"][1] for row in rows]) - 1
    return [worst_of([mean_of("rounding", one) for one in bias[:, RMS_ADC >= 1.0].T], len(rows), "%")]


def try_pulses(seed: int, peaks: Floats = PEAKS, blocks: int = 400) -> Row:
    """Change of the band power by a pulse of each height, measured as we do and with the exclusion forgotten."""
    change, rng = np.zeros((2, peaks.size)), np.random.default_rng([40, seed])
    voltage = draw_noise(band_shape(), GRID_MHZ, blocks * BLOCK_SAMPLES, rng)
    sample = int(rng.integers(10 * BLOCK_SAMPLES, (blocks - 10) * BLOCK_SAMPLES))
    clean = power_of(measure(trace_of(voltage, 10))).sum()
    for row, peak in enumerate(peaks):
        trace = trace_of(voltage, 10, [Shower(sample, float(peak))])
        change[0, row] = power_of(measure(trace)).sum() / clean - 1
        change[1, row] = power_of(_measure_everything(trace)).sum() / clean - 1
    return {"change": np.round(change, 6).tolist()}


def judge_pulses(rows: Sequence[Row]) -> list[Found]:
    change = np.array([row["change"] for row in rows])
    leak = worst_of([mean_of("leak", one) for one in change[:, 0, 1:].T], len(rows), "%")
    return [leak, mean_of("forgotten", change[:, 1, -1], "%")]


PARTS = (
    Part("noise-400", partial(try_noise, 400), judge_noise, 800, headlines=("bias",)),
    Part("noise-100", partial(try_noise, 100), judge_noise, 800),
    Part("gain", try_gains, judge_gains, 200, has_figure=True),
    Part("pulse", try_pulses, judge_pulses, 40, has_figure=True),
)


def draw(rows: Mapping[str, Sequence[Row]]) -> dict[str, Figure]:
    """Low gain and pulses."""
    if not {"gain", "pulse"} <= set(rows):
        return {}
    ratios = np.array([row["ratio"] for row in rows["gain"]])
    errors = ratios.std(axis=0, ddof=1) / len(ratios) ** 0.5
    change = np.mean([row["change"] for row in rows["pulse"]], axis=0)
    figure = Figure(figsize=(9, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for k, (style, label) in enumerate((("o-", "over the analogue power"), ("s-", "over analogue + 1/12 ADC²"))):
        left.errorbar(RMS_ADC, 100 * (ratios[:, k].mean(axis=0) - 1), 100 * errors[k], fmt=style, label=label)
    left.set(xscale="log", xlabel="r.m.s. of the trace (ADC units)", ylabel="band power (%)", yscale="symlog")
    left.legend()
    right.plot(PEAKS / 15, 100 * change[0], "o-", label="±5 blocks excluded")
    right.plot(PEAKS / 15, 100 * change[1], "s-", label="exclusion forgotten")
    right.set(xlabel="peak of the pulse / r.m.s. of the noise", ylabel="change of the band power (%)", yscale="symlog")
    right.legend()
    return {"traces-gain-pulse.png": figure}
