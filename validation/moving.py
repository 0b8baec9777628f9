"""What moves: C in effect is right before, just after and far from a change, of a path or of its whole station.

A service holds three years of a station of 4 or 8 antennas, or of 24 or 48, simulated by the twin, in which something
moves: a step, another cable, another antenna, a ramp, a season, a path that is dead for a year, or several of these at
once; in one antenna (one dipole or both) or in all. Nights pass until nothing is due, then C is asked for as a pipeline
does. What a whole station did at a date is in its log book: there is no other to compare it with. The sky is the
simulation's, so that what is told must be right within its statistical error.
"""

from __future__ import annotations

import copy
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from lbacal.instants import format_instant
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.curves.validity import Scope
from lbacal_core.grids import Floats
from lbacal_core.provenance import DRIFT_VERSION
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import write_sky_power
from lbacal_twin.campaign import Campaign, simulate_campaign
from lbacal_twin.faults.fault import Fault, Where
from lbacal_twin.hardware import Scene, Stages
from lbacal_twin.settings import DAY_S, START_2014, YEAR_S, TwinSettings
from service.cli.opening import configure_logs
from service.config import Settings
from service.errors import NotInEffectError
from service.factory import Factory
from service.scheduler import look_for_due_work
from service.storage.changes import IN_FORCE, STEP, Change
from service.storage.migration import upgrade
from service.usecases.gate import through_common_cable
from service.wire.bodies import ChangeBody
from validation.loop import Service
from validation.machinery.claims import Found, mean_of, rate_of
from validation.machinery.parts import Part, Row
from validation.machinery.tables import by
from validation.running.postgres import open_databases
from validation.twin import CHANNELS

STATION, YEARS, EVENTS = "CS002", 3.0, 250
SMALL, LARGE = (4, 8), (24, 48)
"""Antennas of a station."""
SINGLE = ("step", "cable", "antenna", "ramp", "season", "dead")
KINDS, SLOW = (*SINGLE, "several"), ("ramp", "season")
NEAR_S, FAR_S = 40 * DAY_S, 300 * DAY_S
"""How far from a change C is asked for."""
NIGHTS = 4
STILL = 0.3
"""Standard deviations of a station's C within which it does not move."""
SERVICE: dict[str, Any] = {"nightly_investigations": False, "gate_error": 0.5, "log_level": "error", "quiet_s": 0.0}


@dataclass(frozen=True, kw_only=True)
class Moved(Fault):
    """A gain in front of N_RCU that is another from a date on, or follows time; `size` is unused.

    Attributes
    ----------
    kind
        One of `SINGLE`.
    date
        When it changes, s UTC; a ramp does from the first event on.
    shape
        Legendre coefficients of ln of the power along frequency.
    metres
        By how much the cable is longer: Coax 9 loses 0.0816 dB a metre at 30 MHz, as the root of frequency.
    """

    kind: str
    date: float
    shape: tuple[float, ...] = (0.0,)
    metres: float = 0.0

    def log_gain(self, time_unix: Floats, frequency_mhz: Floats) -> Floats:
        """Ln of the power gain, shape (time, freq)."""
        low, high = frequency_mhz[0], frequency_mhz[-1]
        along = legendre.legval((2.0 * frequency_mhz - low - high) / (high - low), self.shape)
        along = along - 0.1 * np.log(10.0) * self.metres * 0.0816 * np.sqrt(frequency_mhz / 30.0)
        course = {
            "ramp": (time_unix - START_2014) / YEAR_S,  # of a station's C counts what its antennas were to begin with
            "season": np.cos(2 * np.pi * (time_unix - self.date) / YEAR_S),
            "dead": (time_unix >= self.date) & (time_unix < self.date + YEAR_S),
        }.get(self.kind, time_unix >= self.date)
        return np.asarray(np.asarray(course, dtype=float)[:, None] * along)

    def alter(self, stages: Stages, scene: Scene) -> Stages:
        """The gain of a moved path."""
        factor = np.exp(self.log_gain(scene.time_unix, scene.frequency_mhz))
        return replace(stages, gain=stages.gain * (1.0 + self.where.mask(scene) * (factor - 1.0)))


