"""How fast traces become spectra, against a bare FFT of the same samples and against reading the files.

Run: OPENBLAS_NUM_THREADS=1 .venv/bin/python -m validation.benchmarks.traces  (one core, half a minute)
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import scipy.fft

from lbacal_core.traces.background import CleaningSettings, measure_background, measure_traces
from lbacal_core.traces.density import FACTORS, find_segments, transform_segments, transform_trace
from lbacal_core.traces.trace import BLOCK_SAMPLES, TraceReference, group_traces, list_traces, read_trace
from lbacal_twin.voltages import SAMPLE_RATE_HZ, Transmitter, digitise, draw_noise, write_frames
from validation.benchmarks.timing import processor_times

ANTENNAS = 24
BLOCKS = 410  # 2.1 ms
ROUNDS = 7
BAND_MHZ = np.arange(30.0, 81.0)
CAMPAIGN_BYTES = 3e12


def main() -> None:
    """Time the steps on one simulated station event and print a table."""
    rng = np.random.default_rng(1)
    settings = CleaningSettings()
    with tempfile.TemporaryDirectory() as name:
        for rcu in range(ANTENNAS):
            path = Path(name) / f"{rcu:02d}.dat"
            voltage = draw_noise(np.full(51, 4.0), BAND_MHZ, BLOCKS * BLOCK_SAMPLES, rng)
            samples = digitise(
                voltage, [Transmitter(f, 9.0, phase=float(rng.uniform(0, 6))) for f in (21.5, 53.7, 62.2)]
            )
            reference = TraceReference(path, str(rcu), "CS002", rcu, 1_400_000_000, 0, SAMPLE_RATE_HZ)
            write_frames(path, samples, reference, 2)
        references = [reference for path in sorted(Path(name).glob("*.dat")) for reference in list_traces(path)]
        (event,) = group_traces(references)
        traces = [read_trace(reference) for reference in references]
        blocks = [trace.samples.astype(np.float32) for trace in traces]
        whole = BLOCKS // FACTORS[0] * FACTORS[0]
        segments = [samples[:whole].reshape(-1, FACTORS[0] * BLOCK_SAMPLES) for samples in blocks]
        band = slice(140, 424)  # 27.5 to 82.5 MHz
        rows, _ = find_segments(np.arange(BLOCKS))
        steps = {
            "bare FFT, blocks of 1024, float32 in memory": lambda: [scipy.fft.rfft(b, axis=1) for b in blocks],
            "bare FFT, segments of 16 blocks (the line search)": lambda: [scipy.fft.rfft(s, axis=1) for s in segments],
            "both, with window, power and conversion from int16": lambda: [
                (transform_trace(t.samples, band), transform_segments(t.samples, rows, band, 200e6, keep=False))
                for t in traces
            ],
            "cleaning and averaging, samples in memory": lambda: measure_traces(iter(traces), settings),
            "reading the bytes": lambda: [reference.path.read_bytes() for reference in references],
            "reading frames with their checksums": lambda: [read_trace(reference) for reference in references],
            "files to spectra, all of it": lambda: measure_background(event.references, settings),
        }
        megabytes = sum(trace.samples.nbytes for trace in traces) / 1e6
        seconds = processor_times(steps, ROUNDS)
    bare = next(iter(seconds.values()))
    print(f"{ANTENNAS} traces of {BLOCKS} blocks, {megabytes:.1f} MB, one core, processor time, best of {ROUNDS}")
    print("| step | MB/s | speed / bare FFT |\n|---|---|---|")
    for step, value in seconds.items():
        print(f"| {step} | {megabytes / value:.0f} | {100 * bare / value:.0f} % |")
    everything = list(seconds.values())[-1]
    hours = CAMPAIGN_BYTES / 1e6 / (megabytes / everything) / 3600
    print(f"3 TB of traces: {hours:.1f} core hours")


if __name__ == "__main__":
    main()
