"""A small station whose fits take a millisecond, and C as it follows from its data and changes alone.

A fit here gives ln C of a path, in each piece of a window, as -1/2 of the mean of ln P over its events, half of it that
of all windows with the same hardware: it sees its spectra, where windows are cut, and what stands beside them. It takes
the place of `fit_calibration` and of what continues one; everything around it is the service's own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np

from lbacal.instants import parse_instant
from lbacal_core.calibration.chain_form import PUBLISHED_FORM
from lbacal_core.calibration.continued import Continued
from lbacal_core.calibration.windows import LARGEST_SHARE_LEFT_OUT
from lbacal_core.calibration.years import Beside
from lbacal_core.causes.model import Model
from lbacal_core.curves.covariance import Budget, BudgetTerm
from lbacal_core.curves.curves import CONVERGED, TOO_FEW_EVENTS, CalibrationCurve, FitReport, Repeated
from lbacal_core.curves.kept_lines import KeptLines, MemberLines, Owner
from lbacal_core.curves.reference_chain import CableTable, ReferenceChain
from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.drift.events import MODES, EventModes
from lbacal_core.drift.follow import History
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument, parse_instrument
from lbacal_core.provenance import Provenance
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.table import SkyPower
from lbacal_core.spectra.blocks import Recorded, SpectraByStation, split_into_blocks
from lbacal_core.spectra.spectra import Spectra
from service.storage.changes import Cut, KeptChange
from service.usecases.drift import year_of
from service.usecases.fits import SMALLEST_SHIFT, Fits
from service.usecases.watch import Watch

STATION = "CS002"
ANTENNAS = {0: "X", 1: "XY", 2: "XY", 3: "X"}
"""The antennas and their dipoles that are recorded."""
BEGINS = {3: "2015-07"}
"""The last antenna is recorded from this month on."""
MHZ = np.array([30.0, 45.0, 60.0, 80.0])
SHAPE = np.array([1.0, 0.9, 1.1, 1.2])
YEARS = (2014, 2015, 2016)
SCATTER, SIGMA = 0.02, 0.01
"""Scatter of ln P of a month, and what it makes of the error of ln C of one month."""
STEPPED, STEP_AT, POWER = 1, "2015-05-20", 0.85
SIZE = POWER**-0.5 - 1.0
"""What the watch finds, once three months are there on either side of it."""
MONTHS_OF_A_STEP = 3
FEWEST = 2
"""A piece with fewer months takes what other windows say, whatever changed between."""
OF_ALL = 0.5
LARGEST_SHARE_CONTINUED = 0.25
Month = tuple[int, int]
MICROSECONDS = 1e6


def at(text: str) -> Instant:
    """Read an instant."""
    return parse_instant("at", text)


def make_instrument() -> Instrument:
    """Four antennas with one cable."""
    ones = [1.0] * MHZ.size
    return parse_instrument(
        {
            "name": "one small station", "latitude_deg": 52.9, "longitude_deg": 6.9, "height_m": 50.0,
            "frequency_mhz": MHZ.tolist(), "dipoles": {"X": {"azimuth_deg": 45.0}, "Y": {"azimuth_deg": 135.0}},
            "antenna_gain": ones, "receiver_gain": ones, "cables": {"80m": ones},
            "antennas": [{"station": STATION, "antenna": a, "cable": "80m"} for a in ANTENNAS],
        },
        "a stand-in",
    )  # fmt: skip


def make_simulation() -> Simulation:
    """The station under a sky that no fit here looks at."""
    lst_hours = np.arange(24.0)
    return Simulation(make_instrument(), SkyPower(MHZ, lst_hours, dict.fromkeys("XY", np.ones((24, MHZ.size)))))


@cache
def level(antenna: int, dipole: str, month: Month) -> float:
    """Ln P of a path in a month."""
    z = np.random.default_rng([7, antenna, ord(dipole), *month]).standard_normal()
    stepped = antenna == STEPPED and instant_of(month) >= at(STEP_AT)
    return float(0.1 * antenna + SCATTER * z + (np.log(POWER) if stepped else 0.0))


@cache
def instant_of(month: Month) -> Instant:
    """When the event of a month was recorded."""
    return at(f"{month[0]}-{month[1]:02d}-10T12:00")


def recorded(month: Month) -> list[tuple[int, str]]:
    """The paths that are recorded in a month."""
    name = f"{month[0]}-{month[1]:02d}"
    return [(a, d) for a, dipoles in ANTENNAS.items() for d in dipoles if name >= BEGINS.get(a, "")]


def spectra_of(months: Sequence[Month]) -> Spectra:
    """One event a month."""
    rows = [(m, a, d) for m in months for a, d in recorded(m)]
    return Spectra(
        MHZ,
        np.array([np.exp(level(a, d, m)) * SHAPE for m, a, d in rows]),
        np.array([f"{m[0]}-{m[1]:02d}" for m, _, _ in rows]),
        np.array([instant_of(m) / MICROSECONDS for m, _, _ in rows]),
        np.full(len(rows), STATION),
        np.array([a for _, a, _ in rows]),
        np.array([d for _, _, d in rows]),
        np.full(len(rows), 100),
    )


# The stand-in.


def _owned(spectra: Spectra, scope: str) -> Iterator[tuple[Owner, list[int], Floats]]:
    """Each curve's owner, the antennas behind it, and ln P of its events."""
    for dipole in sorted(set(spectra.dipole.tolist())):
        of_dipole = spectra.dipole == dipole
        antennas = sorted(set(spectra.antenna[of_dipole].tolist()))
        if scope == "antenna":
            for antenna in antennas:
                rows = of_dipole & (spectra.antenna == antenna)
                yield (STATION, antenna, dipole), [antenna], np.log(spectra.power[rows, 0])
        else:
            owner: Owner = (STATION if scope == "station" else None, None, dipole)
            times = sorted(set(spectra.time_unix[of_dipole].tolist()))
            means = [np.mean(spectra.power[of_dipole & (spectra.time_unix == one), 0]) for one in times]
            yield owner, antennas, np.log(means)


