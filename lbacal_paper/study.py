"""What the claims and figures share, computed once: the simulated Superterp-year, its fits, and the measured LST curve.

The spectra behind the paper are not public. Where a statement is about the method (does the fit separate the noise
terms, how do errors propagate), it is tested on a simulated year of the Superterp whose chain is drawn about the
published one. Where it is about nature (the sky, the measured LST variation, the published curves themselves) no
simulation enters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.curves.curves import CalibrationCurve, FitReport
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.data.tables import read_table
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.lstcurve.curve import Comparison, LstCurve, compare_lst_curve, measured_curve, read_lst_curve
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import SkyPower
from lbacal_twin.campaign import Campaign, simulate_campaign
from lbacal_twin.settings import TwinSettings

SEED = 2019
STATION = "CS002"
EXCHANGE = {"X": "Y", "Y": "X"}


@dataclass(frozen=True)
class Study:
    """The inputs of every claim.

    Attributes
    ----------
    campaign
        A simulated year of the six stations: it knows what was planted.
    paths, array
        Fits of single paths, and of the mean over all.
    curve, comparison
        The measured LST curve with its dipoles as named, and with the letters exchanged, beside our sky.
    """

    simulation: Simulation
    campaign: Campaign
    paths: FitReport
    array: FitReport
    curve: LstCurve
    comparison: Comparison
    exchanged: Comparison

    @property
    def instrument(self) -> Instrument:
        """The Superterp."""
        return self.simulation.instrument

    @property
    def sky_power(self) -> SkyPower:
        """P_sky of the embedded Galaxy."""
        return self.simulation.sky_power

    @property
    def frequency_mhz(self) -> Floats:
        """Channels, shape (freq,), MHz."""
        return self.instrument.frequency_mhz

    def mean_curve(self, dipole: str) -> CalibrationCurve:
        """Find the array's curve of one polarisation."""
        (found,) = [curve for curve in self.array.curves if curve.dipole == dipole]
        return found

    def published_c(self) -> Floats:
        """C of the paper on our channels, V per ADC unit."""
        table = read_table("published_calibration")
        return np.interp(self.frequency_mhz, table["mhz"], table["c"])


def make_study(tell: Callable[[str], None], antennas: int | None = None, seed: int = SEED) -> Study:
    """Simulate, fit and compare.

    Parameters
    ----------
    tell
        Is called with every step before it begins.
    antennas
        Antennas a station; None for all 48.
    """
    tell("sky power of the embedded Galaxy over lofar-superterp")
    instrument = load_instrument("lofar-superterp")
    sky_power = compute_sky_power(instrument)
    simulation = Simulation(instrument, sky_power)
    tell("simulate a year of the Superterp")
    settings = TwinSettings(antennas=antennas)
    campaign = simulate_campaign(settings, instrument, sky_power, np.random.default_rng(seed))
    tell("fit every path, and the array")
    paths = fit_calibration(campaign.spectra, simulation, "antenna")
    array = fit_calibration(campaign.spectra, simulation, "array")
    tell("compare the measured LST curve")
    curve = read_lst_curve(measured_curve())
    swapped = replace(curve, variation_db={dipole: curve.variation_db[EXCHANGE[dipole]] for dipole in DIPOLES})
    return Study(
        simulation,
        campaign,
        paths,
        array,
        curve,
        compare_lst_curve(curve, sky_power, instrument),
        compare_lst_curve(swapped, sky_power, instrument),
    )
