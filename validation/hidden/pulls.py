"""Pulls of C for paths and stations, whatever the form of the event gains; the sky power is the true one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.curves.reference_chain import ReferenceChain
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.simulation.simulation import Simulation
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.gains import NOISES
from lbacal_twin.settings import StationTruth, TwinSettings
from validation.hidden.worlds import EVENTS, EVERYTHING, OWN, STATION, TWELVE
from validation.machinery.claims import Found, root_mean_of, worst_of
from validation.machinery.parts import Part, Row
from validation.machinery.tables import by

AT_MHZ = (35.0, 45.0, 55.0, 65.0, 75.0)
SCOPES = ("antenna", "station")
FEWEST = 2
"""Campaigns of a form of the gains from which on there is an interval."""


def measure_pulls(seed: int) -> Row:
    """Squares of the pulls of C of a station-year, at five channels and in the mean over all; the forms take turns."""
    names = list(NOISES)
    noise = names[seed % len(names)]
    instrument, sky_power = load_instrument("lofar-superterp"), OWN.power()
    settings = TwinSettings(stations=(STATION,), antennas=len(TWELVE), events_per_year=EVENTS)
    nuisances = replace(EVERYTHING, noisy_stations=(STATION,) if seed % 3 == 0 else ())
    campaign = simulate_campaign(
        settings, instrument, sky_power, np.random.default_rng([2026, seed]), nuisances=nuisances, gains=NOISES[noise]
    )
    at = np.searchsorted(instrument.frequency_mhz, AT_MHZ)
    row: Row = {"noise": noise}
    for scope in SCOPES:
        report = fit_calibration(campaign.spectra, Simulation(instrument, sky_power), scope)
        pulls = [
            (curve.c - _planted(curve, chain, campaign.truth.stations[0])) / curve.c_sigma_stat
            for curve, chain in zip(report.curves, report.chains, strict=True)
            if curve.c is not None and curve.c_sigma_stat is not None and chain is not None
        ]
        squares = np.array(pulls) ** 2
        row[scope] = {
            "curves": len(pulls),
            "at": np.round(np.nanmean(squares[:, at], axis=0), 4).tolist(),
            "all": round(float(np.nanmean(squares)), 4),
        }
    return row


def _planted(curve: CalibrationCurve, chain: ReferenceChain, truth: StationTruth) -> np.ndarray:
    """The planted C(nu) of the members of a curve."""
    members = [antenna for station, antenna in chain.members if station == truth.station]
    gains = truth.c[np.isin(truth.antennas, members), DIPOLES.index(curve.dipole or "")] ** -2
    return np.asarray(gains.mean(axis=0) ** -0.5)


def judge(rows: Sequence[Row]) -> list[Found]:
    claims = []
    for noise in NOISES:
        here = [row for row in rows if row["noise"] == noise]
        for scope in SCOPES if len(here) >= FEWEST else ():
            squares = np.array([[*row[scope]["at"], row[scope]["all"]] for row in here])
            key = f"{scope}_{noise.replace(' ', '_')}"
            claims.append(worst_of([root_mean_of(key, one) for one in squares.T], len(here)))
    return claims


PARTS = (Part("pulls", measure_pulls, judge, 400 * len(NOISES), by("noise")),)