def _solve(owner: Owner, own: float, events: int, beside: Sequence[Beside]) -> tuple[float, int] | None:
    """Ln C, and how many windows it follows from; None where these are too few."""
    found = [(own, events)]
    for one in beside:
        for k, of in enumerate(one.lines.owners):
            is_used = one.lines.events[k] >= FEWEST if events < FEWEST else one.is_same[k]
            if of == owner and one.lines.is_good[k] and is_used:
                found.append((float(one.lines.slope[k, 0]), int(one.lines.events[k])))
    if events < FEWEST and len(found) == 1:
        return None
    return ln_c(own, found), len(found)


def ln_c(own: float, windows: Sequence[tuple[float, int]]) -> float:
    """Ln C of a window from its mean of ln P, and from mean and count of all that are fitted together."""
    of_all = sum(x * n for x, n in windows) / sum(n for _, n in windows)
    return -0.5 * ((1.0 - OF_ALL) * own + OF_ALL * of_all)


def fit(spectra: Recorded, simulation: Simulation, scope: str = "antenna", beside: Sequence[Beside] = ()) -> FitReport:
    """Stand in for `fit_calibration`."""
    spectra = spectra.read(STATION) if isinstance(spectra, SpectraByStation) else spectra
    curves, members, kept = [], list[list[int]](), dict[str, list[_Kept]]()
    for owner, antennas, of_events in _owned(spectra, scope):
        own, events = float(np.mean(of_events)), of_events.size
        solved = _solve(owner, own, events, beside)
        c = None if solved is None else np.exp(solved[0]) / np.sqrt(SHAPE)
        sigma = None if c is None else c * SIGMA / np.sqrt(events)
        windows = 1 if solved is None else solved[1]
        curves.append(
            CalibrationCurve(
                *owner, TOO_FEW_EVENTS if c is None else CONVERGED, events, MHZ, c, sigma, None, 1.0, 1.0, {},
                repeated=Repeated(windows, 1.0) if windows > 1 else None,
            )
        )  # fmt: skip
        members.append(antennas)
        of_curve = _Kept(owner, own, events, spectra.digest(*owner), c is not None, antennas)
        kept.setdefault(owner[2], []).append(of_curve)
    inputs = {"spectra": spectra.digest(), "sky_power": simulation.sky_power.digest()}
    lines = [_write(of_dipole, is_mean=scope != "antenna") for of_dipole in kept.values()]
    table = CableTable.of(simulation.instrument)
    chains = [ReferenceChain([(STATION, a) for a in of], np.ones(MHZ.size), table, None) for of in members]
    return FitReport(tuple(curves), Provenance(inputs, {"scope": scope}), chains, lines=lines)


