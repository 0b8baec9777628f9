"""From spectra to calibration curves: lines first, then the chain that ties their intercepts together.

Read `fit_calibration` from top to bottom. The scopes differ only in what counts as a path: every antenna's dipole,
or the mean over the antennas of a station or of the array, which has the same chain with the mean power gain.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from lbacal_core.calibration.chain_test import (
    LIKELY_MISTAKE,
    FittedPaths,
    Tried,
    describe_mistakes,
    is_improbable,
    name_mistakes,
)
from lbacal_core.calibration.channels import (
    SMALLEST_BAND,
    Booleans,
    describe_merged,
    flag_channels,
    solve_without_interference,
)
from lbacal_core.calibration.continued import keep_lines
from lbacal_core.calibration.gain_waves import (
    GAIN_WAVES,
    GainWaves,
    describe_gain_waves,
    see_gain_waves,
    stations_that_follow,
)
from lbacal_core.calibration.lines import Lines, find_free, fit_lines
from lbacal_core.calibration.paths import (
    LST_BINS,
    MIN_LST_BINS,
    Cables,
    Paths,
    paths_of_scope,
    require_one_cable_each,
    unchanged_cables,
)
from lbacal_core.calibration.separable import SeparableSolution
from lbacal_core.calibration.singles import FEWEST_EVENTS, MIN_EVENTS, chain_forms
from lbacal_core.calibration.spreads import measure_spreads
from lbacal_core.calibration.years import Beside, Together, lend, pick_beside, solve_together, weigh_by_members
from lbacal_core.curves.covariance import CurveCovariance, compress_covariance
from lbacal_core.curves.curves import (
    CONVERGED,
    MISFIT,
    NOT_CONVERGED,
    NOT_IDENTIFIABLE,
    OUTSIDE,
    TOO_FEW_EVENTS,
    TOO_FEW_LST_BINS,
    Anomaly,
    CalibrationCurve,
    FitReport,
    Parameter,
    SkyOverModel,
)
from lbacal_core.curves.kept_lines import KeptLines, MemberLines, Owner
from lbacal_core.curves.reference_chain import CableTable, ReferenceChain
from lbacal_core.errors import BadInputError, require_name
from lbacal_core.grids import Floats, require_same_grid
from lbacal_core.instrument.chain import Intercepts, calibration_factor
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.linear import fit_least_squares
from lbacal_core.provenance import Provenance
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.blocks import Recorded

SCOPES = ("array", "station", "antenna")
ONE_TIME_BINS = 12
"""Three hours: days on end at one sidereal time show a spectrum, and no change along LST whose slope is C."""
SMALLEST_OF_LIMIT = 0.7
"""Scatter over the least that radiometer noise allows; that of amplitudes instead of powers is at most 0.56."""
MOST_NEGATIVE = 6.0
"""Standard deviations by which a noise constant is negative, and neither by chance nor by another sky."""
REVERSED, LEAST_REVERSED = "channels in reverse order", 0.3
"""R.m.s. of ln C^2 over that of the chain, its slope left out, that is at least halved by the other order."""
SHARE_OF_MISFITS = 0.5
TOO_SMALL = (TOO_FEW_EVENTS, TOO_FEW_LST_BINS)
"""What a window with the same hardware, or the nearest, makes up for."""


def fit_calibration(
    spectra: Recorded, simulation: Simulation, scope: str = "antenna", beside: Sequence[Beside] = ()
) -> FitReport:
    """Calibrate every antenna, every station or the whole array.

    Parameters
    ----------
    spectra
        The spectra of the window to be calibrated: one fit uses them all. For the array they may be read station by
        station.
    simulation
        On the same channels as the spectra. Data that its prior of P_sky does not allow for are a misfit.
    scope
        ``antenna`` (one curve a path), ``station`` or ``array`` (one curve a polarisation).
    beside
        What is kept of fits of the same scope in other windows, the nearest first: one chain is fitted to all.

    Returns
    -------
    One curve per path, or per station or array and polarisation. The status of a curve gives the reason where the fit
    failed. A curve of a station or of the array is that of a reference chain, which the report states beside it, as it
    does the anomalous spectra that were left out.
    """
    require_name("scope", scope, SCOPES)
    instrument, prior = simulation.instrument, simulation.prior
    head = spectra.head
    require_same_grid(head.origin, head.frequency_mhz, instrument.frequency_mhz, f"instrument {instrument.name}")
    if len(spectra) == 0:
        raise BadInputError(head.origin, "at least one spectrum", "none")
    away = {name for one in beside if one.lines.members is not None for name in one.lines.members.names}
    same = unchanged_cables(away, *spectra.span_unix, instrument)
    cable_of = {**same, **require_one_cable_each(spectra, instrument)}
    table = CableTable.of(instrument)

    def elsewhere(owner: Owner) -> list[MemberLines]:
        own = [one for one in pick_beside(beside, owner) if one.is_same[0] and one.lines.is_good[0]]
        return [one.lines.members.select(same) for one in own if one.lines.members is not None]

    def fit_paths(read: Callable[[], Paths]) -> _Fitted:
        paths = read()
        station, _, letter = paths.owners[0]
        sky = simulation.sky_power.of_station(station).at(letter, paths.lst_hours)
        loss = _losses(paths, instrument, cable_of)
        events = int(np.isfinite(paths.relative_variance[0]).sum())
        others, share = weigh_by_members(pick_beside(beside, paths.owners[0]), paths.member_lines, events)
        curves, lines, waves = _fit_paths(paths, sky, simulation, loss, others, share)
        chains = [_chain_of(curve, paths, instrument, table, cable_of) for curve, _ in curves]
        of_paths = [(*curve, chain) for curve, chain in zip(curves, chains, strict=True)]
        digests = [spectra.digest(*owner) for owner in paths.owners]
        kept = keep_lines(
            paths, lines.weigh(1.0 / share), [curve for curve, _ in curves], simulation.form, loss, digests
        )
        return of_paths, paths.anomalies, kept, (station, waves)

    # NumPy leaves the interpreter's lock in its loops, so blocks of paths share the cores as threads; the threads that
    # BLAS would start within each cost twice the time.
    with threadpool_limits(1), ThreadPoolExecutor(os.cpu_count()) as pool:
        digest = pool.submit(spectra.digest)
        batches = list(pool.map(fit_paths, paths_of_scope(spectra, simulation, scope, cable_of, elsewhere)))
    fitted = [one for curves, *_ in batches for one in curves]
    fitted.sort(key=lambda c: (c[0].station or "", -1 if c[0].antenna is None else c[0].antenna, c[0].dipole or ""))
    mistaken = {} if prior is None else name_mistakes([(curve, tried) for curve, tried, _ in fitted], prior.mistakes)
    mistaken |= {curve.owner: REVERSED for curve, *_ in fitted if _is_reversed(curve, instrument)}
    following = stations_that_follow([waves for *_, waves in batches])
    curves = _share_misfits(
        [
            curve.as_misfit()
            if curve.c is not None and (curve.owner in mistaken or curve.station in following)
            else curve
            for curve, *_ in fitted
        ]
    )
    good = {curve.path for curve in curves if curve.status == CONVERGED}
    provenance = Provenance(
        inputs={
            "spectra": digest.result(),
            "instrument": _digest_of(instrument, spectra, scope),
            "sky_power": simulation.sky_power.digest(),
        },
        settings={
            "scope": scope,
            "min_events": MIN_EVENTS,
            "min_lst_bins": MIN_LST_BINS,
            "sky_freedom": None if prior is None else prior.digest,
        },
        notes={"antenna_gain": instrument.antenna_gain_note, "sky_power": simulation.sky_power.note_for(instrument)}
        | ({"noise_constants": simulation.noise.describe()} if instrument.stages else {})
        | ({LIKELY_MISTAKE: describe_mistakes(mistaken)} if mistaken else {})
        | ({GAIN_WAVES: describe_gain_waves(following)} if following else {}),
    )
    return FitReport(
        tuple(curves),
        provenance,
        tuple(chain for *_, chain in fitted),
        tuple(anomaly for _, anomalies, *_ in batches for anomaly in anomalies),
        lines=tuple(lines.lend(good) for *_, lines, _ in batches),
    )


def _digest_of(instrument: Instrument, spectra: Recorded, scope: str) -> str:
    """The hash of what the curves of these spectra take from the instrument."""
    (first, last), stations = spectra.span_unix, list({station for station, *_ in spectra.quarter_hashes})
    station = stations[0] if scope != "array" and len(stations) == 1 else None
    return instrument.digest_of(first, float(np.nextafter(last, np.inf)), station)


def _is_reversed(curve: CalibrationCurve, instrument: Instrument) -> bool:
    """Whether the slopes of a curve have the form of the chain in the other order, as a mirrored band has."""
    if curve.c is None:
        return False
    gain = np.log(instrument.antenna_gain)
    chain, found = gain + np.log(instrument.receiver_gain), gain - 2.0 * np.log(curve.filled(curve.c))
    line = np.stack([np.ones(gain.size), curve.frequency_mhz], axis=1)
    left = np.stack([found - chain, found[::-1] - chain], axis=1)
    straight, reverse = np.std(left - line @ fit_least_squares(line, left), axis=0)
    return bool(straight > max(LEAST_REVERSED, 2.0 * reverse))


_Fitted = tuple[
    list[tuple[CalibrationCurve, Tried, ReferenceChain | None]],
    Sequence[Anomaly],
    KeptLines,
    tuple[str | None, GainWaves | None],
]


def _chain_of(
    curve: CalibrationCurve, paths: Paths, instrument: Instrument, table: CableTable, cable_of: Cables
) -> ReferenceChain | None:
    """What a converged curve belongs to, with the departures of the paths behind it."""
    if curve.c is None:
        return None
    if curve.antenna is not None:
        own = (str(curve.station), curve.antenna)
        return ReferenceChain((own,), instrument.cables[cable_of[own]], table, None)
    mean_loss = np.mean([instrument.cables[cable_of[member]] for member in paths.members], axis=0)
    # departures in a channel without C are of no use, but finite
    slope = instrument.antenna_gain / curve.filled(curve.c) ** 2
    spreads = None if paths.singles is None else measure_spreads(paths.singles, slope, mean_loss)
    return ReferenceChain(tuple(sorted(paths.members)), mean_loss, table, spreads)


def _losses(paths: Paths, instrument: Instrument, cable_of: Cables) -> Floats:
    """L_coax of each path, of a mean the mean over its members, shape (path, freq)."""
    members = [paths.members if antenna is None else [(str(s), antenna)] for s, antenna, _ in paths.owners]
    none = np.ones((1, instrument.frequency_mhz.size))
    return np.array([np.mean([instrument.cables[cable_of[one]] for one in of] or none, axis=0) for of in members])


def _fit_paths(
    paths: Paths, sky: Floats, simulation: Simulation, loss: Floats, beside: Sequence[Beside], share: float
) -> tuple[list[tuple[CalibrationCurve, Tried]], Lines, GainWaves | None]:
    """The chain fitted to the lines of a batch of paths, with the status of each and the mistakes tried.

    And what their mean says of gains along LST, where the sky may be wrong. `share` is the part of the information of
    the lines that counts (`weigh_by_members`).
    """
    instrument, terms = simulation.instrument, simulation.noise
    events = np.isfinite(paths.relative_variance).sum(axis=1)
    covered = paths.count_lst_bins()
    is_small = (events < MIN_EVENTS) | (covered < MIN_LST_BINS)
    chains = _fit_chain(paths, events, covered, sky, simulation, loss, beside, share)
    status, at, lines, (alone, free_alone), together = chains
    solution, is_free = together.solution, together.is_free
    channels = instrument.frequency_mhz.size
    variance = np.einsum("pii->pi", solution.covariance)
    with np.errstate(invalid="ignore", divide="ignore"):
        c = calibration_factor(solution.x, instrument.antenna_gain)
        # ln C = -ln(s) / 2 + const
        relative_error = np.sqrt(variance[:, :channels]) / (2.0 * solution.x)
    flag = flag_channels(np.where(c > 0, relative_error, np.nan), is_free | find_free(lines.information[at]))
    has_value = flag != OUTSIDE
    is_usable = has_value.mean(axis=1) >= SMALLEST_BAND
    is_fitted = status[at] == CONVERGED
    status[at[is_fitted & ~solution.is_converged]] = NOT_CONVERGED
    status[at[is_fitted & ~(solution.is_identifiable & is_usable)]] = NOT_IDENTIFIABLE
    has_c = status == CONVERGED
    # a window is judged by itself, where it can be: what is wrong with another is no misfit of this one
    rest = np.flatnonzero(~(alone.is_converged & alone.is_identifiable))
    alone, free_alone = alone.exchange(rest, solution.take(rest)), free_alone.copy()
    free_alone[rest] = is_free[rest]
    good = np.flatnonzero(has_c & ~is_small)
    of_good = np.searchsorted(at, good)
    fitted = FittedPaths(
        paths.power[good], sky, paths.relative_variance[good], paths.lst_hours, lines.select(good), alone.n[of_good],
        alone.x[of_good], terms, free_alone[of_good], simulation.prior, paths.owners[0][2],
    )  # fmt: skip
    tested, waves = fitted.test(), see_gain_waves(fitted, chain_forms(instrument))
    scatter = np.median(lines.levels.radiometer, axis=1) if paths.scatter is None else paths.scatter
    is_odd = scatter[good] < SMALLEST_OF_LIMIT * paths.smallest_scatter
    is_odd |= np.any(tested.behind < -MOST_NEGATIVE, axis=1)
    is_unlikely = is_improbable(alone.chi2[of_good], _count_dof(alone, free_alone, terms)[of_good])
    dof = _count_dof(solution, is_free, terms)
    is_misfit = set(good[tested.is_misfit | (is_odd & is_unlikely)].tolist())
    profiled = dict(zip(good.tolist(), tested.per_dof.tolist(), strict=True))
    tried = dict(zip(good.tolist(), tested.tried, strict=True))
    none = Tried(np.zeros(tested.gain.shape[1]), np.ones(tested.gain.shape[1], dtype=bool))
    curves = []
    for k, (station, antenna, dipole) in enumerate(paths.owners):
        is_good, j = bool(has_c[k]), int(np.searchsorted(at, k))
        values = (*solution.n[j], *solution.q[j]) if is_good else ()
        sigmas = np.sqrt(variance[j, channels:]) if is_good else ()
        curve = CalibrationCurve(
            station=station,
            antenna=antenna,
            dipole=dipole,
            status=status[k],
            events=int(events[k]),
            frequency_mhz=instrument.frequency_mhz,
            c=np.where(has_value[j], c[j], np.nan) if is_good else None,
            c_sigma_stat=np.where(has_value[j], c[j] * relative_error[j], np.nan) if is_good else None,
            c_sigma_sys=None,
            chi2_per_dof=float(solution.chi2[j] / dof[j]) if is_good else None,
            lst_coverage=float(covered[k] / LST_BINS),
            parameters={
                name: Parameter(float(value), float(sigma))
                for name, value, sigma in zip(terms.names, values, sigmas, strict=False)
            },
            flag=tuple(flag[j].tolist()) if is_good else None,
            chi2_per_dof_profiled=profiled.get(k),
            covariance=_covariance_of(solution.x[j], solution.covariance[j], has_value[j]) if is_good else None,
            antenna_gain=instrument.antenna_gain,
            sky_over_model=_sky_over_model(c[j], solution, j, instrument.kelvin_error) if is_good else None,
            merged=describe_merged(solution, j, terms) if is_good else None,
            repeated=together.describe(j) if is_good else None,
            span_unix=paths.find_span(k),
        )
        curves.append((curve.as_misfit() if k in is_misfit else curve, tried.get(k, none)))
    return curves, lines, waves


def _fit_chain(
    paths: Paths, events: NDArray[np.int64], covered: NDArray[np.int64], sky: Floats, simulation: Simulation,
    loss: Floats, beside: Sequence[Beside], share: float,
) -> tuple[NDArray[np.object_], NDArray[np.intp], Lines, tuple[SeparableSolution, Booleans], Together]:  # fmt: skip
    """The status of each path before its curve is looked at, those that are fitted, all lines, and the chains.

    The chains by the window alone, with which intercepts are free, and by all windows.
    """
    known, terms, instrument = paths.fits, simulation.noise, simulation.instrument
    forms = chain_forms(instrument)
    lines = known.lines if known else fit_lines(paths.power, sky, paths.relative_variance, forms, paths.time_unix)
    lines = lines.weigh(share)
    status = np.full(len(paths.owners), CONVERGED, dtype=object)
    status[~_sees_the_sky_vary(lines)] = NOT_IDENTIFIABLE
    status[covered < MIN_LST_BINS] = TOO_FEW_LST_BINS
    status[covered < ONE_TIME_BINS] = NOT_IDENTIFIABLE
    status[events < MIN_EVENTS] = TOO_FEW_EVENTS
    at = np.flatnonzero(status == CONVERGED)
    plain = None if known is None else known.solution.take(np.searchsorted(known.solved, at))
    alone = solve_without_interference(lines.slope[at], lines.intercept[at], lines.information[at], terms, plain)
    is_small = np.isin(status, TOO_SMALL) & (events >= FEWEST_EVENTS)
    for lent in lend(beside, is_small, paths, sky, loss, terms):
        lines, at, alone = lines.exchange(lent.at, lent.lines), *lent.insert_into(at, *alone)
    owners = [paths.owners[k] for k in at.tolist()]
    together = solve_together(
        lines.select(at), owners, loss[at], terms, beside, instrument.frequency_mhz, *alone, is_small[at]
    )
    status[at[is_small[at] & (together.windows > 1)]] = CONVERGED
    return status, at, lines, alone, together


def _count_dof(solution: SeparableSolution, is_free: Booleans, terms: Intercepts) -> NDArray[np.intp]:
    """Degrees of freedom of chi^2 of the lines, shape (path,): merged constants are one."""
    used = terms.free_count + is_free.sum(axis=1) - np.maximum(solution.is_merged.sum(axis=1) - 1, 0)
    return np.asarray(solution.x.shape[1] - used)


def _covariance_of(slope: Floats, covariance: Floats, has_value: NDArray[np.bool_]) -> CurveCovariance:
    """The statistical covariance of ln C = -ln(s) / 2 + const."""
    derivative = np.where(has_value, 0.5 / slope, np.nan)
    channels = slope.size
    of_log_c = covariance[:channels, :channels] * np.outer(derivative, derivative)
    return CurveCovariance(*compress_covariance(of_log_c), None, np.zeros((0, channels)))


def _sky_over_model(c: Floats, solution: SeparableSolution, path: int, error: float | None) -> SkyOverModel | None:
    """The sky over its model, where the laboratory knows C within an error."""
    if error is None:
        return None
    derivative = 0.5 / solution.x[path]
    return SkyOverModel.of(c, solution.covariance[path][: c.size, : c.size] * np.outer(derivative, derivative), error)


def _share_misfits(curves: Sequence[CalibrationCurve]) -> list[CalibrationCurve]:
    """Curves with the misfit of their station: all of a station share clock, sky and pattern.

    Where most paths of one polarisation misfit, what is wrong is wrong with all paths of the station.
    """
    groups: dict[tuple[str | None, str | None], list[bool]] = {}
    for curve in curves:
        if curve.c is not None:
            groups.setdefault((curve.station, curve.dipole), []).append(curve.status == MISFIT)
    wrong = {station for (station, _), misfits in groups.items() if np.mean(misfits) >= SHARE_OF_MISFITS}
    return [curve.as_misfit() if curve.status == CONVERGED and curve.station in wrong else curve for curve in curves]


def _sees_the_sky_vary(lines: Lines) -> NDArray[np.bool_]:
    """Whether the typical channel's slope, its intercept free, differs from zero by three standard deviations."""
    channels = lines.slope.shape[1]
    of_slope = np.einsum("pii->pi", lines.information)[:, :channels]
    of_intercept = np.einsum("pii->pi", lines.information)[:, channels:]
    shared = np.einsum("pii->pi", lines.information[:, :channels, channels:])
    alone = 1.0 - shared**2 / np.maximum(of_slope * of_intercept, 1e-300)
    significance = lines.slope * np.sqrt(np.maximum(of_slope, 0.0) * np.where(alone > 1e-10, alone, 0.0))
    return np.asarray(np.median(significance, axis=1) > 3.0)
