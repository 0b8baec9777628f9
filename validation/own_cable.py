"""Whatever scope answers for a path, the truth lies within the error that the path is told.

A campaign is a year of an array with cables of 50, 80 and 115 m, simulated by the twin: every path has a gain of its
own, every station a response of its own. One station is simulated but not given to the fit. Each path is then told C by
its own curve, by its station's, by the array's, and in that one station by that of an array without a spectrum of it.
An error counts over all paths and channels. The errors of one campaign have much in common, so a campaign is one draw.
The part `unlike` has fewer antennas, which differ by as much as measured ones do, or not at all.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.calibration.spreads import ServedCurve, carry_to_path
from lbacal_core.curves.curves import UNCERTAIN, CalibrationCurve, FitReport
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.simulation.simulation import Simulation
from lbacal_twin.campaign import Campaign, simulate_campaign
from lbacal_twin.nuisances import Nuisances
from lbacal_twin.settings import TwinSettings
from validation.audit import UNLIKE, name_size
from validation.machinery.claims import Found, mean_of
from validation.machinery.parts import Part, Row
from validation.machinery.tables import by
from validation.superterp import power_of, superterp

SETTINGS = TwinSettings(stations=("CS002", "CS003", "CS004", "CS005", "CS006", "CS007"), events_per_year=300)
FEWER = replace(SETTINGS, stations=SETTINGS.stations[:4], antennas=16, events_per_year=200)
NUISANCES = Nuisances(missing=0.05, departures=0.01)
CABLES = ("50", "80", "115")
FITTED = ("antenna", "station", "array")
SCOPES = ("own", "station", "array", "silent")
"""Whose curve a path is told; `silent` is that of an array without data of its station."""


def tell_campaign(settings: TwinSettings, seed: int, mismatch: float = 0.0) -> Row:
    """Simulate a campaign, fit it without one station, and compare what every path is told with the truth."""
    instrument, sky_power = superterp(), power_of()
    rng = np.random.default_rng([50_80_115, seed])
    campaign = simulate_campaign(settings, instrument, sky_power, rng, nuisances=replace(NUISANCES, mismatch=mismatch))
    silent = settings.stations[seed % len(settings.stations)]
    spectra = campaign.spectra.select(campaign.spectra.station != silent)
    reports = {name: fit_calibration(spectra, Simulation(instrument, sky_power), name) for name in FITTED}
    return compare_scopes(reports, campaign, silent)


def tell_unlike(seed: int) -> Row:
    """A campaign with antennas as unlike as each of `UNLIKE` in turn."""
    unlike = UNLIKE[seed % len(UNLIKE)]
    return tell_campaign(FEWER, seed, unlike) | {"unlike": unlike}


def compare_scopes(reports: Mapping[str, FitReport], campaign: Campaign, silent: str) -> Row:
    """Compare the curve of every path by each kind of answer with the truth; one station gave no spectra."""
    heard = [one.station for one in campaign.truth.stations if one.station != silent]
    return {
        "own": _compare(reports["antenna"], campaign, heard),
        "station": _compare(reports["station"], campaign, heard),
        "array": _compare(reports["array"], campaign, heard),
        "silent": _compare(reports["array"], campaign, [silent]),
    }


def _compare(report: FitReport, campaign: Campaign, stations: Sequence[str]) -> Row:
    """How often the truth lies within the error told, by cable and altogether."""
    served, truths = zip(*_tell(report, campaign, stations), strict=True)
    c = np.array([one.curve.c for one in served])
    sigma = np.array([total_error(one.curve) for one in served])
    fraction, told_error = c / np.array(truths) - 1.0, sigma / c
    pull = np.abs(c - np.array(truths)) / sigma
    has_value = np.isfinite(pull)
    row: Row = {"uncertain": float(np.mean([one.flag == UNCERTAIN for one in served]))}
    for cable in ("all", *CABLES):
        rows = np.array([cable in ("all", one.cable) for one in served])
        at = has_value & rows[:, None]
        row[cable] = {
            "paths": int(rows.sum()),
            "within_1": round(float(np.mean(pull[at] < 1.0)), 4),
            "within_2": round(float(np.mean(pull[at] < 2.0)), 4),
            "offset": round(float(np.median(fraction[at])), 5),
            "error": round(float(np.median(np.abs(fraction[at]))), 5),
            "error_95": round(float(np.quantile(np.abs(fraction[at]), 0.95)), 5),
            "told": round(float(np.median(told_error[at])), 5),
        }
    return row


def total_error(curve: CalibrationCurve) -> np.ndarray:
    """Statistical and systematic error of C, where it has both."""
    errors = [one for one in (curve.c_sigma_stat, curve.c_sigma_sys) if one is not None]
    return np.asarray(np.sqrt(np.sum(np.square(errors), axis=0)))


def _tell(report: FitReport, campaign: Campaign, stations: Sequence[str]) -> Iterator[tuple[ServedCurve, np.ndarray]]:
    """What every path of some stations is told by the curves of one scope, and the truth."""
    curves = {
        curve.path: (curve, chain)
        for curve, chain in zip(report.curves, report.chains, strict=True)
        if curve.c is not None
    }
    for one in campaign.truth.stations:
        for antenna in one.antennas.tolist() if one.station in stations else []:
            for dipole in DIPOLES:
                keys = [(one.station, antenna, dipole), (one.station, None, dipole), (None, None, dipole)]
                found = next((curves[key] for key in keys if key in curves), None)
                if found is not None:
                    served = carry_to_path(*found, one.station, antenna, dipole, SETTINGS.start_unix)
                    yield served, campaign.truth.curve(dipole, one.station, antenna)


def judge(rows: Sequence[Row]) -> list[Found]:

    def of(scope: str, cable: str, name: str) -> np.ndarray:
        return np.array([row[scope][cable][name] for row in rows])

    return [
        *(mean_of(f"{scope}_{k}", of(scope, "all", f"within_{k}"), "%") for scope in SCOPES for k in (1, 2)),
        *(mean_of(f"offset_{cable}", np.abs(of("station", cable, "offset")), "%") for cable in CABLES),
        mean_of("flagged", np.array([row["silent"]["uncertain"] for row in rows]), "%"),
        mean_of("not_flagged", np.array([row["array"]["uncertain"] for row in rows]), "%"),
    ]


def judge_unlike(rows: Sequence[Row]) -> list[Found]:
    """Judge coverage of two sigma, and the error that a path is served, by how unlike antennas are."""
    found = []
    for unlike in UNLIKE:
        some, end = [row for row in rows if row["unlike"] == unlike], name_size(unlike)
        asked = [(f"{scope}_{end}", scope, "within_2") for scope in ("own", "station", "array")]
        asked.append((f"told_{end}", "station", "told"))
        found += [mean_of(key, np.array([row[scope]["all"][of] for row in some]), "%") for key, scope, of in asked]
    return found


PARTS = (
    Part("superterp", partial(tell_campaign, SETTINGS), judge, 96),
    Part("unlike", tell_unlike, judge_unlike, 64, by("unlike")),
)
