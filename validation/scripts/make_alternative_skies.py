"""Make the skies of lbacal_core/data/skies that stand beside the default one, from the maps of the PyPI package lsl.

    .venv/bin/python validation/scripts/make_alternative_skies.py ../shared/data/sky

lsl 4.0.1 (GPL) has two sets of principal components on HEALPix nside 64: `gsm-408locked.npz`, the Global Sky Model
(de Oliveira-Costa et al. 2008, MNRAS 388, 247) locked to the map at 408 MHz, and `lfsm-5.1deg.npz`, the Low Frequency
Sky Model (Dowell et al. 2017, MNRAS 469, 4537), which rests on maps of the LWA1 at 40-80 MHz. Four skies are made:

- ``gsm408``, ``lfsm``: the models;
- ``haslam``: the map at 408 MHz (Haslam et al. 1982) alone, as the components give it, carried down with the index
  2.55, as codes do that have one map;
- ``maeda``: the map at 45 MHz (Alvarez et al. 1997; Maeda et al. 1999) alone, as the components of `gsm408` give it,
  carried with the index 2.5.

Only multipoles up to l = 16 ship, not the maps.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from sky_tables import LMAX, NODES_MHZ, write_sky

from lbacal_core.sky.names import load_sky

MADE = "l <= 16; made by validation/scripts/make_alternative_skies.py from {} of the PyPI package lsl 4.0.1 (GPL)"
GSM, LFSM = "gsm-408locked.npz", "lfsm-5.1deg.npz"


def main(folder: str) -> None:
    gsm, lfsm = (load_sky(str(Path(folder) / name)).truncated(LMAX) for name in (GSM, LFSM))

    def at(sky: object, frequency_mhz: np.ndarray) -> np.ndarray:
        return np.tensordot(sky.spectra(frequency_mhz), sky.multipoles, axes=1)

    def carried(sky: object, from_mhz: float, index: float) -> np.ndarray:
        return at(sky, np.array([from_mhz])) * ((NODES_MHZ / from_mhz) ** -index)[:, None, None]

    model = "Global Sky Model (de Oliveira-Costa et al. 2008, MNRAS 388, 247) locked to 408 MHz; "
    write_sky("gsm408", model + MADE.format(GSM), at(gsm, NODES_MHZ), has_cmb=False, has_isotropic=True)
    model = "Low Frequency Sky Model (Dowell et al. 2017, MNRAS 469, 4537); "
    write_sky("lfsm", model + MADE.format(LFSM), at(lfsm, NODES_MHZ), has_cmb=True, has_isotropic=True)
    model = "Map at 408 MHz (Haslam et al. 1982, A&AS 47, 1) carried with the index 2.55; "
    write_sky("haslam", model + MADE.format(GSM), carried(gsm, 408.0, 2.55), has_cmb=False, has_isotropic=True)
    model = "Map at 45 MHz (Alvarez et al. 1997, A&AS 124, 315; Maeda et al. 1999, A&AS 140, 145), index 2.5; "
    write_sky("maeda", model + MADE.format(GSM), carried(gsm, 45.0, 2.5), has_cmb=False, has_isotropic=True)


if __name__ == "__main__":
    main(sys.argv[1])
