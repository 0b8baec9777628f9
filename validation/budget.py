"""The total error of C covers the truth when every term of its budget is drawn, whatever scope answers.

A campaign is a year of an array with cables of 50, 80 and 115 m, two antennas of each in a station. Its sky, pattern,
ground, antenna gain and interference depart from what the fit takes them to be, each by a draw of its term of the
budget; one campaign in 20 is received by another antenna, as the budget takes it to be; the twin draws the electronics.
The fit knows nothing of the draws. One station gives no spectra; each path is told C as in `own_cable`, with its total
error. What is drawn is common to a campaign, so a campaign is one draw. In the part ``measured`` the instrument names
the sky `measured`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from lbacal_core.calibration.budget import add_budget, compute_budget
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.curves.curves import MISFIT
from lbacal_core.data.tables import read_prior
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.simulation.prior import OtherAntenna, SkyPrior, sky_prior
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.sky_terms import SkyTerm
from lbacal_core.sky.table import read_at
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import Campaign, simulate_campaign
from lbacal_twin.settings import TwinSettings
from validation.machinery.claims import Found, mean_of
from validation.machinery.parts import Part, Row
from validation.own_cable import FITTED, NUISANCES, SCOPES, compare_scopes

SETTINGS = TwinSettings(stations=("CS002", "CS003", "CS004", "CS005"), events_per_year=300)
OF_EACH_CABLE = 2
"""Antennas of a station with each cable."""
SKY_OF = {"measured": "measured"}
"""The sky that an instrument names beside a budget; the default one where none is here."""


@dataclass(frozen=True)
class Believed:
    """The inputs of the fit, and how far they may be wrong."""

    simulation: Simulation
    changes: Sequence[SkyTerm]
    prior: SkyPrior


@cache
def believe(sky_budget: str) -> Believed:
    """A part of the Superterp under the embedded sky, with the terms of a budget by name."""
    superterp = load_instrument("lofar-superterp")
    classes: dict[tuple[str, str], list[AntennaRecord]] = {}
    for record in superterp.antennas:
        classes.setdefault((record.station, record.cable), []).append(record)
    few = [record for members in classes.values() for record in members[:OF_EACH_CABLE]]
    instrument = replace(superterp, antennas=tuple(few), sky=SKY_OF.get(sky_budget, superterp.sky))
    simulation = Simulation(instrument)
    return Believed(simulation, simulation.changes(sky_budget), sky_prior(instrument))


def draw_campaign(believed: Believed, settings: TwinSettings, rng: np.random.Generator) -> Campaign:
    """A campaign that departs from what is believed by a draw of each term."""
    of_sky, of_gain, of_lines = (rng.standard_normal(len(believed.changes)), *rng.standard_normal(2))
    sky_power, instrument = believed.simulation.sky_power, believed.simulation.instrument
    change = dict.fromkeys(sky_power.power, np.zeros(1))
    if (other := draw_antenna(believed.prior, rng)) is not None:
        change = {dipole: read_at(one, sky_power.lst_hours) for dipole, one in other.change.items()}
    moved = {
        dipole: values
        * np.exp(change[dipole] + sum(a * one.d_ln_p[dipole] for a, one in zip(of_sky, believed.changes, strict=True)))
        for dipole, values in sky_power.power.items()
    }
    gain = instrument.gain_provenance
    shape = 0.0 if gain is None or gain.shape_error is None else gain.shape_error
    true = replace(instrument, antenna_gain=instrument.antenna_gain * np.exp(of_gain * shape))
    campaign = simulate_campaign(settings, true, replace(sky_power, power=moved), rng, nuisances=NUISANCES)
    return replace(campaign, spectra=_with_power(campaign.spectra, of_lines * read_prior()["interference"].size))


def draw_antenna(prior: SkyPrior, rng: np.random.Generator) -> OtherAntenna | None:
    """Another antenna than the believed one, as often as the budget expects before it asks the data; else None."""
    is_other, which = rng.random() < read_prior()["other_antenna"].size, rng.random()
    at = int(np.searchsorted(np.cumsum([one.share for one in prior.antennas]), which))
    return prior.antennas[min(at, len(prior.antennas) - 1)] if is_other else None


def _with_power(spectra: Spectra, fraction: float) -> Spectra:
    """Spectra with a fraction of the mean power of their path at all times."""
    power = spectra.power.copy()
    names = np.char.add(np.char.add(spectra.station, spectra.dipole), spectra.antenna.astype(str))
    for name in np.unique(names):
        power[names == name] += fraction * power[names == name].mean(axis=0)
    return replace(spectra, power=power)


def tell_campaign(sky_budget: str, settings: TwinSettings, seed: int) -> Row:
    """Draw every term, fit without one station, and compare what every path is told with the truth."""
    believed = believe(sky_budget)
    campaign = draw_campaign(believed, settings, np.random.default_rng([13_05, seed]))
    silent = settings.stations[seed % len(settings.stations)]
    spectra = campaign.spectra.select(campaign.spectra.station != silent)
    budget = compute_budget(spectra, believed.simulation, sky_budget)
    fitted = {name: fit_calibration(spectra, believed.simulation, name) for name in FITTED}
    reports = {name: add_budget(report, budget) for name, report in fitted.items()}
    curves = [curve for report in reports.values() for curve in report.curves]
    return {
        **compare_scopes(reports, campaign, silent),
        "curves": len(curves),
        "misfits": sum(curve.status == MISFIT for curve in curves),
        "total": round(float(np.median(np.concatenate([np.sqrt(budget.variance(p)) for p in "XY"]))), 5),
    }


def judge(rows: Sequence[Row]) -> list[Found]:
    return [
        mean_of(f"{scope}_{k}", np.array([row[scope]["all"][f"within_{k}"] for row in rows]), "%")
        for scope in SCOPES
        for k in (1, 2)
    ]


PARTS = tuple(
    Part(name, partial(tell_campaign, name, SETTINGS), judge, 400, headlines=headlines)
    for name, headlines in (("models", ()), ("measured", ("own_2",)))
)
