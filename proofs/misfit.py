"""A misfit is what noise and the freedom of sky and pattern cannot explain: no clean curve may be, a wrong input must.

Clean: part of a year of three stations in a drawn world with everything that such a year brings; the fit knows neither
the world's sky nor its antenna, and not the models that they were drawn from. Wrong: an input of a clean campaign is
mistaken in a way that users have mistaken it; such curves converged without a word.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from lbacal_core.calibration.chain_test import SkyFreedom
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.calibration.freedom import free_own_sky
from lbacal_core.curves import CONVERGED, MISFIT
from lbacal_core.errors import BadInputError
from lbacal_core.instrument import Instrument, load_instrument
from lbacal_core.skypower.differences import DifferenceModels
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra import Spectra
from lbacal_core.twin.campaign import simulate_campaign
from lbacal_core.twin.gains import NOISES
from lbacal_core.twin.settings import TwinSettings
from proofs.hidden.data_sets import OWN
from proofs.hidden.drawn import EVERYTHING
from proofs.hidden.worlds import alternatives
from proofs.hidden.worlds import draw as draw_world
from proofs.machinery.claims import Claim, at_most, claim_rate
from proofs.machinery.parts import Part, Row

CLEAN = TwinSettings(stations=("CS002", "CS003", "CS004"), antennas=4, events_per_year=600)
WRONG = TwinSettings(stations=("CS002",), antennas=4, events_per_year=600)
SCOPES = {"antenna": "paths", "station": "stations"}
RATE = 0.002
"""None of 2000."""
MISSED = 0.01
OTHER_ANTENNA = "short-dipole"
AS_NO_MODEL = "lst"
"""Worlds whose sky departs along LST by 3 % r.m.s., which no model does: what a misfit is for."""
FIRST_SEED = 600_000_000


@lru_cache(maxsize=64)
def _freedom(known: DifferenceModels) -> SkyFreedom:
    return free_own_sky(load_instrument("lofar-superterp"), known)


def fit_clean(seed: int) -> Row:
    """A campaign of a drawn world: how many of its curves are misfits, by scope."""
    instrument, world = load_instrument("lofar-superterp"), draw_world(FIRST_SEED + seed, OWN)
    nuisances = replace(EVERYTHING, noisy_stations=("CS003",) if seed % 3 == 0 else ())
    rng = np.random.default_rng([13_02, seed])
    spectra = simulate_campaign(
        CLEAN, instrument, world.sky_power(instrument), rng, nuisances=nuisances, gains=world.gains
    ).spectra
    freedom = _freedom(alternatives(world, OWN))
    row: Row = {"sky": world.sky, "noise": world.noise, "outside": world.outside}
    for scope in SCOPES:
        curves = fit_calibration(spectra, instrument, OWN.power(), scope, freedom).curves
        tested = [curve for curve in curves if curve.chi2_per_dof_profiled is not None]
        row[scope] = {
            "curves": len(tested),
            "misfits": sum(curve.status == MISFIT for curve in tested),
            "worst": round(max((curve.chi2_per_dof_profiled or 0.0 for curve in tested), default=0.0), 3),
        }
    return row


def judge_clean(rows: Sequence[Row]) -> list[Claim]:
    """Misfits among clean curves, where the sky is one of a model and where it is none's."""
    claims = []
    for scope, name in SCOPES.items():
        for key, where, is_odd in (("", "", False), ("_lst", " whose sky departs along LST as no model does", True)):
            here = [row[scope] for row in rows if (row["outside"] == AS_NO_MODEL) == is_odd]
            curves, misfits = (sum(row[k] for row in here) for k in ("curves", "misfits"))
            text = f"Clean curves of {name} in {len(here)} drawn worlds{where} that are a misfit"
            claims.append(claim_rate(f"{scope}{key}", text, at_most(RATE), misfits, curves))
    return claims


def tell_clean(rows: Sequence[Row]) -> list[str]:
    """By what lies outside every model."""
    lines = ["| outside | worlds | scope | curves | misfits | worst chi2/dof |", "|---|---|---|---|---|---|"]
    for outside in sorted({row["outside"] for row in rows}):
        here = [row for row in rows if row["outside"] == outside]
        for scope in SCOPES:
            curves, misfits = (sum(row[scope][name] for row in here) for name in ("curves", "misfits"))
            worst = max(row[scope]["worst"] for row in here)
            lines.append(f"| {outside or 'nothing'} | {len(here)} | {scope} | {curves} | {misfits} | {worst:.2f} |")
    return lines


