"""How long an audit of a day takes, and its quick part, against the fit of the same spectra.

Run: OPENBLAS_NUM_THREADS=1 .venv/bin/python -m validation.benchmarks.audit  (one core, half a minute)
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from lbacal_core.audit.audit import audit, audit_quickly
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.pipeline import calibrate
from lbacal_core.skypower.model import compute_sky_power
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings

ANTENNAS, INSTANTS = 48, 96
ROUNDS = 3


def shortest(work: Callable[[], object]) -> float:
    """Shortest processor time of some rounds, s."""
    times = []
    for _ in range(ROUNDS):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def main() -> None:
    instrument = load_instrument("lofar-superterp")
    settings = TwinSettings(
        years=1 / 365.25, events_per_year=round(INSTANTS * 365.25), stations=("CS002",), antennas=ANTENNAS
    )
    sky_power = compute_sky_power(instrument)
    spectra = simulate_campaign(settings, instrument, sky_power, np.random.default_rng(1)).spectra
    whole = shortest(lambda: audit(spectra, instrument))
    quick = shortest(lambda: audit_quickly(spectra, instrument))
    fit = shortest(lambda: calibrate(spectra, instrument, sky_power))
    print(f"{2 * ANTENNAS} paths, a day in {INSTANTS} instants: audit {whole:.2f} s, its quick part {quick:.2f} s")
    print(f"{whole / fit:.1f} and {quick / fit:.2f} times the fit of the same spectra ({fit:.2f} s)")


if __name__ == "__main__":
    main()
