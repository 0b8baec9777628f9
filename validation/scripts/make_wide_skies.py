"""Make the skies of lbacal_core/data/skies/wide, 10-408 MHz, from the maps of the PyPI package lsl.

    .venv/bin/python validation/scripts/make_wide_skies.py ../shared/data/sky

They are for instruments beyond 120 MHz, where the default sky ends. `make_alternative_skies.py` says more of the files.

- ``gsm-wide``: the Global Sky Model locked to 408 MHz, which has maps at 10, 22, 45 and 408 MHz;
- ``lfsm-wide``: the Low Frequency Sky Model, with maps at 10, 22, 40-80 and 408 MHz;
- ``haslam-wide``: the map at 408 MHz alone, carried down with the index 2.55.

Between 45 (80) and 408 MHz there is no map in them: the spectra are interpolated.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from sky_tables import FOLDER, LMAX, write_sky

from lbacal_core.sky.names import load_sky

NODES_MHZ = np.array([10, 12.5, 16, 20, 25, 32, 40, 50, 63, 80, 100, 125, 160, 200, 250, 320, 408], dtype=float)
MADE = "l <= 16; made by validation/scripts/make_wide_skies.py from {} of the PyPI package lsl 4.0.1 (GPL-2.0-or-later)"
GSM, LFSM = "gsm-408locked.npz", "lfsm-5.1deg.npz"


def main(folder: str) -> None:
    gsm, lfsm = (load_sky(str(Path(folder) / name)).truncated(LMAX) for name in (GSM, LFSM))

    def write(name: str, words: str, source: str, multipoles: np.ndarray, *, has_cmb: bool) -> None:
        write_sky(
            name, words + MADE.format(source), multipoles,
            has_cmb=has_cmb, has_isotropic=True, nodes_mhz=NODES_MHZ, folder=FOLDER / "wide",
        )  # fmt: skip

    def at(sky: object, frequency_mhz: np.ndarray) -> np.ndarray:
        return np.tensordot(sky.spectra(frequency_mhz), sky.multipoles, axes=1)

    model = "Global Sky Model (de Oliveira-Costa et al. 2008, MNRAS 388, 247) locked to 408 MHz; "
    write("gsm-wide", model, GSM, at(gsm, NODES_MHZ), has_cmb=False)
    model = "Low Frequency Sky Model (Dowell et al. 2017, MNRAS 469, 4537); "
    write("lfsm-wide", model, LFSM, at(lfsm, NODES_MHZ), has_cmb=True)
    carried = at(gsm, np.array([408.0])) * ((NODES_MHZ / 408.0) ** -2.55)[:, None, None]
    write("haslam-wide", "Map at 408 MHz (Haslam et al. 1982, A&AS 47, 1), index 2.55; ", GSM, carried, has_cmb=False)


if __name__ == "__main__":
    main(sys.argv[1])
