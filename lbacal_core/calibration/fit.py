"""From spectra to calibration curves: lines first, then the chain that ties their intercepts together.

Read `fit_calibration` from top to bottom. The scopes differ only in what counts as a path: every antenna's dipole,
or the mean over the antennas of a station or of the array, which has the same chain with the mean power gain.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from lbacal_core.anomalies import Anomaly
from lbacal_core.calibration.channels import SMALLEST_BAND, flag_channels, solve_without_interference
from lbacal_core.calibration.lines import ChainForms, Lines, fit_lines
from lbacal_core.calibration.separable import solve_separable
from lbacal_core.calibration.spreads import SinglePaths, join_paths, measure_spreads
from lbacal_core.chain.model import calibration_factor
from lbacal_core.curves import (
    CONVERGED,
    NOT_CONVERGED,
    NOT_IDENTIFIABLE,
    OUTSIDE,
    TOO_FEW_EVENTS,
    TOO_FEW_LST_BINS,
    CalibrationCurve,
    FitReport,
    Parameter,
)
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats, require_same_grid
from lbacal_core.instrument import Instrument
from lbacal_core.provenance import Provenance
from lbacal_core.reference_chain import CableTable, ReferenceChain
from lbacal_core.screening import screen_block
from lbacal_core.sidereal import local_sidereal_time
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra import Spectra
from lbacal_core.spectra_blocks import SpectraBlock, iterate_blocks, split_into_blocks

SCOPES = ("array", "station", "antenna")
MIN_EVENTS = 60
"""Fewer events leave C worse than 2 % and the noise levels worse than 10 %."""
LST_BINS = 96
"""The 15-minute bins of section 3.1 of the paper."""
MIN_LST_BINS = 24
"""A quarter of the sidereal day: less sees the Galaxy neither rise nor set."""
SHARE_OF_STEADY_PATHS = 0.5


@dataclass(frozen=True)
class _Paths:
    """Paths to be fitted together: who they are, what was recorded and when.

    A mean of paths is one, with the (station, antenna) it is the mean of and what each of these gave by itself.
    `relative_variance` is infinite for spectra that are absent or, as `anomalies` says, left out.
    """

    owners: list[tuple[str | None, int | None, str]]
    power: Floats
    relative_variance: Floats
    lst_hours: Floats
    anomalies: Sequence[Anomaly] = ()
    members: Sequence[tuple[str, int]] = ()
    singles: SinglePaths | None = None


def fit_calibration(spectra: Spectra, instrument: Instrument, sky_power: SkyPower, scope: str = "antenna") -> FitReport:
    """Calibrate every antenna, every station or the whole array.

    Parameters
    ----------
    spectra
        The spectra of the window to be calibrated: one fit uses them all.
    instrument, sky_power
        On the same channels as the spectra.
    scope
        ``antenna`` (one curve a path), ``station`` or ``array`` (one curve a polarisation).

    Returns
    -------
    One curve per path, or per station or array and polarisation. The status of a curve gives the reason where the fit
    failed. A curve of a station or of the array is that of a reference chain, which the report states beside it, as it
    does the anomalous spectra that were left out.
    """
    if scope not in SCOPES:
        raise BadInputError("scope", ", ".join(SCOPES), repr(scope))
    require_same_grid(spectra.origin, spectra.frequency_mhz, instrument.frequency_mhz, f"instrument {instrument.name}")
    require_same_grid(
        sky_power.origin, sky_power.frequency_mhz, instrument.frequency_mhz, f"instrument {instrument.name}"
    )
    sky_power.require_made_for(instrument)
    if len(spectra) == 0:
        raise BadInputError(spectra.origin, "at least one spectrum", "none")
    cable_of = require_one_cable_each(spectra, instrument)
    table = CableTable.of(instrument)

    def fit_paths(paths: _Paths) -> _Fitted:
        sky = sky_power.at(paths.owners[0][2], paths.lst_hours)
        forms = ChainForms.of(instrument.frequency_mhz, instrument.antenna_gain, instrument.receiver_gain)
        curves = _fit_paths(paths, fit_lines(paths.power, sky, paths.relative_variance, forms), instrument)
        return [(curve, _chain_of(curve, paths, instrument, table, cable_of)) for curve in curves], paths.anomalies

    # NumPy leaves the interpreter's lock in its loops, so blocks of paths share the cores as threads; the threads that
    # BLAS would start within each cost twice the time.
    with threadpool_limits(1), ThreadPoolExecutor(os.cpu_count()) as pool:
        digest = pool.submit(spectra.digest)
        batches = list(pool.map(fit_paths, _paths_of_scope(spectra, instrument, sky_power, scope, cable_of)))
    fitted = [one for curves, _ in batches for one in curves]
    fitted.sort(key=lambda c: (c[0].station or "", -1 if c[0].antenna is None else c[0].antenna, c[0].dipole or ""))
    provenance = Provenance(
        inputs={
            "spectra": digest.result(),
            "instrument": instrument.digest(),
            "sky_power": sky_power.digest(),
        },
        settings={"scope": scope, "min_events": MIN_EVENTS, "min_lst_bins": MIN_LST_BINS},
        notes={"antenna_gain": instrument.antenna_gain_note, "sky_power": sky_power.note_for(instrument)},
    )
    return FitReport(
        tuple(curve for curve, _ in fitted),
        provenance,
        tuple(chain for _, chain in fitted),
        tuple(anomaly for _, anomalies in batches for anomaly in anomalies),
    )


_Fitted = tuple[list[tuple[CalibrationCurve, ReferenceChain | None]], Sequence[Anomaly]]


Cables = Mapping[tuple[str, int], str]
"""The cable of each (station, antenna) over the window of a fit."""


def require_one_cable_each(spectra: Spectra, instrument: Instrument) -> Cables:
    """The cable of every antenna: each must be known to the instrument and keep its cable over the window."""
    found: dict[tuple[str, int], str] = {}
    first, last = float(spectra.time_unix.min()), float(spectra.time_unix.max())
    stations, station_at = spectra.key_codes["station"]
    for k, station in enumerate(stations):
        for antenna in np.unique(spectra.antenna[station_at == k]):
            try:
                cables = instrument.cables_between(str(station), int(antenna), first, last)
            except BadInputError as error:
                row = int(np.flatnonzero((spectra.station == station) & (spectra.antenna == antenna))[0])
                place = f"{spectra.origin}: antenna, row {row}: {error.place}"
                raise BadInputError(place, error.expected, error.found) from error
            if len(cables) > 1:
                raise BadInputError(
                    f"{spectra.origin}: station {station}, antenna {antenna}",
                    "one cable over the window: fit the time before and after the change separately",
                    f"cables {', '.join(cables)}",
                )
            found[str(station), int(antenna)] = cables[0]
    return found


def _paths_of_scope(
    spectra: Spectra, instrument: Instrument, sky_power: SkyPower, scope: str, cable_of: Cables
) -> Iterable[_Paths]:
    typical = float(np.median(spectra.blocks))
    if scope == "antenna":
        for block in iterate_blocks(spectra):
            yield _paths_of_block(block, instrument, typical)
        return
    blocks = split_into_blocks(spectra)
    groups = {(block.station if scope == "station" else None, block.dipole) for block in blocks}
    for station, dipole in sorted(groups, key=lambda key: (key[0] or "", key[1])):
        members = [b for b in blocks if b.dipole == dipole and station in (None, b.station)]
        parts = [_paths_of_block(b, instrument, typical, is_for_mean=True) for b in members]
        yield _mean_path(parts, members, instrument, sky_power, station, cable_of)


def _paths_of_block(
    block: SpectraBlock, instrument: Instrument, typical_blocks: float, *, is_for_mean: bool = False
) -> _Paths:
    """The paths of a block without anomalous spectra; for a mean without those paths that have too many of them.

    Where most paths have too many, they are what the station records, and are averaged.
    """
    screened = screen_block(block, instrument.longitude_deg)
    with np.errstate(divide="ignore"):
        relative_variance = typical_blocks / screened.block.blocks
    if is_for_mean and np.mean(screened.is_steady) > SHARE_OF_STEADY_PATHS:
        relative_variance[~screened.is_steady] = np.inf
    return _Paths(
        owners=[(block.station, int(antenna), block.dipole) for antenna in block.antennas],
        power=screened.block.power,
        relative_variance=relative_variance,
        lst_hours=local_sidereal_time(block.time_unix, instrument.longitude_deg),
        anomalies=screened.anomalies,
    )


def _mean_path(
    parts: list[_Paths],
    blocks: list[SpectraBlock],
    instrument: Instrument,
    sky_power: SkyPower,
    station: str | None,
    cable_of: Cables,
) -> _Paths:
    """The mean over antennas as a path of its own, the reference chain.

    In each event the deviations from each antenna's own lines, over the antennas present, are put on the mean of the
    lines: an antenna missing from an event then does not pull the mean towards the others. An antenna counts with its
    power, as in the mean of the lines. If all counted alike, the scatter would be that of a mean which weak antennas
    (long cables) enter as much as strong ones, and the variance of C would be too small by 1 + var(P_p) / mean(P_p)^2,
    1.15 for the cables of the Superterp.
    """
    events = np.unique(np.concatenate([block.event_id for block in blocks]))
    dipole = blocks[0].dipole
    channels = blocks[0].frequency_mhz.size
    deviation, total = np.zeros((events.size, channels)), np.zeros((events.size, channels))
    share, scatter = np.zeros(events.size), np.zeros(events.size)
    lst_hours = np.zeros(events.size)
    slope, intercept = np.zeros(channels), np.zeros(channels)
    members: list[tuple[str, int]] = []
    singles: list[SinglePaths] = []
    for part, block in zip(parts, blocks, strict=True):
        at = np.searchsorted(events, block.event_id)
        lst_hours[at] = part.lst_hours
        has_enough = np.isfinite(part.relative_variance).sum(axis=1) >= MIN_EVENTS
        if not np.any(has_enough):
            continue
        power, variance = part.power[has_enough], part.relative_variance[has_enough]
        is_present = np.isfinite(variance)
        sky = sky_power.at(dipole, part.lst_hours)
        lines = fit_lines(
            power,
            sky,
            variance,
            ChainForms.of(instrument.frequency_mhz, instrument.antenna_gain, instrument.receiver_gain),
        )
        expected = lines.power(sky)
        deviation[at] += np.einsum("pe,pef->ef", is_present, power - expected)
        total[at] += np.einsum("pe,pef->ef", is_present, expected)
        of_path = expected.mean(axis=(1, 2))[:, None] * is_present
        share[at] += of_path.sum(axis=0)
        scatter[at] += np.sum(of_path**2 * np.where(is_present, variance, 0.0), axis=0)
        slope += lines.slope.sum(axis=0)
        intercept += lines.intercept.sum(axis=0)
        averaged = [(block.station, int(antenna)) for antenna in block.antennas[has_enough]]
        members += averaged
        singles.append(_single_paths(averaged, lines, instrument, cable_of))
    has_data = share > 0
    sky = sky_power.at(dipole, lst_hours)
    mean = (slope * sky + intercept) / max(len(members), 1)
    power = np.where(has_data[:, None], mean * (1.0 + deviation / np.where(has_data[:, None], total, 1.0)), 1.0)
    relative_variance = np.where(has_data, scatter / np.where(has_data, share, 1.0) ** 2, np.inf)
    if np.any(has_data):
        relative_variance /= np.median(relative_variance[has_data])
    return _Paths(
        [(station, None, dipole)],
        power[None],
        relative_variance[None],
        lst_hours,
        [anomaly for part in parts for anomaly in part.anomalies],
        members,
        join_paths(singles) if singles else None,
    )


def _single_paths(owners: list[tuple[str, int]], lines: Lines, instrument: Instrument, cable_of: Cables) -> SinglePaths:
    """The slopes of paths fitted by themselves; NaN where the fit determined none."""
    solution = solve_separable(lines.slope, lines.intercept, lines.information, _design(instrument))
    channels = instrument.frequency_mhz.size
    variance = np.einsum("pii->pi", solution.covariance)[:, :channels]
    is_good = (solution.is_converged & solution.is_identifiable)[:, None] & np.isfinite(solution.x) & (variance > 0)
    cables = [cable_of[owner] for owner in owners]
    return SinglePaths(
        stations=np.array([station for station, _ in owners]),
        cables=np.array(cables),
        slope=np.where(is_good, solution.x, np.nan),
        sigma=np.sqrt(np.where(is_good, variance, np.nan)),
        loss=np.array([instrument.cables[cable] for cable in cables]),
    )


def _chain_of(
    curve: CalibrationCurve, paths: _Paths, instrument: Instrument, table: CableTable, cable_of: Cables
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


def _design(instrument: Instrument) -> Floats:
    """What N_RCU S and N_ADC add to an intercept, shape (freq, 2)."""
    return np.stack([instrument.receiver_gain, np.ones_like(instrument.receiver_gain)], axis=1)


def _fit_paths(paths: _Paths, lines: Lines, instrument: Instrument) -> list[CalibrationCurve]:
    """The chain fitted to the lines of a batch of paths, with the status of each."""
    is_present = np.isfinite(paths.relative_variance)
    events = is_present.sum(axis=1)
    bins = np.floor(paths.lst_hours / 24.0 * LST_BINS).astype(int) % LST_BINS
    is_covered = np.zeros((len(paths.owners), LST_BINS), dtype=bool)
    path_at, event_at = np.nonzero(is_present)
    is_covered[path_at, bins[event_at]] = True
    covered = is_covered.sum(axis=1)

    status = np.full(len(paths.owners), CONVERGED, dtype=object)
    status[~_sees_the_sky_vary(lines)] = NOT_IDENTIFIABLE
    status[covered < MIN_LST_BINS] = TOO_FEW_LST_BINS
    status[events < MIN_EVENTS] = TOO_FEW_EVENTS
    at = np.flatnonzero(status == CONVERGED)
    solution, is_free = solve_without_interference(
        lines.slope[at], lines.intercept[at], lines.information[at], _design(instrument)
    )
    channels = instrument.frequency_mhz.size
    variance = np.einsum("pii->pi", solution.covariance)
    with np.errstate(invalid="ignore", divide="ignore"):
        c = calibration_factor(solution.x, instrument.antenna_gain)
        # ln C = -ln(s) / 2 + const
        relative_error = np.sqrt(variance[:, :channels]) / (2.0 * solution.x)
    flag = flag_channels(np.where(c > 0, relative_error, np.nan), lines.levels.radiometer[at], is_free)
    has_value = flag != OUTSIDE
    is_usable = has_value.mean(axis=1) >= SMALLEST_BAND
    status[at[~solution.is_converged]] = NOT_CONVERGED
    status[at[~(solution.is_identifiable & is_usable)]] = NOT_IDENTIFIABLE
    curves = []
    for k, (station, antenna, dipole) in enumerate(paths.owners):
        is_good, j = status[k] == CONVERGED, int(np.searchsorted(at, k))
        values = (solution.n[j], *solution.q[j]) if is_good else ()
        sigmas = np.sqrt(variance[j, channels:]) if is_good else ()
        curves.append(
            CalibrationCurve(
                station=station,
                antenna=antenna,
                dipole=dipole,
                status=status[k],
                events=int(events[k]),
                frequency_mhz=instrument.frequency_mhz,
                c=np.where(has_value[j], c[j], np.nan) if is_good else None,
                c_sigma_stat=np.where(has_value[j], c[j] * relative_error[j], np.nan) if is_good else None,
                c_sigma_sys=None,
                chi2_per_dof=float(solution.chi2[j] / (channels - 3 - is_free[j].sum())) if is_good else None,
                lst_coverage=float(covered[k] / LST_BINS),
                parameters={
                    name: Parameter(float(value), float(sigma))
                    for name, value, sigma in zip(("n_lna", "n_rcu", "n_adc"), values, sigmas, strict=False)
                },
                flag=tuple(flag[j].tolist()) if is_good else None,
                antenna_gain=instrument.antenna_gain,
            )
        )
    return curves


def _sees_the_sky_vary(lines: Lines) -> NDArray[np.bool_]:
    """Whether the typical channel's slope, its intercept free, differs from zero by three standard deviations."""
    channels = lines.slope.shape[1]
    of_slope = np.einsum("pii->pi", lines.information)[:, :channels]
    of_intercept = np.einsum("pii->pi", lines.information)[:, channels:]
    shared = np.einsum("pii->pi", lines.information[:, :channels, channels:])
    alone = 1.0 - shared**2 / np.maximum(of_slope * of_intercept, 1e-300)
    significance = lines.slope * np.sqrt(of_slope * np.where(alone > 1e-10, alone, 0.0))
    return np.asarray(np.median(significance, axis=1) > 3.0)
