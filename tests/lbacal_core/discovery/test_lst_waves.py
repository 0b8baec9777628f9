"""What follows sidereal time, through the fit of paths, of their station and an investigation: they do not contradict.

An investigation names structure from odds of 500 to 1, by its rate of false alarms; a fit calls a curve a misfit from
exp(10) to 1. Between them a curve may be converged where an investigation finds something, and never the other way.
"""

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.curves.curves import CONVERGED, MISFIT
from lbacal_core.discovery.report import investigate
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.simulation.simulation import Simulation
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings
from tests import lst_waves

CONSISTENT = ({CONVERGED}, {CONVERGED}, "consistent", None)
WRONG = ({MISFIT}, {MISFIT}, "unexplained", "lst")
LARGE, SMALL = (8, 600), (4, 400)


def judge(spectra, simulation):
    """The statuses of paths and of the station's curves; verdict and axis of an investigation."""
    paths, means = (
        {curve.status for curve in fit_calibration(spectra, simulation, scope).curves}
        for scope in ("antenna", "station")
    )
    report, _ = investigate(spectra, simulation, seed=1)
    left = report["unexplained"]
    assert left is None or report["findings"] == []
    return paths, means, report["verdict"], None if left is None else left["where"]["axis"]


@pytest.fixture(scope="module")
def simulation():
    return Simulation(load_instrument("lofar-superterp"))


@pytest.mark.long
@pytest.mark.parametrize(
    ("size", "harmonic", "slopes", "seed", "antennas_and_events", "expected"),
    [
        (0.0, 1, False, 3, LARGE, CONSISTENT),
        (0.01, 1, False, 6, LARGE, CONSISTENT),
        (0.02, 1, False, 5, LARGE, WRONG),  # was named jitter of the converter, which made chi^2 worse
        (0.03, 1, False, 4, SMALL, WRONG),  # ended in a fit that had run away, and an error of NumPy
        (0.04, 1, False, 3, SMALL, WRONG),  # converged, converged, unexplained
        (0.06, 1, False, 4, SMALL, WRONG),
        (0.03, 4, False, 3, LARGE, WRONG),  # 14 of 16 paths converged
        (0.015, 2, True, 3, SMALL, WRONG),
    ],
)
def test_fits_and_an_investigation_say_the_same_of_gains_along_lst(
    simulation, size, harmonic, slopes, seed, antennas_and_events, expected
):
    clean = lst_waves.simulate(simulation, seed, *antennas_and_events)
    assert judge(lst_waves.with_gain(clean, simulation, size, harmonic, slopes=slopes), simulation) == expected


def with_wave(sky, power):
    """A sky with a wave along LST that is within the prior of search and fit."""
    return power * (1.0 + 0.02 * np.cos(2.0 * np.pi / 24.0 * sky.lst_hours)[:, None])


def with_edge(sky, power):
    """A sky whose contrast at 40 MHz is that of a survey which is 15 % from those beside it."""
    log_power = np.log(power)
    mean, edge = log_power.mean(axis=0), np.interp(sky.frequency_mhz, [22.0, 40.0, 50.0], [0.0, 1.0, 0.0])
    return np.exp(mean + (log_power - mean) * (1.0 - 0.15 * edge))


@pytest.mark.long
@pytest.mark.parametrize("other", [with_wave, with_edge])
def test_another_sky_within_its_prior_is_none_of_the_gains(simulation, other):
    """Edges at the surveys of published skies were structure along LST, or a line of interference without end."""
    own = simulation.sky_power
    sky = replace(own, power={letter: other(own, one) for letter, one in own.power.items()})
    settings = TwinSettings(stations=(lst_waves.STATION,), antennas=8, events_per_year=600)
    spectra = simulate_campaign(settings, simulation.instrument, sky, np.random.default_rng(3)).spectra
    assert judge(spectra, simulation) == CONSISTENT
