"""Lines in traces: which are found, and what those that are not, and those that are, do to the power of their bin.

Voltages are simulated, digitised and measured back. The suite runs small instances of the same functions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from lbacal_core.grids import Floats
from lbacal_core.traces.background import PathBackground, measure_traces
from lbacal_core.traces.density import LARGEST_LEAK, bin_weights, line_response
from lbacal_core.traces.trace import BLOCK_SAMPLES
from lbacal_twin.voltages import SAMPLE_RATE_HZ, Transmitter, draw_noise
from validation.machinery.claims import Found, mean_of, rate_of, worst_of
from validation.machinery.parts import Part, Row
from validation.machinery.tables import write_table
from validation.traces import BINS, GRID_MHZ, ROUNDING, SETTINGS, band_shape, power_of, trace_of, true_bins

LINES_MHZ = np.arange(33.0, 80.0, 6.0)
"""Every trial has a line in each of these bins: on the flat, on both flanks of the resonance, and at both edges."""

LINE_BINS = (LINES_MHZ - BINS[0]).astype(int)


@dataclass(frozen=True)
class LineTrial:
    """The results for a line of each strength.

    Attributes
    ----------
    strength
        Shape (strength,): mean power of the line over the noise in 1 MHz.
    found
        Shape (strength, trial): share of the lines that were found.
    change
        Shape (strength, trial): measured power of the lines' bins over the true one, minus 1, mean of the bins and
        of the antennas, with the noise taken out that any estimate from the same clean channels would have.
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
        """Standard error of the bias, shape (strength,)."""
        return np.asarray(self.change.std(axis=1, ddof=1) / np.sqrt(self.change.shape[1]))

    @property
    def found_from(self) -> float:
        """Weakest strength from which on at least 95 % of the lines are found."""
        share = self.found.mean(axis=1)
        above = np.flatnonzero(np.minimum.accumulate(share[::-1])[::-1] >= 0.95)
        return float(self.strength[above[0]]) if above.size else float("inf")


KINDS = {
    "steady": Transmitter(50.0, 0.0),
    "drifting 50 kHz/ms": Transmitter(50.0, 0.0, drift_mhz_per_ms=0.05),
    "on 20 % of the time": Transmitter(50.0, 0.0, duty=0.2, period_s=4e-4),
}


def try_lines(
    kind: Transmitter, strengths: Floats, blocks: int, rng: np.random.Generator, antennas: int = 1
) -> tuple[Floats, Floats]:
    """Add lines of several strengths at random frequencies and phases to the same noise, and measure.

    The noise of a measurement hides a bias of 0.2 %, but most of it is known: the mean of the channels that a line of
    this frequency and strength cannot reach, in the same trace without lines, is off by the same noise and right on
    average, whatever the cleaning does. The measurement is compared with that.

    Returns
    -------
    Share of the lines found, and change of the power of their bins, shape (strength,).
    """
    density = band_shape()
    truth = true_bins(density)[LINE_BINS]
    found, change = np.zeros(strengths.size), np.zeros(strengths.size)
    samples = blocks * BLOCK_SAMPLES
    frequencies = LINES_MHZ + rng.uniform(-0.4, 0.3, LINES_MHZ.size)
    voltages, carriers = [], []
    for _ in range(antennas):
        voltages.append(draw_noise(density, GRID_MHZ, samples, rng))
        phases = rng.uniform(0, 2 * np.pi, LINES_MHZ.size)
        lines = [
            replace(kind, frequency_mhz=float(f), mean_square=float(p) / kind.duty, phase=float(phase))
            for f, p, phase in zip(frequencies, truth, phases, strict=True)
        ]
        carriers.append(np.sum([line.voltage(samples, SAMPLE_RATE_HZ) for line in lines], axis=0))
    clean = measure_together(voltages)
    middle = frequencies + kind.drift_mhz_per_ms * samples / SAMPLE_RATE_HZ * 1e3 / 2.0
    reach = abs(middle - frequencies)
    for row, strength in enumerate(strengths):
        expected = [_power_of_unreached(item, density, middle, reach, float(strength)) for item in clean]
        amplitude = np.sqrt(strength)
        results = measure_together(
            [voltage + amplitude * carrier for voltage, carrier in zip(voltages, carriers, strict=True)]
        )
        is_silenced = [bool(result.dropped) for result in results]  # left out as pulses, bursts or keying
        near = [np.any(np.abs(r.line_mhz[:, None] - middle) < 0.3 + reach, axis=0) for r in results]
        found[row] = np.mean([1.0 if s else np.mean(n) for s, n in zip(is_silenced, near, strict=True)])
        powers = np.array([power_of(result)[LINE_BINS] for result in results])
        change[row] = np.mean((powers - np.array(expected)) / truth)
    return found, change


