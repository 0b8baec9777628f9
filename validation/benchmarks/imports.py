"""How fast station statistics are averaged, against only reading the file, and what memory a longer file takes.

Run: OPENBLAS_NUM_THREADS=1 .venv/bin/python -m validation.benchmarks.imports  (one core, half a minute)
"""

from __future__ import annotations

import multiprocessing
import resource
import tempfile
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path

import h5py
import numpy as np

from lbacal_core.readers.open import choose_channels, open_source
from lbacal_core.readers.source import average
from validation.benchmarks.timing import processor_times

INPUTS, SUB_BANDS, CLOCK_HZ = 96, 512, 200e6
SHORT_S, LONG_S = 300, 1200
DAY_S = 86_400
START = datetime(2025, 3, 1, tzinfo=UTC)


def write_statistics(path: Path, seconds: int, inputs: int = INPUTS) -> None:
    sums = np.random.default_rng(1).uniform(1e6, 2e6, (inputs, SUB_BANDS)).astype(np.float32)
    with h5py.File(path, "w") as file:
        file.attrs.update({"data_type": "SST", "writer_version": "1.0.8", "station_name": "CS001"})
        for second in range(seconds):
            instant = START + timedelta(seconds=second)
            dataset = file.create_dataset(f"SST_{instant:%Y-%m-%dT%H:%M:%S}.000", data=sums)
            dataset.attrs["timestamp"], dataset.attrs["integration_time"] = instant.isoformat(), 1.0
            dataset.attrs["frequencies"] = np.arange(SUB_BANDS) * CLOCK_HZ / 2 / SUB_BANDS


def read_only(path: Path) -> None:
    with h5py.File(path, "r") as file:
        for dataset in file.values():
            dataset[()]


def average_file(path: Path) -> None:
    """Average a file as `lbacal import --average 900 --channel-mhz 1 --band 30 80` does."""
    source = open_source(path)
    average(source, 900.0, choose_channels(source, band_mhz=(30, 80), width_mhz=1.0))


def peak_mebibytes(path: Path) -> float:
    """Peak memory of this process after it averaged a file."""
    average_file(path)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        short, long = Path(folder) / "short.h5", Path(folder) / "long.h5"
        write_statistics(short, SHORT_S)
        write_statistics(long, LONG_S)
        works = {"read": lambda: read_only(short), "whole": lambda: average_file(short)}
        read, whole = processor_times(works).values()
        print(f"{INPUTS} paths x {SUB_BANDS} sub-bands, one a second: averaging takes {whole / read:.1f} times reading")
        print(f"{SHORT_S / whole:.0f} s of data in a second of one core: a day in {DAY_S * whole / SHORT_S:.0f} s")
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(1, context, max_tasks_per_child=1) as workers:  # a process of its own for each
            sizes = list(workers.map(peak_mebibytes, (short, long)))
        print(f"peak memory: {sizes[0]:.0f} MiB for {SHORT_S} s, {sizes[1]:.0f} MiB for {LONG_S} s")


if __name__ == "__main__":
    main()
