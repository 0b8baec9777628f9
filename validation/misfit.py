"""A misfit is what noise and the freedom of sky and pattern cannot explain: no clean curve may be, a wrong input must.

Clean: part of a year of three stations in a drawn world with everything that such a year brings; fit and budget know
neither the world's sky nor its antenna, and not the models that they were drawn from. C of its paths has to lie within
two standard deviations of the true one as often as that says; the level of the sky, which few worlds change, and the
shape of G_ant are drawn by their published errors. Wrong: an input of a clean campaign is
mistaken in a way that users have mistaken it; such curves converged without a word.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from functools import lru_cache
from zoneinfo import ZoneInfo

import numpy as np

from lbacal_core.antenna.ideal import ShortDipole
from lbacal_core.antenna.model import AntennaModel
from lbacal_core.calibration.budget import add_budget, compute_budget
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.curves.curves import CONVERGED, MISFIT, OK, FitReport
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.simulation.prior import list_changes
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.differences import DifferenceModels
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import Campaign, simulate_campaign
from lbacal_twin.gains import NOISES
from lbacal_twin.settings import TwinSettings
from validation.hidden.worlds import EVERYTHING, OWN, alternatives
from validation.hidden.worlds import draw as draw_world
from validation.machinery.claims import Found, mean_of, rate_of
from validation.machinery.parts import Part, Row
from validation.machinery.tables import by
from validation.own_cable import total_error

CLEAN = TwinSettings(stations=("CS002", "CS003", "CS004"), antennas=4, events_per_year=600)
WRONG = TwinSettings(stations=("CS002",), antennas=4, events_per_year=600)
SCOPES = {"antenna": "paths", "station": "stations"}
ANTENNAS = (OWN.antenna, "short-dipole", "quarter-wave")
"""Whose data are taken for the first one's: the short dipole at a height that is drawn."""
HEIGHTS_M = (1.1, 1.6)
FAR = 2.0
"""Standard deviations of the total error."""
AS_NO_MODEL = "lst"
"""Worlds whose sky departs along LST by 3 % r.m.s., which no model does: what a misfit is for."""
FIRST_SEED = 600_000_000


LEVEL = 0.12
"""Standard deviation of the level of the sky (arXiv 2211.03086): few worlds depart by any."""
BUDGET = "models"
AT_MHZ = (35.0, 55.0, 75.0)


@lru_cache(maxsize=64)
def _simulation(known: DifferenceModels) -> Simulation:
    """The own sky with what these models say of its errors, in the fit's prior and in the budget of C."""
    simulation = Simulation(load_instrument("lofar-superterp"), OWN.power(), is_own_sky=True, models=known)
    changes = list_changes(simulation.instrument, BUDGET)
    skies = {one.name: one.name.partition(" (")[2].removesuffix(")") for one in changes}
    kept = [one for one in changes if skies[one.name] in known.skies]
    weight = np.sqrt(sum(map(bool, skies.values())) / len(kept))  # a mean square difference over fewer skies
    kept = [replace(one, d_ln_p={dipole: weight * values for dipole, values in one.d_ln_p.items()}) for one in kept]
    simulation.made.get(("changes", BUDGET), lambda: [*(one for one in changes if not skies[one.name]), *kept])
    return simulation


def _cover(report: FitReport, campaign: Campaign, simulation: Simulation) -> list[float]:
    """Share of the curves of paths whose C lies within two standard deviations of the true one, at `AT_MHZ`."""
    at = np.searchsorted(simulation.instrument.frequency_mhz, AT_MHZ)
    budget = compute_budget(campaign.spectra, simulation, BUDGET)
    beyond = []
    for curve in add_budget(report, budget).curves:
        if curve.c is not None:
            truth = campaign.truth.curve(str(curve.dipole), str(curve.station), curve.antenna)
            beyond.append(((curve.c - truth) / total_error(curve))[at])
    found: list[float] = np.mean(np.abs(beyond) < FAR, axis=0).tolist()
    return found