@dataclass(frozen=True)
class _Kept:
    owner: Owner
    mean: float
    events: int
    digest: str
    is_good: bool
    antennas: Sequence[int]


def _write(kept: Sequence[_Kept], *, is_mean: bool) -> KeptLines:
    paths, channels, members = len(kept), MHZ.size, kept[0].antennas
    nothing, several = np.zeros((paths, channels)), np.zeros((paths, 1, channels))
    each, none = np.zeros((len(members), channels)), np.zeros(len(members))
    good = np.array([one.is_good for one in kept])
    return KeptLines(
        [one.owner for one in kept], np.array([one.events for one in kept]), good, good,
        np.array([[one.mean] * channels for one in kept]), nothing, np.zeros((paths, 2 * channels, 2 * channels)),
        nothing, several, several, np.zeros(paths), nothing, np.array([one.digest for one in kept]), 100.0,
        members=MemberLines(np.full(len(members), STATION), np.array(members), each, each, none + 1.0, none)
        if is_mean else None,
    )  # fmt: skip


def continue_(
    kept: Sequence[KeptLines], new: Spectra | None, _: Simulation, beside: Sequence[Beside], __: tuple[float, float]
) -> Continued:
    """Stand in for `continue_fit`."""
    curves, undecided = {}, set()
    for one in kept:
        more = dict[Owner, Floats]()
        if new is not None:
            scope = "antenna" if one.members is None else "station" if one.owners[0][0] else "array"
            of = new if one.members is None else new.select(np.isin(new.antenna, one.members.antennas))
            more = {owner: found for owner, _, found in _owned(of, scope)}
        for k, owner in enumerate(one.owners):
            later = more.get(owner, np.zeros(0))
            before, events = int(one.events[k]), int(one.events[k]) + later.size
            mean = (float(one.slope[k, 0]) * before + float(np.sum(later))) / events
            solved = _solve(owner, mean, events, beside)
            if later.size > LARGEST_SHARE_CONTINUED * before or (solved is None and one.has_c[k]):
                undecided.add(owner)
            elif solved is not None:
                c = np.exp(solved[0]) / np.sqrt(SHAPE)
                curves[owner] = c, c * SIGMA / np.sqrt(events), 0.0
    return Continued(curves, frozenset(undecided))


def _budget(*_: Any) -> Budget:
    return Budget(MHZ, [BudgetTerm("sky", "a stand-in", dict.fromkeys("XY", np.full((1, MHZ.size), 0.05)))])


def _measure(_: Fits, spectra: Spectra, __: Model, curves: Mapping[str, Any]) -> dict[str, EventModes]:
    events = {}
    for block in split_into_blocks(spectra):
        at_rows = [k for k, a in enumerate(block.antennas.tolist()) if a in curves[block.dipole]]
        ln_c = np.repeat(-0.5 * np.log(block.power[at_rows, :, :1]), len(MODES), axis=2)
        events[block.dipole] = EventModes(block.antennas[at_rows], block.time_unix, ln_c)
    return events


def _report(_: Watch, history: History) -> dict[str, Any]:
    is_measured = np.isfinite(history.ln_c[history.antenna == STEPPED, :, 0]).any(axis=0)
    times = history.time_unix[is_measured].tolist()
    change = {
        "station": STATION, "members": [
            {"antenna": STEPPED, "dipole": dipole, "size": SIZE, "sigma": 0.001, "significance": 50.0}
            for dipole in "XY"
        ],
        "date_unix": at(STEP_AT) / MICROSECONDS, "date_sigma_days": 1.0, "size": SIZE, "sigma": 0.001,
        "shape": {name: {"value": 0.0, "sigma": 0.001} for name in ("tilt", "curvature")}, "is_known": False,
    }  # fmt: skip
    return {"changes": [change] if is_found(times) else [], "slopes": [], "trends": {}, "threshold_sigma": 5.0}


