"""Simulated traces: white or sloping noise, with what disturbs it."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from lbacal_core.traces.trace import BLOCK_SAMPLES, Trace, TraceReference
from lbacal_twin.voltages import Shower, Transmitter, digitise, draw_noise

FREQUENCY = np.arange(30.0, 81.0)
START_S = 1_311_073_541


def reference_of(rcu: int = 10, path: Path = Path("simulated.dat")) -> TraceReference:
    return TraceReference(path, str(rcu), "CS011", rcu, START_S, 7_283_712, 200e6)


def trace_of(samples: NDArray[np.int16], rcu: int = 10) -> Trace:
    blocks = samples[: samples.size // BLOCK_SAMPLES * BLOCK_SAMPLES].reshape(-1, BLOCK_SAMPLES)
    position = 7113 + np.arange(len(blocks), dtype=np.int64)
    return Trace(reference_of(rcu), blocks, position, np.ones(len(blocks), dtype=bool), {})


MakeTrace = Callable[..., Trace]


@pytest.fixture
def make_trace() -> MakeTrace:
    """A trace of noise of a density (ADC^2/MHz; 4 unless given) and disturbances."""

    def make(
        seed: int,
        blocks: int = 400,
        density: NDArray[np.float64] | None = None,
        disturbances: Sequence[Transmitter | Shower] = (),
    ) -> Trace:
        rng = np.random.default_rng(seed)
        level = np.full(FREQUENCY.size, 4.0) if density is None else density
        return trace_of(digitise(draw_noise(level, FREQUENCY, blocks * BLOCK_SAMPLES, rng), disturbances))

    return make