def draw_move(kind: str, where: Where, rng: np.random.Generator) -> Moved:
    """Draw the path, the date at least half a year from the ends, and the size of a change."""
    date, sign = float(START_2014 + rng.uniform(0.5, YEARS - 0.5) * YEAR_S), float(rng.choice([-1.0, 1.0]))
    shape, metres = (0.0,), 0.0
    if kind == "step":
        shape = (float(np.log1p(sign * np.exp(rng.uniform(np.log(0.01), np.log(0.2))))),)
    elif kind == "cable":
        metres = sign * float(rng.uniform(3.0, 20.0))
    elif kind == "antenna":
        shape = (sign * float(rng.uniform(0.03, 0.15)), *rng.normal(0.0, 0.03, 2).tolist())
    elif kind == "dead":
        shape, date = (float(np.log(1e-4)),), float(START_2014 + rng.uniform(0.3, YEARS - 1.3) * YEAR_S)
    else:
        shape = (sign * {"ramp": 0.01, "season": 0.03}[kind],)
    return Moved(size=1.0, where=where, kind=kind, date=date, shape=shape, metres=metres)


@dataclass(frozen=True)
class Moving:
    """A campaign in which something moves, the same in which nothing does, and what is true of it."""

    campaign: Campaign
    still: Callable[[], Campaign]
    moves: Sequence[Moved]

    def true_c(self, scope: Scope, at: float) -> Floats:
        """C of a path, or of the station's antennas: where single ones moved, of what they were before."""
        truth, dipole = self.campaign.truth, str(scope.dipole)
        c = truth.curve(dipole, STATION, scope.antenna)
        for move in self.moves:
            is_all = not move.where.antennas
            if is_all or (scope.antenna in move.where.antennas and dipole in (move.where.dipoles or "XY")):
                c = c * np.exp(-0.5 * move.log_gain(np.array([at]), truth.frequency_mhz)[0])
        return np.asarray(c)

    def describe(self) -> list[Any]:
        """Kind, date, shape, metres and antennas of each move."""
        return [
            [m.kind, round(m.date), np.round(m.shape, 4).tolist(), round(m.metres, 2), list(m.where.antennas)]
            for m in self.moves
        ]

    def dates(self) -> dict[str, float]:
        """When C is asked for: around the first change, and far from all."""
        first = self.moves[0].date
        end = first + (YEAR_S if self.moves[0].kind == "dead" else 0.0)
        far = end + FAR_S if end + FAR_S < START_2014 + YEARS * YEAR_S else first - FAR_S
        return {"before": first - NEAR_S, "after": end + NEAR_S, "far": far}

    def paths(self) -> list[Scope]:
        """One path that moves, and one that does not unless all do."""
        moved = self.moves[0].where
        antenna = moved.antennas[0] if moved.antennas else 0
        dipole = (moved.dipoles or ("X",))[0]
        used = {number for move in self.moves for number in move.where.antennas}
        other = next(int(number) for number in self.campaign.truth.stations[0].antennas if number not in used)
        return [Scope(STATION, int(antenna), dipole), Scope(STATION, other, dipole)]


def draw_moving(
    seed: int, factory: Factory, *, sizes: Sequence[int] = SMALL, is_single: bool = False
) -> tuple[str, str, int, Moving]:
    """Kind, who moves (single antennas if only these may), the number of antennas, and the campaign."""
    rng = np.random.default_rng([34, seed])
    kind, antennas = KINDS[seed % len(KINDS)], int(rng.choice(sizes))
    who = str(rng.choice(["path", "antenna", "station"], p=[0.4, 0.35, 0.25]))
    kinds = [kind] if kind != "several" else ["step", *rng.choice(["step", "cable", "ramp"], 2).tolist()]
    if (is_single or kind in ("dead", "several")) and who == "station":
        who = "antenna"
    chosen = rng.permutation(antennas)[: len(kinds)].tolist()
    dipoles = (str(rng.choice(["X", "Y"])),) if who == "path" else ()
    moves = [
        draw_move(one, Where() if who == "station" else Where(antennas=(int(number),), dipoles=dipoles), rng)
        for one, number in zip(kinds, chosen, strict=True)
    ]
    settings = TwinSettings(stations=(STATION,), antennas=antennas, events_per_year=EVENTS, years=YEARS - 0.01)
    simulate = partial(simulate_campaign, settings, factory.instrument, factory.simulation.sky_power)
    still = partial(simulate, copy.deepcopy(rng))
    return kind, who, antennas, Moving(simulate(rng, moves), still, moves)