def is_found(times_unix: Sequence[float]) -> bool:
    """Whether the watch finds the step."""
    after = sum(one * MICROSECONDS >= at(STEP_AT) for one in set(times_unix))
    return min(after, len(set(times_unix)) - after) >= MONTHS_OF_A_STEP


@contextmanager
def standing_in() -> Iterator[None]:
    """Fits, their continuation, the drift of events and the search in it are those above."""
    solved = SimpleNamespace
    with ExitStack() as stack:
        for where, name, what in (
            ("lbacal_core.discovery.calibrate", "fit_calibration", fit),
            ("lbacal_core.discovery.calibrate", "compare_forms", lambda *_: PUBLISHED_FORM),
            ("service.usecases.fits", "continue_fit", continue_),
            ("service.usecases.fits", "compute_budget", _budget),
            ("service.usecases.fits", "audit_quickly", lambda *_: SimpleNamespace(require_power=lambda _: None)),
            (
                "service.usecases.fits",
                "solve_separable",
                lambda slope, *rest: solved(q=np.zeros((len(slope), rest[-1].behind.shape[0]))),
            ),
            ("service.usecases.drift_measurement", "_measure", _measure),
            ("service.usecases.drift_measurement", "_add", lambda *_: None),
            ("service.usecases.watch.Watch", "_report", _report),
        ):
            stack.enter_context(patch(f"{where}.{name}", what))
        yield


# C from data and changes alone.


@dataclass(frozen=True)
class Piece:
    """A time [since, until) in which one curve of a scope answers, and ln C with its error; None without one.

    By `lag` errors it may be off where windows that it sees lack events that are no news of their own.
    """

    since: Instant
    until: Instant
    ln_c: float | None
    sigma: float
    lag: float


@dataclass(frozen=True)
class _Window:
    """The events of a piece; `rows` are its spectra, by which the pieces of a year are ranked."""

    since: Instant
    until: Instant
    mean: float
    events: int
    rows: int

    def is_apart(self, other: _Window, dates: Sequence[Instant]) -> bool:
        first, last = min(self.until, other.until), max(self.since, other.since)
        return any(first <= date <= last for date in dates)

    def may_see(self, other: _Window) -> bool:
        """The pieces of a year are fitted one after the other, that with the most spectra first."""
        if year_of(self.since) != year_of(other.since):
            return True
        return (-other.rows, other.since) < (-self.rows, self.since)


def natural(months: Sequence[Month], changes: Sequence[KeptChange]) -> dict[tuple[Scope, str], list[Piece]]:
    """The versions of every path, the station and the array by the rules, by scope and dipole."""
    cuts = [cut for one in changes for cut in one.cuts]
    dates = {antenna: sorted({cut.date for cut in cuts if cut.antenna == antenna}) for antenna in ANTENNAS}
    found: dict[tuple[Scope, str], list[Piece]] = {}
    for antenna, dipoles in ANTENNAS.items():
        for dipole in dipoles:
            windows = list(_pieces(months, antenna, dipole, dates))
            found[Scope(STATION, antenna, dipole), dipole] = _solve_all(windows, dates[antenna])
    for dipole in "XY":
        found[Scope(STATION), dipole] = found[Scope(), dipole] = _solve_all(list(_means(months, dipole, cuts)), ())
    return found


