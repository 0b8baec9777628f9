"""Spectra from traces: unbiased, as noisy as theory says, which lines are found, and whether pulses leak.

`./dev prove traces` simulates voltages, digitises them and measures them back; it draws the curves of
docs/explanation/traces.md into docs/images/. The suite runs small instances of the same functions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from lbacal_core.grids import Floats
from lbacal_core.traces.background import CleaningSettings, PathBackground, measure_traces
from lbacal_core.traces.density import bin_weights, effective_channels
from lbacal_core.traces.selection import select_background
from lbacal_core.traces.trace import BLOCK_SAMPLES, Trace, TraceReference
from lbacal_core.twin.voltages import Shower, Transmitter, digitise, draw_noise

IMAGES = Path(__file__).parents[1] / "docs" / "images"
SETTINGS = CleaningSettings()
BINS = SETTINGS.frequency_mhz
GRID_MHZ = np.arange(25.0, 86.0)
ROUNDING = 1.0 / 12.0 / 100.0
"""Density of the converter's rounding noise: 1/12 ADC^2 over 100 MHz."""


def band_shape(rms_adc: float = 15.0) -> Floats:
    """A resonant band of some r.m.s., ADC^2/MHz, on `GRID_MHZ`: steeper than the real one at both edges."""
    shape = (0.1 + 1 / (1 + ((GRID_MHZ - 58) / 5) ** 2)) / (1 + (GRID_MHZ / 78) ** 12)
    fine = draw_noise(shape, GRID_MHZ, 1 << 20, np.random.default_rng(0))
    return shape * (rms_adc / float(np.std(fine))) ** 2


def true_bins(density: Floats) -> Floats:
    """Expected power of every bin, ADC^2/MHz: the mean of what was drawn over each MHz, and the rounding noise."""
    step = np.arange(BINS[0] - 0.5, BINS[-1] + 0.5, 1e-3) + 5e-4
    drawn = np.exp(np.interp(step, GRID_MHZ, np.log(density)))
    return drawn.reshape(BINS.size, -1).mean(axis=1) + ROUNDING


def trace_of(voltage: Floats, rcu: int, disturbances: Sequence[Transmitter | Shower] = ()) -> Trace:
    """Digitise a voltage into a trace."""
    blocks = digitise(voltage, disturbances).reshape(-1, BLOCK_SAMPLES)
    reference = TraceReference(Path("simulated"), str(rcu), "CS011", rcu, 1_311_073_541, 7_283_712, 200e6)
    return Trace(reference, blocks, 7113 + np.arange(len(blocks)), np.ones(len(blocks), dtype=bool), {})


def measure(trace: Trace, settings: CleaningSettings = SETTINGS) -> PathBackground:
    """Measure one trace by itself."""
    return measure_traces([trace], settings, is_station=False)[0]


def power_of(background: PathBackground) -> Floats:
    """Power of every bin, ADC^2/MHz."""
    return background.power * SETTINGS.resistance_ohm


@dataclass(frozen=True)
class NoiseTrial:
    """What `trials` traces of pure noise gave.

    Attributes
    ----------
    ratio
        Shape (trial, freq), measured over true power.
    theory
        Shape (freq,), expected relative noise.
    false_lines
        Lines found in the band, of all trials.
    """

    ratio: Floats
    theory: Floats
    false_lines: int

    @property
    def bias(self) -> tuple[float, float]:
        """Mean of measured over true minus 1, over the band, and its error."""
        band = self.ratio.mean(axis=1)
        return float(band.mean() - 1), float(band.std(ddof=1) / np.sqrt(len(band)))

    @property
    def worst_bin(self) -> tuple[float, float]:
        """The bin furthest from 1: its bias, and the error of one bin."""
        bias = self.ratio.mean(axis=0) - 1
        error = self.ratio.std(axis=0, ddof=1) / np.sqrt(len(self.ratio))
        return float(bias[np.argmax(np.abs(bias))]), float(error.mean())

    @property
    def noise_over_theory(self) -> float:
        """Measured scatter over the expected one, r.m.s. over the bins."""
        scatter = self.ratio.std(axis=0, ddof=1) / self.ratio.mean(axis=0)
        return float(np.sqrt(np.mean((scatter / self.theory) ** 2)))


def try_noise(trials: int, blocks: int, seed: int, rms_adc: float = 15.0) -> NoiseTrial:
    """Measure traces of noise alone."""
    density = band_shape(rms_adc)
    truth = true_bins(density)
    rows, false_lines = [], 0
    theory = np.zeros(BINS.size)
    for number in range(trials):
        rng = np.random.default_rng([seed, number])
        found = measure(trace_of(draw_noise(density, GRID_MHZ, blocks * BLOCK_SAMPLES, rng), 10))
        rows.append(power_of(found) / truth)
        false_lines += int(np.sum(np.abs(found.line_mhz - 55) < 25.5))
        theory = 1 / np.sqrt(found.blocks * effective_channels(bin_weights(found.channel_mhz, BINS, 1.0)))
    return NoiseTrial(np.array(rows), theory, false_lines)


