"""What the causes of a simulation do to calibrated paths: at an instant, for a prediction, and in recorded spectra.

The paths are laid out as a station, and the causes act on the chains of their curves as they do in a fit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace

import numpy as np

from lbacal_core.calibration.prediction import Acting, EventNoise, Prediction, curve_alone, predict_path
from lbacal_core.calibration.singles import has_enough
from lbacal_core.causes.cause import REFERENCE_C, TEMPERATURE
from lbacal_core.causes.model import AdoptedCause
from lbacal_core.causes.sky import sky_ratios
from lbacal_core.curves.covariance import Budget
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.discovery.adopted import list_hypotheses
from lbacal_core.discovery.hypothesis import Hypothesis
from lbacal_core.discovery.refit import power_ratio
from lbacal_core.discovery.station import Station, gather_stations
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.instrument.chain import ChainTerms
from lbacal_core.instrument.sidereal import SIDEREAL_DAY_S
from lbacal_core.simulation.simulation import Simulation, terms_of
from lbacal_core.spectra.spectra import POSSIBLE, Spectra

INSTANTS = 96
"""Instants of a sidereal day from the one asked for on: a compression acts by the power over its mean."""
UNUSED = "no cause of the model follows the temperature: it changes nothing"


def predict(
    curve: CalibrationCurve,
    simulation: Simulation,
    time_unix: float,
    noise: EventNoise | None = None,
    budget: Budget | None = None,
    temperature_c: float | None = None,
    *,
    is_own: bool = True,
    is_calibrated: bool = True,
) -> Prediction:
    """What a path should record at an instant, with what the causes of the simulation do to it then.

    Parameters
    ----------
    simulation
        With the causes that the curve was fitted with, at their sizes.
    temperature_c
        Outside temperature, deg C, which causes with a delay take as it is; `REFERENCE_C`, to which C belongs, where
        none is given. Rain and other columns are not known: what follows them does nothing.
    noise, budget, is_own, is_calibrated
        As in `predict_path`.
    """
    acting = None if curve.c is None else _act_at(curve, simulation, time_unix, temperature_c)
    of_curve = {"is_own": is_own, "is_calibrated": is_calibrated}
    return predict_path(curve, simulation, time_unix, noise, budget, acting, **of_curve)


def predict_alone(
    simulation: Simulation,
    station: str,
    antenna: int,
    dipole: str,
    time_unix: float,
    temperature_c: float | None = None,
) -> Prediction:
    """What the simulation with its causes says of a path that nobody has calibrated."""
    curve = curve_alone(simulation, station, antenna, dipole, time_unix)
    return predict(curve, simulation, time_unix, temperature_c=temperature_c, is_calibrated=False)


def divide_out(spectra: Spectra, curves: Sequence[CalibrationCurve], simulation: Simulation) -> Spectra:
    """Spectra with what the causes of the simulation do to their paths divided out.

    Parameters
    ----------
    curves
        Those of single paths. Other paths, and stations without a path of `MIN_EVENTS` events, stay as they are.
    """
    power = spectra.power.copy()
    for name in sorted({one.station for one in simulation.causes.causes}):
        own = {(one.antenna, one.dipole): one for one in curves if one.c is not None and one.station == name}
        keys = list(zip(spectra.antenna.tolist(), spectra.dipole.tolist(), spectra.station == name, strict=True))
        rows = np.array([here and (antenna, dipole) in own for antenna, dipole, here in keys], dtype=bool)
        recorded = spectra.select(rows)
        if has_enough(recorded):
            station, named, terms = _lay_out(list(own.values()), simulation, recorded)
            at, path, event = station.find_places(spectra)
            power[at] /= power_ratio(station, terms, [one for _, one in named])[path, event]
    return replace(spectra, power=power)


def _act_at(
    curve: CalibrationCurve, simulation: Simulation, time_unix: float, temperature_c: float | None
) -> Acting | None:
    """What the causes make of the chain of a path at an instant; None where there is nothing to be said."""
    coldest, hottest = POSSIBLE[TEMPERATURE]
    if temperature_c is not None and not coldest <= temperature_c <= hottest:
        raise BadInputError("temperature", f"deg C, {coldest:g} to {hottest:g}", f"{temperature_c:g}")
    times = np.linspace(time_unix, time_unix + SIDEREAL_DAY_S, INSTANTS, endpoint=False)
    named: Sequence[tuple[AdoptedCause, Hypothesis]] = ()
    if simulation.causes.of_stations([str(curve.station)]).causes:
        day = _spectra_at(curve, simulation, times, temperature_c)
        station, named, terms = _lay_out([curve], simulation, day)
    if not named:
        sky = simulation.sky_at(curve.station, str(curve.dipole), times[:1])[0]
        return None if temperature_c is None else Acting(terms_of(curve, simulation.instrument, sky), notes=[UNUSED])
    ones = [one for _, one in named]
    moved = [[replace(one, size=one.size + one.sigma * (one is by)) for one in ones] for by in ones]
    acting, *others = (_at_first(station, terms, some) for some in (ones, *moved))
    return Acting(acting, others, list(_tell(named, temperature_c)))


def _at_first(station: Station, terms: ChainTerms, hypotheses: Sequence[Hypothesis]) -> ChainTerms:
    """The chain of the one path at the first instant, with hypotheses, shape (freq,) each."""
    for one in hypotheses:
        terms = one.cause.apply(terms, station.conditions, one.template, one.size)
    shape = station.sky.shape
    return ChainTerms(**{one.name: np.broadcast_to(getattr(terms, one.name), shape)[0, 0] for one in fields(terms)})


def _lay_out(
    curves: Sequence[CalibrationCurve], simulation: Simulation, spectra: Spectra
) -> tuple[Station, Sequence[tuple[AdoptedCause, Hypothesis]], ChainTerms]:
    """Paths of one station, the causes that act on them, and the mean chain of each class without causes.

    Each antenna keeps the hardware of the first spectrum, also after a new cable.
    """
    name, first = str(curves[0].station), float(spectra.time_unix.min())
    there = simulation.instrument.at_station(name)
    records = [one for one in there.antennas if one.station == name]
    held = {one.antenna: one for one in sorted(records, key=lambda one: one.covers(first))}
    steady = replace(there, antennas=[replace(one, since=None, until=None) for one in held.values()])
    ratios = simulation.made.get(("sky ratios", name), lambda: sky_ratios(there))
    given = simulation.sky_power.of_station(name)
    laid_out = replace(simulation, instrument=steady, given=given, is_own_sky=simulation.is_own_sky)
    station = gather_stations(spectra, laid_out, ratios)[0]
    of_path = {(curve.antenna, curve.dipole): curve for curve in curves}
    paths = [of_path[key] for key in zip(station.antenna.tolist(), station.dipole.tolist(), strict=True)]
    each = [terms_of(curve, there, np.zeros(curve.frequency_mhz.size)) for curve in paths]
    share = station.class_of == np.arange(len(station.conditions.dipoles))[:, None]
    weight = share / share.sum(axis=1, keepdims=True)
    mean = {
        name: (weight @ np.array([np.broadcast_to(getattr(terms, name), there.frequency_mhz.shape) for terms in each]))
        for name in (one.name for one in fields(ChainTerms))
    }
    return (
        station,
        list_hypotheses(simulation.causes, station),
        ChainTerms(**{name: one[:, None] for name, one in mean.items()} | {"sky": station.sky}),
    )


def _spectra_at(curve: CalibrationCurve, simulation: Simulation, times: Floats, temperature_c: float | None) -> Spectra:
    """Spectra of a path at some instants, of any power, with the columns that its causes name."""
    count = times.size
    columns = simulation.causes.of_stations([str(curve.station)]).covariates
    environment = {name: np.full(count, np.nan) for name in columns}
    if TEMPERATURE in columns and temperature_c is not None:
        environment[TEMPERATURE] = np.full(count, temperature_c)
    return Spectra(
        frequency_mhz=curve.frequency_mhz,
        power=np.ones((count, curve.frequency_mhz.size)),
        event_id=np.array([f"{k:03d}" for k in range(count)]),
        time_unix=times,
        station=np.full(count, curve.station),
        antenna=np.full(count, curve.antenna),
        dipole=np.full(count, curve.dipole),
        blocks=np.ones(count, dtype=np.int64),
        environment=environment,
    )


def _tell(named: Sequence[tuple[AdoptedCause, Hypothesis]], temperature_c: float | None) -> Iterator[str]:
    """What acts, and what of the instant it was not told."""
    for adopted, one in named:
        size = f"{one.size:.3g} ± {one.sigma:.2g} ({adopted.in_catalogue.unit})"
        yield f"with the adopted cause {adopted.cause} in {adopted.target}, {size}"
    columns = {name for _, one in named for name in one.cause.covariates(one.template)}
    if TEMPERATURE in columns and temperature_c is None:
        yield f"adopted causes follow the temperature, which is not given: {REFERENCE_C:g} deg C is taken"
    if TEMPERATURE not in columns and temperature_c is not None:
        yield UNUSED
    if others := ", ".join(sorted(columns - {TEMPERATURE})):
        yield f"what adopted causes do with {others} is not in it"