def _pieces(
    months: Sequence[Month], antenna: int, dipole: str, dates: Mapping[int, Sequence[Instant]]
) -> Iterator[_Window]:
    """The windows of a path: years, cut where the antenna changed; antennas with the same dates share them."""
    for year in YEARS:
        first, last = at(f"{year}-01-01"), at(f"{year + 1}-01-01")
        inside = {a: [date for date in dates[a] if first < date < last] for a in ANTENNAS}
        edges = [first, *inside[antenna], last]
        for since, until in pairwise(edges):
            during = [month for month in months if since <= instant_of(month) < until]
            levels = [level(antenna, dipole, month) for month in during if (antenna, dipole) in recorded(month)]
            rows = sum(inside[a] == inside[antenna] for month in during for a, _ in recorded(month))
            if levels:
                yield _Window(since, until, float(np.mean(levels)), len(levels), rows)


def _solve_all(windows: Sequence[_Window], dates: Sequence[Instant]) -> list[Piece]:
    seen = [[other for other in windows if other is not one and one.may_see(other)] for one in windows]
    large = [[other for other in of if other.events >= FEWEST] for of in seen]
    has_c = {one.since: one.events >= FEWEST or bool(of) for one, of in zip(windows, large, strict=True)}
    pieces = []
    for one, others, enough in zip(windows, seen, large, strict=True):
        same = [other for other in others if has_c[other.since] and not one.is_apart(other, dates)]
        joined = [one, *(same if one.events >= FEWEST else enough)]
        value = ln_c(one.mean, [(w.mean, w.events) for w in joined]) if has_c[one.since] else None
        pieces.append(Piece(one.since, one.until, value, _sigma(one), _lag(one, joined)))
    return pieces


def _sigma(one: _Window) -> float:
    return float(SIGMA / one.events**0.5)


def _lag(one: _Window, joined: Sequence[_Window]) -> float:
    """By how many of its errors C of a window may be off where the others lack what is no news of their own C.

    An event of ln P = m + u makes x of its window (n events) a (u + m - x) larger and the mean m of all (N) b u, with
    a = 1/n, b = 1/N. C of the window moves by less than its share s of an error: |((1 - q) a + q b) u + (1 - q) a
    (m - x)| < 2 s sigma, q of `ln_c`. Several events move m by as much where x is near m, and little more else.
    """
    total = sum(w.events for w in joined)
    m = sum(w.mean * w.events for w in joined) / total
    moved = 0.0
    for other in joined[1:]:
        own, of_all = (1.0 - OF_ALL) / other.events, OF_ALL / total
        u = (2.0 * SMALLEST_SHIFT * _sigma(other) + own * abs(m - other.mean)) / (own + of_all)
        moved += 0.5 * of_all * u
    return float(moved / _sigma(one))


def _means(months: Sequence[Month], dipole: str, cuts: Sequence[Cut]) -> Iterator[_Window]:
    """The mean of the antennas, the changes of known size taken out; those of unknown size leave the mean of a year."""
    for year in YEARS:
        first, last = at(f"{year}-01-01"), at(f"{year + 1}-01-01")
        inside = [month for month in months if month[0] == year]
        owners = {antenna for month in inside for antenna, _ in recorded(month)}
        unknown = [cut for cut in cuts if cut.power is None and first < cut.date < last and cut.antenna in owners]
        changed = {cut.antenna for cut in unknown}
        is_cut = len(changed) > LARGEST_SHARE_LEFT_OUT * len(owners)
        left_out = set() if is_cut else changed
        edges = [first, *(sorted({cut.date for cut in unknown}) if is_cut else ()), last]
        known = [cut for cut in cuts if cut.power is not None and cut.date < last]
        for since, until in pairwise(edges):
            during = [month for month in inside if since <= instant_of(month) < until]
            means = [
                np.log(np.mean(powers))
                for month in during
                if (powers := [
                    np.exp(level(a, d, month)) / _taken_out(a, d, month, known)
                    for a, d in recorded(month)
                    if d == dipole and a not in left_out
                ])
            ]  # fmt: skip
            if means:
                rows = sum(len(recorded(month)) for month in during)
                yield _Window(since, until, float(np.mean(means)), len(means), rows)


def _taken_out(antenna: int, dipole: str, month: Month, known: Sequence[Cut]) -> float:
    return float(np.prod([
        cut.power or 1.0
        for cut in known
        if cut.antenna == antenna and dipole in (cut.dipoles or "XY") and instant_of(month) >= cut.date
    ]))  # fmt: skip
