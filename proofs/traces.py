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
from numpy.typing import NDArray

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

LINES_MHZ = np.arange(33.0, 80.0, 6.0)
"""Every trial has a line in each of these bins: on the flat, on both flanks of the resonance, and at both edges."""

LINE_BINS = (LINES_MHZ - BINS[0]).astype(int)


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


@dataclass(frozen=True)
class LineTrial:
    """What a line of each strength did.

    Attributes
    ----------
    strength
        Shape (strength,): mean power of the line over the noise in 1 MHz.
    found
        Shape (strength,): share of the lines that were found.
    change
        Shape (strength, trial): change of the lines' bins against the same trace without lines, relative, mean of the
        bins.
    """

    strength: Floats
    found: Floats
    change: Floats

    @property
    def bias(self) -> Floats:
        """Mean change at every strength, shape (strength,)."""
        return np.asarray(self.change.mean(axis=1))

    @property
    def bias_error(self) -> Floats:
        """Its standard error, shape (strength,)."""
        return np.asarray(self.change.std(axis=1, ddof=1) / np.sqrt(self.change.shape[1]))

    def mean_bias(self, is_meant: NDArray[np.bool_]) -> tuple[float, float]:
        """Mean over some strengths, and its error from the scatter between trials (strengths share their noise)."""
        if not np.any(is_meant):
            return 0.0, float("inf")
        of_trial = self.change[is_meant].mean(axis=0)
        return float(of_trial.mean()), float(of_trial.std(ddof=1) / np.sqrt(of_trial.size))

    @property
    def limit(self) -> float:
        """Strength from which on at least 95 % are found (interpolated in the logarithm)."""
        above = np.flatnonzero(np.minimum.accumulate(self.found[::-1])[::-1] >= 0.95)
        if above.size == 0 or above[0] == 0:
            return float(self.strength[above[0]]) if above.size else float("inf")
        k = above[0]
        low, high = self.found[k - 1], self.found[k]
        share = (0.95 - low) / (high - low) if high > low else 1.0
        return float(np.exp(np.interp(share, [0, 1], np.log(self.strength[k - 1 : k + 1]))))


KINDS = {
    "steady": Transmitter(50.0, 0.0),
    "drifting 50 kHz/ms": Transmitter(50.0, 0.0, drift_mhz_per_ms=0.05),
    "on 20 % of the time": Transmitter(50.0, 0.0, duty=0.2, period_s=4e-4),
}


def try_lines(
    kind: Transmitter, strengths: Floats, trials: int, blocks: int, seed: int, antennas: int = 1
) -> LineTrial:
    """Add lines of several strengths at random frequencies and phases to the same noise, and measure."""
    density = band_shape()
    truth = true_bins(density)[LINE_BINS]
    found = np.zeros((strengths.size, trials))
    change = np.zeros((strengths.size, trials))
    for number in range(trials):
        rng = np.random.default_rng([seed, number])
        frequencies = LINES_MHZ + rng.uniform(-0.4, 0.3, LINES_MHZ.size)
        voltages = [draw_noise(density, GRID_MHZ, blocks * BLOCK_SAMPLES, rng) for _ in range(antennas)]
        phases = rng.uniform(0, 2 * np.pi, (antennas, LINES_MHZ.size))
        clean = _measure_together(voltages, [() for _ in voltages])[0]
        for row, strength in enumerate(strengths):
            mean_squares = strength * truth / kind.duty
            lines = [
                [
                    replace(kind, frequency_mhz=float(f), mean_square=float(p), phase=float(phase))
                    for f, p, phase in zip(frequencies, mean_squares, of_antenna, strict=True)
                ]
                for of_antenna in phases
            ]
            result = _measure_together(voltages, lines)[0]
            near = np.abs(result.line_mhz[:, None] - frequencies - kind.drift_mhz_per_ms) < 0.3
            is_silenced = bool(result.dropped)  # its blocks are left out as pulses, bursts or keying
            found[row, number] = 1.0 if is_silenced else np.mean(np.any(near, axis=0))
            change[row, number] = np.mean((power_of(result) - power_of(clean))[LINE_BINS] / truth)
    return LineTrial(strengths, found.mean(axis=1), change)


def _measure_together(
    voltages: Sequence[Floats], disturbances: Sequence[Sequence[Transmitter | Shower]]
) -> list[PathBackground]:
    traces = (trace_of(v, 2 * k, d) for k, (v, d) in enumerate(zip(voltages, disturbances, strict=True)))
    return measure_traces(traces, SETTINGS, is_station=len(voltages) > 1)


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
    holds &= _prove_lines(thin, lines)
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


def _prove_lines(thin: int, lines: list[str]) -> bool:
    strengths = np.array([0.006, 0.012, 0.025, 0.045, 0.08, 0.2, 1.0, 10.0, 50.0])
    figure = Figure(figsize=(9, 8), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    lines += [
        "",
        "| line | blocks | antennas | 95 % found from | mean bias above | worst bias above | worst bias below |",
    ]
    lines.append("|---|---|---|---|---|---|---|")
    holds = True
    cases = [(name, 400, 1) for name in KINDS] + [("steady", 2000, 1), ("steady", 400, 12)]
    for number, (name, blocks, antennas) in enumerate(cases):
        trials = max(4, (24 if antennas == 1 and blocks == 400 else 10) // thin)
        trial = try_lines(KINDS[name], strengths, trials, blocks, 10 + number, antennas)
        above = strengths >= trial.limit
        worst_above = np.argmax(np.abs(trial.bias) * above)
        worst_below = np.argmax(np.abs(trial.bias) * ~above)
        mean, mean_error = trial.mean_bias(above)
        holds &= name != "steady" or abs(mean) < 0.002 + 2 * mean_error
        lines.append(
            f"| {name} | {blocks} | {antennas} | {100 * trial.limit:.1f} % | "
            f"{100 * mean:+.2f} ± {100 * mean_error:.2f} % | "
            f"{100 * trial.bias[worst_above]:+.2f} ± {100 * trial.bias_error[worst_above]:.2f} % | "
            f"{100 * trial.bias[worst_below]:+.2f} ± {100 * trial.bias_error[worst_below]:.2f} % |"
        )
        label = f"{name}, {blocks * BLOCK_SAMPLES / 2e5:.1f} ms, {antennas} antenna{'s' * (antennas > 1)}"
        top.semilogx(100 * strengths, trial.found, "o-", ms=3, label=label)
        bottom.errorbar(100 * strengths, 100 * trial.bias, 100 * trial.bias_error, fmt="o-", ms=3, capsize=2)
    bottom.plot(100 * strengths, 100 * strengths, "k:", label="no cleaning at all")
    bottom.set(ylim=(-1.5, 6), xlabel="power of the line / noise in 1 MHz (%)", ylabel="bias of its bin (%)")
    bottom.axhspan(-0.2, 0.2, color="0.85", label="±0.2 %")
    bottom.legend()
    top.set(ylabel="share found", title="Lines found, and what they do to the power of their bin")
    top.legend()
    IMAGES.mkdir(exist_ok=True)
    figure.savefig(IMAGES / "traces-lines.png", dpi=110)
    return holds


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