def pass_years(seed: int, sizes: Sequence[int] = SMALL) -> Row:
    """C in effect of a campaign of a station of so many antennas, against the truth."""
    with _begin() as service:
        return _pass(service, seed, sizes)


def compare_means(seed: int) -> Row:
    """C of a station before and after something in single antennas, less what it is if nothing happens to them."""
    with _begin() as service:
        kind, who, antennas, moving = draw_moving(seed, service.factory, is_single=True)
        _pass_nights(service, moving.campaign)
        moved = _ask_means(service.factory, moving)
        changes = _changes_in_force(service.factory, moving)
    with _begin() as service:
        _pass_nights(service, moving.still())
        still = _ask_means(service.factory, moving)
    pairs = [(then, now) for then, now in zip(still, moved, strict=True) if then is not None and now is not None]
    return {
        "kind": kind, "who": who, "antennas": antennas, "planted": moving.describe(), "found": changes,
        "station": [_pull(*now, then[0]) for then, now in pairs],
    }  # fmt: skip


@contextmanager
def _begin() -> Iterator[Service]:
    """A service that has seen nothing yet."""
    with tempfile.TemporaryDirectory(prefix="lbacal-moving-") as folder, open_databases("sqlite", "moving") as (url,):
        sky = Path(folder) / "sky_power.json"
        write_sky_power(compute_sky_power(Factory(Settings()).instrument), sky)
        factory = Factory(Settings(database_url=url, sky_power=sky, **SERVICE))
        configure_logs(factory.settings.log_level)
        try:
            upgrade(factory.database)
            yield Service(factory)
        finally:
            factory.database.close()


def _pass(service: Service, seed: int, sizes: Sequence[int]) -> Row:
    factory = service.factory
    kind, who, antennas, moving = draw_moving(seed, factory, sizes=sizes)
    if who == "station":
        _enter(factory, moving.moves[0])
    nights = _pass_nights(service, moving.campaign)
    dates, pulls = moving.dates(), dict[str, list[float] | None]()
    for name, path in zip(("moved", "steady"), moving.paths(), strict=True):
        for when, date in dates.items():
            told = _ask(factory, path, date)
            pulls[f"{name}_{when}"] = None if told is None else _pull(*told, moving.true_c(path, date))
    before, after = _ask_means(factory, moving)
    return {
        "kind": kind, "who": who, "antennas": antennas, "nights": nights, "pulls": pulls,
        "station": None if before is None or after is None else _pull(*after, before[0]),
        "planted": moving.describe(), "found": _changes_in_force(factory, moving), "drift": DRIFT_VERSION,
    }  # fmt: skip


def _pass_nights(service: Service, campaign: Campaign) -> int:
    """Nights until nothing is due."""
    with service.factory.database.write() as stores:
        stores.spectra.add(campaign.spectra)
    nights = 0
    while nights < NIGHTS and look_for_due_work(service.factory):
        service.work()
        nights += 1
    return nights


def _ask_means(factory: Factory, moving: Moving) -> list[tuple[Floats, Floats] | None]:
    """C of the station before and after the first change."""
    dates, dipole = moving.dates(), moving.paths()[0].dipole
    return [ask_mean(factory, dipole, dates[when]) for when in ("before", "after")]


def _changes_in_force(factory: Factory, moving: Moving) -> list[Any]:
    """Paths, date and its error, s, of every change in force, and which of the moves it is, if any."""
    with factory.database.read() as stores:
        changes = [one.change for one in stores.changes.kept(STATION) if one.decision == IN_FORCE]
    return [[c.paths, round(c.date / 1e6), round(c.sigma / 1e6), _match(c, moving.moves)] for c in changes]


def _enter(factory: Factory, move: Moved) -> None:
    """What the log book of the station says."""
    if move.kind not in SLOW:
        at = {"value": format_instant(round(move.date * 1e6)), "sigma_days": 0.1}
        body = ChangeBody.model_validate({"station": STATION, "at": at, "reason": "log book"})
        factory.changes.enter(body, "log book")


def _ask(factory: Factory, path: Scope, at: float) -> tuple[Floats, Floats] | None:
    """C in effect and its statistical error."""
    try:
        return _values(factory.calibrations.in_effect(round(at * 1e6), [path]).curves[0].served.curve)
    except NotInEffectError:
        return None