def fit_clean(seed: int) -> Row:
    """A campaign of a drawn world: how many of its curves are misfits, by scope."""
    instrument, world = load_instrument("lofar-superterp"), draw_world(FIRST_SEED + seed, OWN)
    nuisances = replace(EVERYTHING, noisy_stations=("CS003",) if seed % 3 == 0 else ())
    rng = np.random.default_rng([13_02, seed])
    level, shape = np.random.default_rng([13_07, seed]).normal(size=2)
    gain = instrument.gain_provenance
    if gain is None or gain.shape_error is None:
        raise BadInputError("instrument", "an error of the shape of G_ant, which is drawn", "none")
    true = replace(instrument, antenna_gain=instrument.antenna_gain * np.exp(shape * gain.shape_error))
    power = world.sky_power(instrument)
    power = replace(power, power={name: np.exp(LEVEL * level) * one for name, one in power.power.items()})
    campaign = simulate_campaign(CLEAN, true, power, rng, nuisances=nuisances, gains=world.gains)
    simulation = _simulation(alternatives(world, OWN))
    row: Row = {"sky": world.sky, "noise": world.noise, "outside": world.outside}
    for scope in SCOPES:
        report = fit_calibration(campaign.spectra, simulation, scope)
        tested = [curve for curve in report.curves if curve.chi2_per_dof_profiled is not None]
        row[scope] = {
            "curves": len(tested),
            "misfits": sum(curve.status == MISFIT for curve in tested),
            "worst": round(max((curve.chi2_per_dof_profiled or 0.0 for curve in tested), default=0.0), 3),
        }
        if scope == "antenna":
            row["within_2"] = _cover(report, campaign, simulation)
    return row


def judge_clean(rows: Sequence[Row]) -> list[Found]:
    claims = []
    for scope in SCOPES:
        for key, is_odd in (("", False), ("_lst", True)):
            here = [row[scope] for row in rows if (row["outside"] == AS_NO_MODEL) == is_odd]
            curves, misfits = (sum(row[k] for row in here) for k in ("curves", "misfits"))
            claims.append(rate_of(f"{scope}{key}", misfits, curves))
    within = np.array([row["within_2"] for row in rows]).T
    return claims + [mean_of(f"c_{mhz:.0f}", one, "%") for mhz, one in zip(AT_MHZ, within, strict=True)]


def _in_local_time(spectra: Spectra) -> Spectra:
    """Times as a clock on the wall shows them in the Netherlands: one hour late in winter, two in summer."""
    time_unix, event = np.unique(spectra.time_unix, return_inverse=True)
    zone = ZoneInfo("Europe/Amsterdam")
    offsets = [datetime.fromtimestamp(one, zone).utcoffset() or timedelta() for one in time_unix.tolist()]
    return replace(spectra, time_unix=(time_unix + [offset.total_seconds() for offset in offsets])[event])


