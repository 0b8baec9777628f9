"""How long an audit of a day takes, and its quick part, against the fit of the same spectra.

Run: OPENBLAS_NUM_THREADS=1 .venv/bin/python -m validation.benchmarks.audit  (one core, half a minute)
"""

from __future__ import annotations

import numpy as np

from lbacal_core.audit.audit import audit, audit_quickly
from lbacal_core.pipeline import calibrate
from lbacal_core.simulation.simulation import Simulation
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings
from validation.benchmarks.timing import processor_times
from validation.superterp import power_of, superterp

ANTENNAS, INSTANTS = 48, 96


def main() -> None:
    instrument, sky_power = superterp(), power_of()
    settings = TwinSettings(
        years=1 / 365.25, events_per_year=round(INSTANTS * 365.25), stations=("CS002",), antennas=ANTENNAS
    )
    spectra = simulate_campaign(settings, instrument, sky_power, np.random.default_rng(1)).spectra
    works = {
        "whole": lambda: audit(spectra, instrument),
        "quick": lambda: audit_quickly(spectra, instrument),
        "fit": lambda: calibrate(spectra, Simulation(instrument, sky_power)),
    }
    whole, quick, fit = processor_times(works).values()
    print(f"{2 * ANTENNAS} paths, a day in {INSTANTS} instants: audit {whole:.2f} s, its quick part {quick:.2f} s")
    print(f"{whole / fit:.1f} and {quick / fit:.2f} times the fit of the same spectra ({fit:.2f} s)")


if __name__ == "__main__":
    main()