def _power_of_unreached(
    clean: PathBackground, density: Floats, line_mhz: Floats, half_mhz: Floats, strength: float
) -> Floats:
    """Power of the lines' bins in a trace without lines, from the channels that a line would not reach."""
    shape = np.exp(np.interp(clean.channel_mhz, GRID_MHZ, np.log(density))) + ROUNDING
    width = clean.channel_mhz[1] - clean.channel_mhz[0]
    path = line_mhz[:, None] + half_mhz[:, None] * np.linspace(-1, 1, 9)
    offset = (clean.channel_mhz[:, None, None] - path) / width
    level = strength * true_bins(density)[LINE_BINS] / width
    leak = (line_response(offset).mean(axis=2) @ level) / shape
    weights = bin_weights(clean.channel_mhz, BINS, 1.0)[LINE_BINS]
    kept = weights * (leak < LARGEST_LEAK)
    kept = np.where(kept.sum(axis=1, keepdims=True) > 0.5, kept, weights)
    expected = weights @ shape / weights.sum(axis=1)
    return np.asarray(expected * (kept @ clean.density) / (kept @ shape))


def measure_together(voltages: Sequence[Floats]) -> list[PathBackground]:
    traces = (trace_of(voltage, 2 * number) for number, voltage in enumerate(voltages))
    return measure_traces(traces, SETTINGS, is_station=len(voltages) > 1)


@dataclass(frozen=True)
class LineClaim:
    """The claim about lines of one kind: from `limit` on (power over the noise in 1 MHz) they are found.

    `allowed` is the bias that they leave then.
    """

    kind: str
    blocks: int
    antennas: int
    trials: int
    limit: float
    below: tuple[float, ...]
    above: tuple[float, ...]
    allowed: float = 0.002

    @property
    def short(self) -> str:
        """One word, joined by hyphens."""
        kind = self.kind.partition(" ")[0].replace("on", "switched") if self.kind != "steady" else self.kind
        return f"{kind}-{self.blocks}-{self.antennas}"

    @property
    def name(self) -> str:
        """The case in words."""
        plural = "s" * (self.antennas > 1)
        return f"{self.kind}, {self.blocks * BLOCK_SAMPLES / 2e5:.1f} ms, {self.antennas} antenna{plural}"


CLAIMS = (
    LineClaim("steady", 400, 1, 300, 0.05, (0.006, 0.012, 0.025, 0.04), (0.05, 0.08, 0.3, 2.0, 20.0)),
    LineClaim("steady", 2000, 1, 100, 0.025, (0.006, 0.012, 0.018), (0.025, 0.08, 2.0, 20.0)),
    LineClaim("steady", 400, 12, 60, 0.012, (0.003, 0.006, 0.009), (0.012, 0.03, 0.3, 20.0)),
    LineClaim("drifting 50 kHz/ms", 400, 1, 300, 0.15, (0.012, 0.04, 0.08, 0.11), (0.15, 0.3, 2.0, 20.0)),
    LineClaim("on 20 % of the time", 400, 1, 300, 0.07, (0.012, 0.025, 0.045), (0.07, 0.2, 0.5, 1.0, 2.0, 20.0), 0.004),
)
"""Lines that are switched are claimed to 0.4 %: those too weak to be seen in single blocks spread over their bin."""


def try_claim(claim: LineClaim, seed: int) -> Row:
    strengths = np.array(claim.below + claim.above)
    rng = np.random.default_rng([10, CLAIMS.index(claim), seed])
    found, change = try_lines(KINDS[claim.kind], strengths, claim.blocks, rng, claim.antennas)
    return {"found": np.round(found, 4).tolist(), "change": np.round(change, 6).tolist()}


def collect(claim: LineClaim, rows: Sequence[Row]) -> LineTrial:
    found, change = (np.array([row[name] for row in rows]).T for name in ("found", "change"))
    return LineTrial(np.array(claim.below + claim.above), found, change)


def judge_lines(claim: LineClaim, rows: Sequence[Row]) -> list[Found]:
    trial, lines = collect(claim, rows), len(rows) * LINES_MHZ.size
    above = trial.strength >= claim.limit
    shares = trial.found[above].mean(axis=1)
    return [
        worst_of([rate_of("found", round(x * lines), lines) for x in shares], len(rows), "%"),
        worst_of([mean_of("bias", one) for one in trial.change[above]], len(rows), "%"),
    ]


WIDE = np.array([0.05, 0.1, 0.2, 0.3, 0.5, 1.0])
"""Density of noise-like interference over that of the noise."""
WIDTH_MHZ, WIDE_BLOCKS = 0.8, 400
WIDE_LIMITS = {1: 1.0, 12: 0.3}
"""Density from which on it is found, by the number of antennas."""