def _letters_exchanged(spectra: Spectra) -> Spectra:
    return replace(spectra, dipole=np.where(spectra.dipole == "X", "Y", "X"))


def _as_they_are(spectra: Spectra) -> Spectra:
    return spectra


def _as_it_is(instrument: Instrument) -> Instrument:
    return instrument


OF_SPECTRA: Mapping[str, Callable[[Spectra], Spectra]] = {
    "decibels above -200": lambda s: replace(s, power=200.0 + 10.0 * np.log10(s.power)),
    "decibels above -400": lambda s: replace(s, power=400.0 + 10.0 * np.log10(s.power)),
    "voltage for power": lambda s: replace(s, power=np.sqrt(s.power)),
    "X and Y exchanged": _letters_exchanged,
    "channels reversed": lambda s: replace(s, power=s.power[:, ::-1].copy()),
    "local time": lambda s: replace(s, time_unix=s.time_unix + 7200.0),
}
OF_INSTRUMENT: Mapping[str, Callable[[Instrument], Instrument]] = {
    "latitude and longitude exchanged": lambda i: replace(
        i, latitude_deg=i.longitude_deg, longitude_deg=i.latitude_deg
    ),
    "latitude in radians": lambda i: replace(i, latitude_deg=float(np.radians(i.latitude_deg))),
    "arms in radians": lambda i: replace(
        i, dipole_azimuth_deg={k: float(np.radians(v)) for k, v in i.dipole_azimuth_deg.items()}
    ),
}
PATTERN = "a short dipole taken for the antenna"
KINDS = (*OF_SPECTRA, *OF_INSTRUMENT, PATTERN)
CURVES = 20
"""Curves of each kind: four antennas and their station, two dipoles, own sky and a file; what is an error has none."""


@lru_cache(maxsize=16)
def _believed(kind: str) -> tuple[Instrument, SkyPower, SkyFreedom] | None:
    """Instrument, sky power and its freedom as somebody believes them who made a mistake; None where it is an error."""
    try:
        instrument = OF_INSTRUMENT.get(kind, _as_it_is)(load_instrument("lofar-superterp"))
    except BadInputError:
        return None
    return instrument, compute_sky_power(instrument), free_own_sky(instrument)


def fit_wrong(seed: int) -> Row:
    """Each mistake in turn on a campaign of the own world: how many curves converged all the same."""
    instrument = load_instrument("lofar-superterp")
    names = list(NOISES)

    def simulate(antenna: str) -> Spectra:
        power = compute_sky_power(instrument, OWN.sky, antenna)
        rng, gains = np.random.default_rng([13_03, seed]), NOISES[names[seed % len(names)]]
        return simulate_campaign(WRONG, instrument, power, rng, nuisances=EVERYTHING, gains=gains).spectra

    spectra, of_other = simulate(OWN.antenna), simulate(OTHER_ANTENNA)
    row: Row = {}
    for kind in KINDS:
        wrong = of_other if kind == PATTERN else OF_SPECTRA.get(kind, _as_they_are)(spectra)
        found = _believed(kind if kind in OF_INSTRUMENT else "")
        if found is None:
            row[kind] = {"curves": CURVES, "converged": 0}
            continue
        believed, power, freedom = found
        curves = [
            curve
            for scope in SCOPES
            for free in (freedom, None)
            for curve in fit_calibration(wrong, believed, power, scope, free).curves
        ]
        row[kind] = {"curves": len(curves), "converged": sum(curve.status == CONVERGED for curve in curves)}
    return row


def judge_wrong(rows: Sequence[Row]) -> list[Claim]:
    """Curves of wrong inputs that converged, kind by kind."""
    claims = []
    for kind in KINDS:
        curves, converged = (sum(row[kind][name] for row in rows) for name in ("curves", "converged"))
        text = f"Wrong input, {kind}: curves that converged, paths and stations, own sky and a file"
        claims.append(claim_rate(kind.replace(" ", "_"), text, at_most(MISSED), converged, curves))
    return claims


PARTS = (
    Part("clean", fit_clean, judge_clean, 100, tell_clean),
    Part("wrong", fit_wrong, judge_wrong, 6),
)