OF_SPECTRA: Mapping[str, Callable[[Spectra], Spectra]] = {
    "decibels above -200": lambda s: replace(s, power=200.0 + 10.0 * np.log10(s.power)),
    "decibels above -400": lambda s: replace(s, power=400.0 + 10.0 * np.log10(s.power)),
    "voltage for power": lambda s: replace(s, power=np.sqrt(s.power)),
    "X and Y exchanged": lambda s: replace(s, dipole=np.where(s.dipole == "X", "Y", "X")),
    "channels reversed": lambda s: replace(s, power=s.power[:, ::-1].copy()),
    "local time": lambda s: replace(s, time_unix=s.time_unix + 7200.0),
    "local time, summer and winter": _in_local_time,
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
KINDS = (*OF_SPECTRA, *OF_INSTRUMENT)
TOLD: Mapping[str, Callable[[Spectra], Spectra]] = {
    "an hour late": lambda s: replace(s, time_unix=s.time_unix + 3600.0),
    "an hour early": lambda s: replace(s, time_unix=s.time_unix - 3600.0),
}
"""What nobody has mistaken yet, and moves C by less than its error: how many converge is told and not claimed."""
CURVES = 20
"""Curves of each kind: four antennas and their station, two dipoles, own sky and a file; what is an error has none."""


@lru_cache(maxsize=16)
def _believe(kind: str) -> Simulation:
    """What somebody believes who made a mistake, or none; raises BadInputError where it is an error."""
    instrument = load_instrument("lofar-superterp")
    return Simulation(OF_INSTRUMENT[kind](instrument) if kind in OF_INSTRUMENT else instrument)


def _simulate(antenna: str | AntennaModel, seed: int) -> Campaign:
    instrument, names = load_instrument("lofar-superterp"), list(NOISES)
    power = compute_sky_power(instrument, OWN.sky, antenna)
    rng, gains = np.random.default_rng([13_03, seed]), NOISES[names[seed % len(names)]]
    return simulate_campaign(WRONG, instrument, power, rng, nuisances=EVERYTHING, gains=gains)


def fit_wrong(seed: int) -> Row:
    """Each mistake in turn on a campaign of the own world: how many curves converged all the same."""
    spectra, row = _simulate(OWN.antenna, seed).spectra, Row()
    for kind in (*KINDS, *TOLD):
        try:
            believed = _believe(kind if kind in OF_INSTRUMENT else "")
        except BadInputError:
            row[kind] = {"curves": CURVES, "converged": 0}
            continue
        wrong = spectra if kind in OF_INSTRUMENT else {**OF_SPECTRA, **TOLD}[kind](spectra)
        fits = [fit_calibration(wrong, one, scope) for scope in SCOPES for one in (believed, believed.at_its_word())]
        curves = [curve for report in fits for curve in report.curves]
        row[kind] = {"curves": len(curves), "converged": sum(curve.status == CONVERGED for curve in curves)}
    return row


def fit_pattern(seed: int) -> Row:
    """Data of another antenna: what its paths are served, and how far C is off in channels flagged `ok`."""
    height = np.random.default_rng([13_06, seed]).uniform(*HEIGHTS_M)
    antennas: dict[str, str | AntennaModel] = {name: name for name in ANTENNAS}
    antennas["short-dipole"] = ShortDipole(height_m=float(height))
    row: Row = {"height_m": round(float(height), 3)}
    for name, antenna in antennas.items():
        campaign, right = _simulate(antenna, seed), _believe("")
        told: Row = dict.fromkeys(("curves", "misfits", "unflagged", "unsaid", "channels", "beyond_1", "beyond_2"), 0)
        report = fit_calibration(campaign.spectra, right, "antenna")
        for curve in add_budget(report, compute_budget(campaign.spectra, right)).curves:
            told["curves"] += 1
            told["misfits"] += int(curve.status == MISFIT)
            if curve.status != CONVERGED or curve.c is None:
                continue
            is_ok = curve.flags == OK
            truth = campaign.truth.curve(str(curve.dipole), str(curve.station), curve.antenna)
            beyond = (np.abs(curve.c - truth) / total_error(curve))[is_ok]
            told["unflagged"] += int(np.all(is_ok))
            told["unsaid"] += int(np.all(is_ok) and np.any(beyond > FAR))
            told["channels"] += int(is_ok.sum())
            for k in (1, 2):
                told[f"beyond_{k}"] += int(np.count_nonzero(beyond > k))
        row[name] = told
    return row


def judge_wrong(rows: Sequence[Row]) -> list[Found]:
    claims = []
    for kind in KINDS:
        curves, converged = (sum(row[kind][name] for row in rows) for name in ("curves", "converged"))
        claims.append(rate_of(kind.replace(" ", "_"), converged, curves))
    return claims


def judge_pattern(rows: Sequence[Row]) -> list[Found]:
    claims = []
    for antenna in ANTENNAS[1:]:
        unsaid, curves = (sum(row[antenna][name] for row in rows) for name in ("unsaid", "curves"))
        found = [row[antenna]["beyond_2"] / max(row[antenna]["channels"], 1) for row in rows]
        claims += [rate_of(f"{antenna}_unsaid", unsaid, curves), mean_of(f"{antenna}_beyond", np.array(found), "%")]
    return claims


PARTS = (
    Part("clean", fit_clean, judge_clean, 400, by("outside")),
    Part("wrong", fit_wrong, judge_wrong, 6, headlines=("X_and_Y_exchanged",)),
    Part("pattern", fit_pattern, judge_pattern, 20),
)