def try_bands(antennas: int, seed: int, strengths: Floats = WIDE) -> Row:
    """Add bands of noise from one far transmitter (the same in all antennas, delayed) to one trace, and measure.

    The share of the bands of which something is flagged, and the bias of their bins, strength by strength.
    """
    density, rng = band_shape(), np.random.default_rng([50, antennas, seed])
    samples = WIDE_BLOCKS * BLOCK_SAMPLES
    found, change = np.zeros(strengths.size), np.zeros(strengths.size)
    centres = LINES_MHZ[1::2]
    bins = (centres - BINS[0]).astype(int)
    fine_mhz = np.arange(GRID_MHZ[0], GRID_MHZ[-1], 0.02)
    is_in = np.any(np.abs(fine_mhz[:, None] - centres) < WIDTH_MHZ / 2, axis=1)
    shape = np.exp(np.interp(fine_mhz, GRID_MHZ, np.log(density))) * np.where(is_in, 1.0, 1e-12)
    band = draw_noise(shape, fine_mhz, samples, rng)
    voltages = [draw_noise(density, GRID_MHZ, samples, rng) for _ in range(antennas)]
    bands = [np.roll(band, int(delay)) for delay in rng.integers(0, 12, antennas)]  # 0 to 60 ns
    clean = measure_together(voltages)
    for row, strength in enumerate(strengths):
        results = measure_together([v + np.sqrt(strength) * b for v, b in zip(voltages, bands, strict=True)])
        near = [np.any(np.abs(r.line_mhz[:, None] - centres) < WIDTH_MHZ / 2 + 0.1, axis=0) for r in results]
        found[row] = np.mean(near)
        ratios = [power_of(r)[bins] / power_of(c)[bins] for r, c in zip(results, clean, strict=True)]
        change[row] = np.mean(ratios) - 1.0
    return {"found": np.round(found, 4).tolist(), "change": np.round(change, 6).tolist()}


def judge_bands(antennas: int, rows: Sequence[Row]) -> list[Found]:
    share = np.array([row["found"] for row in rows]).mean(axis=0)[WIDE_LIMITS[antennas] <= WIDE]
    bands = len(rows) * LINES_MHZ[1::2].size
    return [worst_of([rate_of("found", round(x * bands), bands) for x in share], len(rows), "%")]


PARTS = (
    *(
        Part(
            claim.short, partial(try_claim, claim), partial(judge_lines, claim), claim.trials,
            headlines=("found",) if claim is CLAIMS[0] else (), has_figure=True,
        )
        for claim in CLAIMS
    ),
    Part("wide-1", partial(try_bands, 1), partial(judge_bands, 1), 48, has_figure=True),
    Part("wide-12", partial(try_bands, 12), partial(judge_bands, 12), 24, has_figure=True),
)  # fmt: skip


def table_of_lines(rows: Mapping[str, Sequence[Row]]) -> list[str]:
    """Tabulate every kind of line, for the page on traces."""
    if not {claim.short for claim in CLAIMS} <= set(rows):
        return []
    table = []
    for claim in CLAIMS:
        trial = collect(claim, rows[claim.short])
        words = [f"{100 * b:+.2f} ± {196 * e:.2f} %" for b, e in zip(trial.bias, trial.bias_error, strict=True)]
        at = len(claim.below)
        above = at + 1 + int(np.argmax(np.abs(trial.bias[at + 1 :])))
        cells = (
            f"{claim.name}, {len(rows[claim.short])} traces",
            f"{100 * trial.found_from:g} %",
            f"{100 * claim.limit:g} %",
            words[at],
            words[above],
            f"{100 * np.max(trial.bias[:at]):.1f} %",
        )
        table.append(cells)
    head = ("line", "95 % found from", "stated limit", "bias at the limit", "largest bias above", "largest bias below")
    return write_table(head, table)


def table_of_bands(rows: Mapping[str, Sequence[Row]]) -> list[str]:
    """Tabulate wide interference, for the page on traces."""
    if not {"wide-1", "wide-12"} <= set(rows):
        return []
    table = []
    for name in ("wide-1", "wide-12"):
        found, change = (np.mean([row[key] for row in rows[name]], axis=0) for key in ("found", "change"))
        cells = [f"{100 * f:.0f} %, {100 * c:+.1f} %" for f, c in zip(found, change, strict=True)]
        table.append([name.removeprefix("wide-"), *cells])
    return write_table(["antennas", *(f"{density:g}" for density in WIDE)], table)


TABLES = {"lines": table_of_lines, "bands": table_of_bands}


def draw(rows: Mapping[str, Sequence[Row]]) -> dict[str, Figure]:
    """Lines found, and what they do to the power of their bin."""
    measured = [(claim, collect(claim, rows[claim.short])) for claim in CLAIMS if claim.short in rows]
    if len(measured) < len(CLAIMS):
        return {}
    figure = Figure(figsize=(9, 8), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    for claim, trial in measured:
        top.semilogx(100 * trial.strength, trial.found.mean(axis=1), "o-", ms=3, label=claim.name)
        reach = 196 * trial.bias_error
        bottom.errorbar(100 * trial.strength, 100 * trial.bias, reach, fmt="o-", ms=3, capsize=2)
    weak = np.geomspace(0.2, 6.0, 20)
    bottom.plot(weak, weak, "k:", label="no cleaning at all")
    bottom.set(ylim=(-1, 4), xlabel="power of the line / noise in 1 MHz (%)", ylabel="bias of its bin (%)")
    bottom.axhspan(-0.2, 0.2, color="0.85", label="±0.2 %")
    bottom.legend()
    top.set(ylabel="share found", title="Lines found, and what they do to the power of their bin")
    top.legend()
    return {"traces-lines.png": figure}