def try_gains(rms_adc: Floats, trials: int, blocks: int, seed: int) -> tuple[Floats, Floats]:
    """Band power measured over true, without and with 1/12 ADC^2 of rounding noise in the truth, shape (2, gain).

    Returns
    -------
    The ratios and their errors.
    """
    ratios = np.zeros((2, rms_adc.size, trials))
    for row, rms in enumerate(rms_adc):
        density = band_shape(float(rms))
        truth = true_bins(density)
        for number in range(trials):
            rng = np.random.default_rng([seed, row, number])
            power = power_of(measure(trace_of(draw_noise(density, GRID_MHZ, blocks * BLOCK_SAMPLES, rng), 10)))
            ratios[:, row, number] = power.sum() / np.array([np.sum(truth - ROUNDING), np.sum(truth)])
    return ratios.mean(axis=2), ratios.std(axis=2, ddof=1) / np.sqrt(trials)


def try_pulses(peaks: Floats, trials: int, blocks: int, seed: int) -> Floats:
    """Change of the band power by a pulse, measured as we do and with the exclusion forgotten, shape (2, peak)."""
    density = band_shape()
    change = np.zeros((2, peaks.size, trials))
    for number in range(trials):
        rng = np.random.default_rng([seed, number])
        voltage = draw_noise(density, GRID_MHZ, blocks * BLOCK_SAMPLES, rng)
        sample = int(rng.integers(10 * BLOCK_SAMPLES, (blocks - 10) * BLOCK_SAMPLES))
        clean = power_of(measure(trace_of(voltage, 10))).sum()
        for row, peak in enumerate(peaks):
            trace = trace_of(voltage, 10, [Shower(sample, float(peak))])
            change[0, row, number] = power_of(measure(trace)).sum() / clean - 1
            change[1, row, number] = power_of(_measure_everything(trace)).sum() / clean - 1
    return change.mean(axis=2)


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


def prove(arguments: list[str]) -> tuple[bool, list[str]]:
    """Run everything; with an argument, that many times fewer trials."""
    thin = int(arguments[0]) if arguments else 1
    lines: list[str] = []
    holds = _prove_noise(thin, lines)
    holds &= _prove_gains_and_pulses(thin, lines)
    return holds, lines


def _prove_noise(thin: int, lines: list[str]) -> bool:
    trial = try_noise(800 // thin, 400, seed=1)
    hundred = try_noise(400 // thin, 100, seed=2)
    (bias, error), (worst, bin_error) = trial.bias, trial.worst_bin
    lines.append(f"Noise alone, {len(trial.ratio)} traces of 400 blocks (2.1 ms):")
    lines.append(f"- bias of the band power {100 * bias:+.3f} ± {100 * error:.3f} %")
    lines.append(f"- worst of 51 bins {100 * worst:+.2f} %, error of a bin {100 * bin_error:.2f} %")
    for blocks, one in ((400, trial), (100, hundred)):
        theory = f"{100 * one.theory.mean():.2f} % in 1 MHz"
        lines.append(f"- noise over theory {one.noise_over_theory:.4f} ({blocks} blocks, theory {theory})")
    lines.append(f"- lines found where there are none: {trial.false_lines} in {len(trial.ratio)} traces")
    return abs(bias) < 0.002 + 2 * error and all(abs(t.noise_over_theory - 1) < 0.03 for t in (trial, hundred))


def _prove_gains_and_pulses(thin: int, lines: list[str]) -> bool:
    rms = np.array([0.4, 0.5, 0.7, 1.0, 1.5, 3.0, 6.0, 15.0])
    ratios, errors = try_gains(rms, max(4, 24 // thin), 400, seed=30)
    peaks = np.array([0.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0])
    change = try_pulses(peaks, max(4, 12 // thin), 400, seed=40)
    figure = Figure(figsize=(9, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.errorbar(rms, 100 * (ratios[0] - 1), 100 * errors[0], fmt="o-", label="over the analogue power")
    left.errorbar(rms, 100 * (ratios[1] - 1), 100 * errors[1], fmt="s-", label="over analogue + 1/12 ADC²")
    left.set(xscale="log", xlabel="r.m.s. of the trace (ADC units)", ylabel="band power (%)", yscale="symlog")
    left.legend()
    right.plot(peaks / 15, 100 * change[0], "o-", label="±5 blocks excluded")
    right.plot(peaks / 15, 100 * change[1], "s-", label="exclusion forgotten")
    right.set(xlabel="peak of the pulse / r.m.s. of the noise", ylabel="change of the band power (%)", yscale="symlog")
    right.legend()
    figure.savefig(IMAGES / "traces-gain-pulse.png", dpi=110)
    of_gain = [
        f"{r:g}: {100 * (x - 1):+.2f} ± {100 * e:.2f} %" for r, x, e in zip(rms, ratios[1], errors[1], strict=True)
    ]
    measured, forgotten = (", ".join(f"{100 * value:+.3f} %" for value in row) for row in change)
    lines += [
        "",
        "Band power over true power + 1/12 ADC² of rounding noise, by r.m.s. of the trace: " + ", ".join(of_gain),
    ]
    lines.append(f"Change by a pulse of a peak of 0 to 133 sigma: {measured}; exclusion forgotten: {forgotten}")
    loud = rms >= 1.0
    return bool(
        np.all(np.abs(ratios[1][loud] - 1) < 0.002 + 2 * errors[1][loud])
        and np.all(np.abs(change[0]) < 0.002)
        and change[1][-1] > 0.02
    )
