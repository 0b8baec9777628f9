"""A fit continued by events that came later, from its lines and their information, without the spectra behind it.

At fixed noise levels the lines of a path and their information matrix are sufficient for the chain (`lines`). An event
adds its gradient and its information, and the chain is solved again. What the noise levels, the screening and the test
of the chain would make of the event is left to the next fit from spectra: a fit is not continued where the event would
be screened, where more than a twentieth of the events are new, or where a path gets as many events as a fit needs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import numpy as np
from numpy.typing import NDArray

from lbacal_core.calibration.channels import solve_without_interference
from lbacal_core.calibration.lines import Lines, continue_lines
from lbacal_core.calibration.paths import LEAST_COVERAGE, MeanOfEvents, Paths, unchanged_cables
from lbacal_core.calibration.singles import MIN_EVENTS, relative_variance_of
from lbacal_core.calibration.years import Beside, lines_of, pick_beside, solve_together, weigh_by_members
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.curves.kept_lines import KeptLines, MemberLines, Owner, join_away
from lbacal_core.grids import Floats
from lbacal_core.instrument.chain import calibration_factor
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.provenance import hash_arrays
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.blocks import SpectraBlock, split_into_blocks
from lbacal_core.spectra.screening import LARGEST_SHARE_OF_LATER, may_be_left_out
from lbacal_core.spectra.spectra import Spectra

LARGEST_ERROR = 0.1
"""Standard deviations by which C may then differ from that of a fit from all spectra; with fewer events, by less
(`tests/lbacal_core/calibration/test_continued.py`)."""


@dataclass(frozen=True)
class Continued:
    """C with some events more.

    Attributes
    ----------
    curves
        C and its statistical error, shape (freq,) each, and by how many of these C may differ from a fit from all
        spectra; of the paths and means that have a curve.
    undecided
        Those of which only a fit from all spectra can tell.
    """

    curves: Mapping[Owner, tuple[Floats, Floats, float]]
    undecided: frozenset[Owner]


def keep_lines(
    paths: Paths, lines: Lines, curves: Sequence[CalibrationCurve], form: str, loss: Floats, spectra: Sequence[str]
) -> KeptLines:
    """Take from a fit in one of `FORMS` what it can be continued with, and what other windows can be fitted with."""
    has_c = np.array([curve.c is not None for curve in curves])
    members = paths.member_lines
    away = None if members is None or not np.any(members.is_away) else members.take(members.is_away)
    return KeptLines(
        owners=tuple(paths.owners),
        events=np.isfinite(paths.relative_variance).sum(axis=1),
        has_c=has_c,
        is_good=has_c,
        slope=lines.slope,
        intercept=lines.intercept,
        information=lines.information,
        radiometer=lines.levels.radiometer,
        constant=lines.shared.constant,
        behind=lines.shared.behind,
        scatter=lines.levels.of_band,
        loss=loss,
        spectra=np.array([_name(*one, away) for one in zip(spectra, curves, lines.levels.radiometer, strict=True)]),
        typical_blocks=paths.typical_blocks,
        variance_unit=paths.variance_unit,
        members=paths.member_lines,
        form=form,
    )


def _name(spectra: str, curve: CalibrationCurve, radiometer: Floats, away: MemberLines | None) -> str:
    """The hash of the spectra of a path, and of what it has of other windows: noise levels, members of a mean."""
    is_small = curve.c is not None and (curve.events < MIN_EVENTS or curve.lst_coverage < LEAST_COVERAGE)
    borrowed = [radiometer] if is_small else []
    borrowed += [] if away is None else [away.slope, away.intercept]
    return hash_arrays(spectra, *borrowed) if borrowed else spectra


def continue_fit(
    kept: Sequence[KeptLines],
    new: Spectra | None,
    simulation: Simulation,
    beside: Sequence[Beside] = (),
    ends_unix: tuple[float, float] = (-np.inf, np.inf),
) -> Continued:
    """C of the paths of a fit with some events more.

    Parameters
    ----------
    kept
        The `lines` of the report of a fit (`fit_calibration`).
    new
        The spectra of all its paths in events that it has not seen; None where there are none.
    beside
        As in `fit_calibration`.
    ends_unix
        The first and the last instant of the window, s UTC.
    """
    blocks = [] if new is None else split_into_blocks(new)
    curves, undecided = dict[Owner, tuple[Floats, Floats, float]](), set[Owner]()
    for then in kept:
        others = pick_beside(beside, then.owners[0])
        one = _renew_away(then, others, simulation.instrument, ends_unix)
        if one is None:
            undecided.update(then.owners)
            continue
        if one.members is None:
            events = _read_paths(one, blocks, simulation)
        else:
            events = _read_mean(one, one.members, blocks, simulation)
        found = _continue_paths(one, events, simulation, *weigh_by_members(others, one.members, int(one.events[0])))
        curves |= found.curves
        undecided |= found.undecided
    return Continued(curves, frozenset(undecided))


def _renew_away(
    kept: KeptLines, beside: Sequence[Beside], instrument: Instrument, ends_unix: tuple[float, float]
) -> KeptLines | None:
    """The lines of a mean with those of who is away as other windows have them now; None where others are away."""
    members = kept.members
    if members is None:
        return kept
    lend = [one.lines.members for one in beside if one.is_same[0] and one.lines.is_good[0] and one.lines.members]
    same = unchanged_cables({name for one in lend for name in one.names}, *ends_unix, instrument)
    now = join_away(members.take(~members.is_away), [one.select(same) for one in lend])
    if set(now.names) != set(members.names):
        return None
    if not np.any(members.is_away):
        return kept
    slope, intercept = (
        mean + one.mean(axis=0) - then.mean(axis=0)
        for mean, one, then in (
            (kept.slope, now.slope, members.slope), (kept.intercept, now.intercept, members.intercept)
        )
    )  # fmt: skip
    return replace(kept, slope=slope, intercept=intercept, members=now)


@dataclass(frozen=True)
class _Events:
    """New events of some paths: LST, h, shape (event,), power, (path, event, freq), and its variance, (path, event).

    `is_odd` says of each path whether a spectrum of it, or of a member of the mean, may be screened.
    """

    lst_hours: Floats
    power: Floats
    relative_variance: Floats
    is_odd: NDArray[np.bool_]


def _no_events(kept: KeptLines) -> _Events:
    paths, channels = kept.slope.shape
    return _Events(np.zeros(0), np.ones((paths, 0, channels)), np.ones((paths, 0)), np.zeros(paths, dtype=bool))


def _read_paths(kept: KeptLines, blocks: Sequence[SpectraBlock], simulation: Simulation) -> _Events:
    """The new events of single paths, on one grid."""
    station, _, dipole = kept.owners[0]
    block = next((b for b in blocks if (b.station, b.dipole) == (station, dipole)), None)
    paths, channels = kept.slope.shape
    if block is None:
        return _no_events(kept)
    row = {antenna: k for k, (_, antenna, _) in enumerate(kept.owners)}
    is_known = np.array([antenna in row for antenna in block.antennas.tolist()])
    at = [row[antenna] for antenna in block.antennas[is_known].tolist()]
    power = np.ones((paths, block.time_unix.size, channels))
    variance = np.full(power.shape[:2], np.inf)
    power[at], variance[at] = block.power[is_known], relative_variance_of(block, kept.typical_blocks)[is_known]
    lst_hours = simulation.sidereal_time(station, block.time_unix)
    sky = simulation.sky_power.of_station(station).at(dipole, lst_hours)
    expected = kept.slope[:, None] * sky + kept.intercept[:, None]
    return _Events(lst_hours, power, variance, _is_odd(power, expected, variance, kept.scatter))


def _read_mean(
    kept: KeptLines, members: MemberLines, blocks: Sequence[SpectraBlock], simulation: Simulation
) -> _Events:
    """The new events of a mean over its members."""
    station, _, dipole = kept.owners[0]
    own = [block for block in blocks if block.dipole == dipole and station in (None, block.station)]
    parts, is_odd = list[MeanOfEvents](), False
    for block in own:
        lst_hours = simulation.sidereal_time(station, block.time_unix)
        sky = simulation.sky_at(block.station, dipole, block.time_unix)
        of_station = np.flatnonzero((members.stations == block.station) & ~members.is_away)
        is_member = np.isin(block.antennas, members.antennas[of_station])
        place = of_station[np.searchsorted(members.antennas[of_station], block.antennas[is_member])]
        here = members.take(place)
        expected = here.slope[:, None] * sky + here.intercept[:, None]
        power, variance = block.power[is_member], relative_variance_of(block, kept.typical_blocks)[is_member]
        is_odd = is_odd or bool(np.any(_is_odd(power, expected, variance, here.scatter)))
        parts.append(MeanOfEvents.of(block, lst_hours, sky, here, power, variance))
    if not parts:
        return _no_events(kept)
    mean = reduce(add, parts)
    power, variance = mean.take(simulation.sky_power.of_station(station).at(dipole, mean.lst_hours), members)
    return _Events(mean.lst_hours, power[None], variance[None] / kept.variance_unit, np.array([is_odd]))


def _is_odd(power: Floats, expected: Floats, variance: Floats, scatter: Floats) -> NDArray[np.bool_]:
    """Whether a spectrum of a path may be left out by a fit from spectra, shape (path,).

    `scatter` is that of the band power, shape (path,).
    """
    is_positive = np.all(expected > 0, axis=2) & np.isfinite(variance)
    departure = np.log(np.where(is_positive[:, :, None], power / expected, 1.0))
    return np.asarray(may_be_left_out(departure, scatter) | np.any(~is_positive & np.isfinite(variance), axis=1))


def _continue_paths(
    kept: KeptLines, new: _Events, simulation: Simulation, beside: Sequence[Beside], share: float
) -> Continued:
    """C of paths, or of a mean, with some events more, by a share of the information (`weigh_by_members`)."""
    more = np.isfinite(new.relative_variance).sum(axis=1)
    later = more / np.maximum(kept.events, 1)
    is_undecided = np.where(kept.has_c, later > LARGEST_SHARE_OF_LATER, kept.events + more >= MIN_EVENTS)
    is_undecided = (is_undecided & (more > 0)) | ((new.is_odd | (kept.events < MIN_EVENTS)) & kept.has_c)
    at = np.flatnonzero(kept.has_c & ~is_undecided)
    curves = {}
    if at.size:
        sky = simulation.sky_power.of_station(kept.owners[0][0]).at(kept.owners[0][2], new.lst_hours)
        lines = lines_of(kept, at)
        if new.lst_hours.size:
            lines = continue_lines(lines, new.power[at], sky, new.relative_variance[at])
        lines = lines.weigh(share)
        terms, channels = simulation.with_form(kept.form).noise, simulation.instrument.frequency_mhz
        alone = solve_without_interference(lines.slope, lines.intercept, lines.information, terms)
        owners, is_small = [kept.owners[k] for k in at.tolist()], np.zeros(at.size, dtype=bool)
        solution = solve_together(lines, owners, kept.loss[at], terms, beside, channels, *alone, is_small).solution
        is_undecided[at] = ~(solution.is_converged & solution.is_identifiable)
        with np.errstate(invalid="ignore", divide="ignore"):
            c = calibration_factor(solution.x, simulation.instrument.antenna_gain)
            sigma = c * np.sqrt(np.einsum("pii->pi", solution.covariance)[:, : channels.size]) / (2.0 * solution.x)
        curves = {
            kept.owners[k]: (c[j], sigma[j], float(LARGEST_ERROR * (later[k] / LARGEST_SHARE_OF_LATER) ** 0.5))
            for j, k in enumerate(at.tolist())
            if not is_undecided[k]
        }
    return Continued(curves, frozenset(kept.owners[k] for k in np.flatnonzero(is_undecided).tolist()))
