"""Print measured over predicted power of LOFAR's spectra, along frequency (docs/how-to/predict.md).

.venv/bin/lbacal spectra ../shared/data/tbb --output S.h5
.venv/bin/python -m validation.scripts.compare_prediction S.h5

An instrument alone has no A(nu) and no noise of the chain. Both are taken from the paper (Mulrey et al. 2019): C as
published (Fig. 6), and the noise over the mean sky (Fig. 5).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import lbacal
from lbacal_core.data.tables import read_table
from lbacal_core.grids import Floats
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.spectra import Spectra, read_spectra

STATION, ANTENNA = "CS002", 0
"""A path of the Superterp: the sky of core stations a few km from it is the same."""
SHOWN_MHZ = np.arange(30, 81, 10)


def compare(spectra: Spectra) -> Iterator[tuple[str, Floats]]:
    """The name of each spectrum, and its power over the predicted one, shape (freq,)."""
    simulation = Simulation.load("lofar-superterp")
    published, noise = read_table("published_calibration"), read_table("noise_terms")
    gain = simulation.instrument.antenna_gain / published["c"] ** 2
    for row, (dipole, time) in enumerate(zip(spectra.dipole.tolist(), spectra.time_unix.tolist(), strict=True)):
        at = f"{np.datetime64(round(time), 's')}Z"
        told = lbacal.predict(simulation, at=at, station=STATION, antenna=ANTENNA, dipole=dipole)
        # in front of the converter the sky has passed cable and receiver, and nothing else
        loss = simulation.instrument.cables[simulation.instrument.cable_of(STATION, ANTENNA, time)]
        sky = told.power / (simulation.instrument.antenna_gain * simulation.instrument.receiver_gain * loss)
        mean = simulation.sky_power.power[dipole].mean(axis=0)
        expected = gain * (sky + mean * sum(noise[one] for one in ("lna", "rcu", "adc")) / noise["sky"])
        yield spectra.name_row(row), spectra.power[row] / expected


def main(file: str) -> None:
    """Print a row a spectrum."""
    spectra = read_spectra(Path(file))
    columns = np.searchsorted(spectra.frequency_mhz, SHOWN_MHZ)
    print(f"{'measured / predicted':34s} median", *(f"{mhz:4d} MHz" for mhz in SHOWN_MHZ))
    for name, ratio in compare(spectra):
        print(f"{name:34s}   {np.median(ratio):.2f}", *(f"    {one:.2f}" for one in ratio[columns]))


if __name__ == "__main__":
    main(sys.argv[1])
