"""Writes a measurement set with pyuvdata and imports it: run by `test_measurement_set.py` where python-casacore is."""

import sys
from pathlib import Path

import numpy as np
from astropy.coordinates import EarthLocation
from pyuvdata import Telescope, UVData

from lbacal_core.readers.open import choose_channels, open_source
from lbacal_core.readers.source import average
from lbacal_core.spectra.spectra import write_spectra

folder = Path(sys.argv[1])
data = UVData.new(
    freq_array=50e6 + 4e5 * np.arange(6),
    polarization_array=np.array([-5, -6]),
    times=2459122.25 + np.arange(4) * 10 / 86_400,
    telescope=Telescope.new(
        location=EarthLocation.from_geodetic(21.4, -30.7, 1050.0),
        name="made",
        instrument="made",
        antenna_positions={k: np.array([14.0 * k, 0.0, 0.0]) for k in range(3)},
        x_orientation="east",
        feeds=["x", "y"],
        mount_type="fixed",
    ),
    antpairs=[(0, 0), (1, 1), (2, 2), (0, 1)],
    integration_time=10.0,
    channel_width=4e5,
    empty=True,
    do_blt_outer=True,
)
data.data_array[...] = 2.0 + data.ant_1_array[:, None, None]
data.data_array[..., 1] *= 10.0
data.flag_array[...] = False
data.flag_array[data.ant_1_array == 1, 1:5, 0] = True
data.write_ms(str(folder / "a.ms"), force_phase=True)

source = open_source(folder / "a.ms")
write_spectra(average(source, None, choose_channels(source, width_mhz=0.8)).spectra, folder / "S.h5")
