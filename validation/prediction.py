"""What a path is predicted to see, against events that no fit has seen.

A campaign is a year of one station of the Superterp, eight antennas, simulated by the twin; every second event is
fitted. `events`: each of the others in each path is predicted at its own time, with the noise that was measured in the
fitted ones; gains of events are each path's own, so that all are independent. `together`: antennas share a part of an
event's gain, and the mean of the eight scatters as that of events drawn together does. `one-trace`: one of the fitted
events stands for all hours, as noise that was recorded once does. Trials are campaigns.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

import lbacal
from lbacal_core.calibration.prediction import EventNoise, predict_path
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.blocks import split_into_blocks
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings
from validation.machinery.claims import Found, mean_of, worst_of
from validation.machinery.parts import Part, Row
from validation.superterp import superterp

OWN = TwinSettings(stations=("CS002",), antennas=8, events_per_year=800, event_gain_common=0.0)
SHARED_GAINS = TwinSettings(stations=("CS002",), antennas=8, events_per_year=800)
AT = "2014-05-01"
DRAWN = 20_000


@cache
def believed() -> Simulation:
    return Simulation(superterp())


def fit_every_second(settings: TwinSettings, seed: int) -> tuple[lbacal.Calibration, Spectra]:
    """The fit of every second event of a campaign, and the other events."""
    rng = np.random.default_rng([2014_05_01, seed])
    spectra = simulate_campaign(settings, superterp(), believed().sky_power, rng).spectra
    is_fitted = np.isin(spectra.event_id, np.unique(spectra.event_id)[::2])
    return lbacal.fit(spectra.select(is_fitted), believed()), spectra.select(~is_fitted)


def predict_events(seed: int) -> Row:
    """chi^2 per degree of freedom of held-out events, by channel and as all channels move together."""
    found, held_out = fit_every_second(OWN, seed)
    square, count, whole, events = np.zeros(51), np.zeros(51), 0.0, 0
    for curve in found.report.curves:
        noise, at = EventNoise.measured(curve, found.spectra, found.simulation), curve.has_value
        if noise is None:
            raise ValueError(f"{curve.name}: {curve.status}")
        for k in np.flatnonzero((held_out.antenna == curve.antenna) & (held_out.dipole == curve.dipole)):
            told = predict_path(curve, found.simulation, float(held_out.time_unix[k]), noise)
            left = held_out.power[k, at] / told.power - 1.0
            covariance = noise.covariance() + told.errors.T @ told.errors
            square[at] += left**2 / np.diag(covariance)
            count[at] += 1
            whole += float(left @ np.linalg.solve(covariance, left)) / left.size
            events += 1
    return {"events": events, "chi2": np.round(square / count, 4).tolist(), "whole": round(whole / events, 5)}


def draw_station(seed: int) -> Row:
    """Variance of the mean of eight antennas in held-out events, over that of events drawn together, and apart."""
    found, rest = fit_every_second(SHARED_GAINS, seed)
    held_out = split_into_blocks(rest)[0]
    curves = {curve.path: curve for curve in found.report.curves}
    paths = [(held_out.station, antenna, held_out.dipole) for antenna in held_out.antennas.tolist()]
    sky = found.simulation.sky_at(held_out.station, held_out.dipole, held_out.time_unix)
    left = [held_out.power[k] / found.simulation.power(curves[path], sky) - 1.0 for k, path in enumerate(paths)]
    told = [lbacal.predict(found, at=AT, station=name, antenna=k, dipole=letter) for name, k, letter in paths]
    together = [drawn / one.power - 1.0 for drawn, one in zip(lbacal.draw_together(told, DRAWN), told, strict=True)]
    apart = [one.draw_events(DRAWN, k) / one.power - 1.0 for k, one in enumerate(told)]
    # the mean over the channels in which C of the path is known, shape (antenna, event)
    gains = [np.array([np.nanmean(one, axis=1) for one in each]) for each in (left, together, apart)]
    held, joint, alone = (float(np.var(one.mean(axis=0))) for one in gains)
    pair, of_pair = (float(np.cov(one[:2])[0, 1]) for one in gains[:2])
    common = float(np.mean([one.content["noise"]["common"] for one in told]))
    return {"together": held / joint, "apart": held / alone, "common": common, "pair": pair, "of_pair": of_pair}


def stand_one_trace_for_all(seed: int) -> Row:
    """Largest error in an hour of LST of the band's mean power, dB: one recorded trace for all hours, and `predict`."""
    found, rest = fit_every_second(OWN, seed)
    held_out, recorded = split_into_blocks(rest)[0], split_into_blocks(found.spectra)[0]
    curve = next(
        one for one in found.report.curves if one.path == (held_out.station, held_out.antennas[0], held_out.dipole)
    )
    at, sky = curve.has_value, found.simulation.sky_at(held_out.station, held_out.dipole, held_out.time_unix)
    events = np.flatnonzero(np.all(np.isfinite(recorded.power[0]), axis=1))
    one_trace = recorded.power[0, np.random.default_rng(seed).choice(events)]
    seen = held_out.power[0][:, at].mean(axis=1)
    hour = local_sidereal_time(held_out.time_unix, superterp().at_station(held_out.station).longitude_deg).astype(int)
    row: Row = {}
    for name, expected in (("one_trace", one_trace[None]), ("predicted", found.simulation.power(curve, sky))):
        ratio = seen / expected[:, at].mean(axis=1)
        by_hour = [np.nanmean(ratio[hour == one]) for one in range(24)]
        row[name] = round(float(np.nanmax(np.abs(10.0 * np.log10(by_hour)))), 3)
    return row


def judge_events(rows: Sequence[Row]) -> list[Found]:
    each = np.array([row["chi2"] for row in rows]).T
    events = sum(row["events"] for row in rows)
    return [
        worst_of([mean_of("chi2", one) for one in each], events),
        mean_of("whole", np.array([row["whole"] for row in rows])),
    ]


def judge_station(rows: Sequence[Row]) -> list[Found]:
    return [mean_of(name, np.array([row[name] for row in rows])) for name in ("together", "apart", "common")]


def judge_one_trace(rows: Sequence[Row]) -> list[Found]:
    return [mean_of(name, np.array([row[name] for row in rows])) for name in ("one_trace", "predicted")]


PARTS = (
    Part("events", predict_events, judge_events, 24, headlines=("chi2",)),
    Part("together", draw_station, judge_station, 24),
    Part("one-trace", stand_one_trace_for_all, judge_one_trace, 24),
)