def ask_mean(factory: Factory, dipole: str | None, at: float) -> tuple[Floats, Floats] | None:
    """The same of the station's reference chain, without its cable: whoever is dead takes his cable with him."""
    scope = Scope(STATION)
    with factory.database.read() as stores:
        promotion = stores.ledger.decisive([scope], round(at * 1e6), None).get(scope)
        if promotion is None or promotion.calibration is None:
            return None
        version = stores.versions.get(promotion.calibration)
    return _values(through_common_cable(version, str(dipole)))


def _values(curve: CalibrationCurve) -> tuple[Floats, Floats] | None:
    return None if curve.c is None or curve.c_sigma_stat is None else (curve.c, curve.c_sigma_stat)


def _pull(c: Floats, sigma: Floats, truth: Floats) -> list[float]:
    return [float(one) for one in np.round(((c - truth) / sigma)[list(CHANNELS.values())], 3)]


def _match(change: Change, moves: Sequence[Moved]) -> int | None:
    """Which planted move a change is, if any: one of its antennas, within a month or five errors unless it is slow."""
    for number, move in enumerate(moves):
        ends = [move.date, move.date + YEAR_S] if move.kind == "dead" else [move.date]
        is_near = any(abs(change.date / 1e6 - end) < max(30 * DAY_S, 5e-6 * change.sigma) for end in ends)
        is_his = not move.where.antennas or not change.paths or set(change.antennas) & set(move.where.antennas)
        is_it = change.kind == move.kind if move.kind in SLOW else change.kind == STEP and is_near
        if is_it and is_his:
            return number
    return None


def judge(rows: Sequence[Row]) -> list[Found]:
    """The channels of a path are one draw: the part within two errors is a mean over campaigns."""
    found = []
    for name in ("moved", "steady"):
        for when in ("before", "after", "far"):
            told = [row["pulls"][f"{name}_{when}"] for row in rows]
            within = np.array([np.mean(np.abs(one) < 2.0) for one in told if one is not None])
            found.append(mean_of(f"{name}_{when}", within))
    single = [row for row in rows if row["who"] != "station" and row["station"] is not None]
    matched = [(row["planted"][one[3]], one) for row in rows for one in row["found"] if one[3] is not None]
    dated = [abs(one[1] - move[1]) < 2 * one[2] for move, one in matched if one[0] and move[0] not in ("dead", *SLOW)]
    return [
        *found,
        rate_of("answered", sum(None not in row["pulls"].values() for row in rows), len(rows)),
        *_still(single),
        rate_of("dates", sum(dated), len(dated)),
        *_strange(rows),
    ]


def judge_means(rows: Sequence[Row]) -> list[Found]:
    """A campaign is one draw: its largest departure of two dates and three channels counts.

    An antenna that is dead for a year takes its events with it: in four, 0.4 sigma by chance alone.
    """
    told = [row for row in rows if len(row["station"]) == 2]
    return [*_still(told), *_strange([row for row in rows if row["kind"] != "several"])]


def _strange(rows: Sequence[Row]) -> list[Found]:
    """How often a change is in force where nobody planted any, or another than was planted: a ramp called a step."""
    kinds: list[set[str]] = []
    for row in rows:
        moved = {antenna for move in row["planted"] for antenna in move[4]}
        strange = [{path[0] for path in one[0]} for one in row["found"] if one[3] is None]
        kinds.append({"unplanted" if moved and not antennas & moved else "other_kind" for antennas in strange})
    return [rate_of(key, sum(key in of for of in kinds), len(rows)) for key in ("unplanted", "other_kind")]


def _still(rows: Sequence[Row]) -> list[Found]:
    """How often C of the station stays within `STILL`, by what single antennas do."""
    kinds = {"mean": {*SINGLE} - {"dead"}, "mean_several": {"several"}, "mean_dead": {"dead"}}
    groups = {key: [row for row in rows if row["kind"] in of] for key, of in kinds.items()}
    return [rate_of(key, sum(np.abs(r["station"]).max() < STILL for r in of), len(of)) for key, of in groups.items()]


PARTS = (
    Part("small", pass_years, judge, 360, by("kind"), ("moved_after",)),
    Part("large", partial(pass_years, sizes=LARGE), judge, 40, by("kind")),
    Part("mean", compare_means, judge_means, 120, by("kind")),
)
