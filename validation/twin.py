"""The fit recovers what the twin planted: pulls of paths and stations, with and without nuisances.

The curve of a station is that of its antennas with enough events: which antennas are averaged matters more than the
noise, because their cables differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.calibration.singles import MIN_EVENTS
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.simulation.simulation import Simulation
from lbacal_twin.campaign import Campaign, simulate_campaign
from lbacal_twin.nuisances import NONE, REALISTIC, Nuisances
from lbacal_twin.settings import TwinSettings
from validation.machinery.claims import Found, mean_of, root_mean_of, worst_of
from validation.machinery.parts import Part, Row
from validation.superterp import power_of, superterp

CHANNELS = {"35 MHz": 5, "55 MHz": 25, "75 MHz": 45}
SCOPES = ("antenna", "station")


def planted_curve(campaign: Campaign, curve: CalibrationCurve) -> np.ndarray:
    """The planted C(nu) of a path, or of the mean over those antennas of a station that the fit averages."""
    if curve.antenna is not None:
        return campaign.truth.curve(curve.dipole or "", curve.station, curve.antenna)
    spectra, truth = campaign.spectra, campaign.truth.stations[0]
    counts = [np.sum((spectra.antenna == a) & (spectra.dipole == curve.dipole)) for a in truth.antennas]
    gains = truth.c[np.array(counts) >= MIN_EVENTS, DIPOLES.index(curve.dipole or "")] ** -2
    return np.asarray(gains.mean(axis=0) ** -0.5)


def fit_campaign(nuisances: Nuisances, seed: int) -> Row:
    """A station-year of 12 antennas: mean, mean square and number of the pulls of its curves, at three channels."""
    instrument, sky_power = superterp(), power_of()
    settings = TwinSettings(stations=("CS002",), antennas=12)
    rng = np.random.default_rng([2019, seed])
    campaign = simulate_campaign(settings, instrument, sky_power, rng, nuisances=nuisances)
    row: Row = {}
    for scope in SCOPES:
        fitted = fit_calibration(campaign.spectra, Simulation(instrument, sky_power), scope).curves
        pulls = np.array([(c.c - planted_curve(campaign, c)) / c.c_sigma_stat for c in fitted if c.c is not None])
        at = pulls[:, list(CHANNELS.values())]
        row[scope] = {
            "curves": len(at),
            "mean": np.round(at.mean(axis=0), 4).tolist(),
            "mean_square": np.round((at**2).mean(axis=0), 4).tolist(),
        }
    return row


def judge(rows: Sequence[Row]) -> list[Found]:
    """Curves of a campaign share events and sky: it is one draw."""
    claims = []
    for scope in SCOPES:
        mean, square = (np.array([row[scope][name] for row in rows]) for name in ("mean", "mean_square"))
        claims.append(worst_of([mean_of(f"{scope}_mean", one) for one in mean.T], len(rows)))
        claims.append(worst_of([root_mean_of(f"{scope}_spread", one) for one in square.T], len(rows)))
    return claims


PARTS = (
    Part("clean", partial(fit_campaign, NONE), judge, 300),
    Part("nuisances", partial(fit_campaign, REALISTIC), judge, 300, headlines=("antenna_spread",)),
)
