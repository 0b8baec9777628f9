"""A state, not a history, decides what is in effect: real fits, and a worker that is killed in every sequence.

A station of four antennas, one of which steps by 10 % on a drawn date, is recorded for two years. Its months arrive in
a drawn order, between nights, with changes that are entered, dismissed and put in force. The worker is killed with
signal 9 in one of the nights, and in the last. At the end a fresh service gets the same spectra, changes and last
decisions at once: C of every path, of the station and of the array must be as near as two services may differ, each of
which leaves up to 0.25 sigma unstored. A version that both have made must have one C. Then a decision is taken and
undone: the same versions must answer again.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lbacal.instants import DAY_US, format_instant
from lbacal_core.curves.validity import Scope
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.hardware import GainStep
from lbacal_twin.settings import TwinSettings
from service.cli.opening import configure_logs
from service.errors import ConflictError
from service.factory import Factory
from service.scheduler import look_for_due_work
from service.storage.changes import DISMISSED, IN_FORCE
from service.storage.versions import Version
from service.usecases.fits import SMALLEST_SHIFT
from service.usecases.gate import through_common_cable
from service.wire.bodies import ChangeBody, DecisionBody
from validation.kills import SETTINGS, SKY, largest_shift, simulate
from validation.life_states import BY, MOST_NIGHTS, replay, rest
from validation.life_world import at
from validation.machinery.claims import Found, rate_of
from validation.machinery.parts import Part, Row
from validation.running.ledger import open_factory
from validation.running.processes import Process

CAMPAIGN = TwinSettings(stations=("CS002",), antennas=4, years=1.99, events_per_year=120)
SCOPES = [Scope("CS002", antenna, dipole) for antenna in range(4) for dipole in "XY"] + [Scope("CS002"), Scope()]
DATES = ("2014-07-10", "2015-01-01", "2015-05-20")
STEPS = ("2014-09-10", "2015-03-20")
ACTS, CHUNKS = 5, 24
LONGEST_S = 4.0
"""A night of this station takes about as long, after which the worker is killed or not at all."""
ENDLESS_S = 600.0
"""Work that goes on for so long has no end."""
SAME_C = 0.01
"""Standard deviations within which C of one id is one: the gains of paths that are fitted together settle to 1e-4."""
MOST_VERSIONS = 10_000
Curves = dict[str, Version]
"""What is in effect, by scope and instant; or all versions by their ids."""


@dataclass
class Life:
    """A service with a worker beside it, which is killed now and then."""

    factory: Factory
    worker: Process
    rng: np.random.Generator
    acts: list[str] = field(default_factory=list)
    kills: int = 0
    is_endless: bool = False

    def do(self, name: str, act: Callable[[], Any], *, is_killed: bool = False) -> None:
        """Do something and let nights follow, in which the worker is killed or not."""
        self.acts.append(name + " and a kill" * is_killed)
        act()
        begun = time.monotonic()
        kill_at = begun + float(self.rng.uniform(0.1, LONGEST_S)) if is_killed else np.inf
        for _ in range(MOST_NIGHTS):
            # the worker enqueues, too, what follows from what it ended
            if not look_for_due_work(self.factory) and not self._is_at_work():
                return
            while self._is_at_work():
                self.is_endless |= time.monotonic() > begun + ENDLESS_S
                if self.is_endless:
                    return
                if time.monotonic() > kill_at:
                    self.worker.kill()
                    self.kills, kill_at = self.kills + 1, np.inf
                time.sleep(0.02)
        raise AssertionError(f"something is due after {MOST_NIGHTS} nights")

    def _is_at_work(self) -> bool:
        with self.factory.database.read() as stores:
            return bool(stores.jobs.count_open())

    def enter(self, antenna: int, date: str) -> None:
        """Enter a change of one antenna, of unknown size."""
        paths, instant = [{"station": "CS002", "antenna": antenna}], {"value": date, "sigma_days": 1.0}
        self.factory.changes.enter(ChangeBody.model_validate({"paths": paths, "at": instant, "reason": "proof"}), BY)

    def decide(self, number: int, decision: str) -> None:
        """Decide about a change, unless it is so already."""
        with suppress(ConflictError):
            body = DecisionBody.model_validate({"decision": decision, "reason": "proof"})
            self.factory.changes.decide(number, body, BY)


def live(seed: int, acts: int = ACTS) -> Row:
    """Let one station live, and hold what is in effect at the end against a service that is made anew."""
    configure_logs("error")
    rng = np.random.default_rng([34, seed])
    step = GainStep(size=-0.1, where=Where(antennas=(int(rng.integers(4)),)), date=str(rng.choice(STEPS)))
    with tempfile.TemporaryDirectory(prefix="lbacal-life-") as name:
        folder = Path(name)
        spectra = simulate(folder, CAMPAIGN, rng, [step])
        settings = {**SETTINGS, "sky_power": folder / SKY, "log_level": "error"}
        with open_factory(str(folder / "life.sqlite"), **settings) as factory:
            values = {"database_url": folder / "life.sqlite", **settings}
            environment = {f"LBACAL_{key.upper()}": str(value) for key, value in values.items()}
            worker = Process(environment, folder / "log", "worker")
            try:
                life = Life(factory, worker, rng)
                draw_acts(life, spectra, acts)
                undone = undo(life)
            finally:
                worker.stop()
            anew, made_anew = rebuild(folder, factory, spectra, settings)
            shifts, made = compare(read_in_effect(factory), anew), list_versions(factory)
    farthest = max(shifts, key=lambda place: shifts[place])
    twice = {name: round(min(_shift(one, made_anew[name]), 1e9), 3) for name, one in made.items() if name in made_anew}
    return {
        "acts": life.acts,
        "kills": life.kills,
        "endless": life.is_endless,
        "undone": undone,
        "compared": len(shifts),
        "within": sum(shift <= SMALLEST_SHIFT for shift in shifts.values()),
        "farthest": farthest,
        "farthest_sigma": round(min(shifts[farthest], 1e9), 3),
        "twice": len(twice),
        "unlike": {name: shift for name, shift in twice.items() if shift > SAME_C},
    }


def draw_acts(life: Life, spectra: Spectra, acts: int) -> None:
    """Draw what happens: most months at first, the others late, changes and decisions between."""
    rng = life.rng
    chunk_of = np.digitize(spectra.time_unix, np.linspace(spectra.time_unix.min(), spectra.time_unix.max(), CHUNKS)[1:])
    late = rng.permutation(CHUNKS)[:acts].tolist()
    killed = int(rng.integers(acts))

    def add(rows: np.typing.NDArray[np.bool_]) -> None:
        with life.factory.database.write() as stores:
            stores.spectra.add(spectra.select(rows))

    life.do("begin", lambda: add(~np.isin(chunk_of, late)))
    for number, month in enumerate(late):
        life.do(f"late {month}", lambda month=month: add(chunk_of == month), is_killed=number == killed)  # type: ignore[misc]
        changes = [one for one in life.factory.changes.list_all() if one.ended is None]
        if changes and rng.random() < 0.5:
            one, decision = changes[int(rng.integers(len(changes)))], str(rng.choice([DISMISSED, IN_FORCE]))
            life.do(f"{decision} {one.change.antennas}", lambda: life.decide(one.number, decision))  # noqa: B023
        else:
            antenna, date = int(rng.integers(4)), str(rng.choice(DATES))
            life.do(f"enter {antenna} on {date}", lambda: life.enter(antenna, date))  # noqa: B023
    life.do("the last night", lambda: None, is_killed=True)


def undo(life: Life) -> list[str]:
    """Take a decision and undo it: where another version answers than before."""
    one = next(one for one in life.factory.changes.list_all() if one.ended is None)
    before = read_in_effect(life.factory)
    for decision in (DISMISSED, IN_FORCE) if one.decision == IN_FORCE else (IN_FORCE, DISMISSED):
        life.do(f"{decision} {one.change.antennas}", lambda: life.decide(one.number, decision), is_killed=True)  # noqa: B023
    now = read_in_effect(life.factory)
    return sorted(place for place in before.keys() | now.keys() if _name(before, place) != _name(now, place))


def rebuild(folder: Path, factory: Factory, spectra: Spectra, settings: dict[str, Any]) -> tuple[Curves, Curves]:
    """Read what is in effect and all versions in a service that got the same spectra, changes and decisions at once."""
    with open_factory(str(folder / "anew.sqlite"), **settings) as fresh:
        with fresh.database.write() as stores:
            stores.spectra.add(spectra)
        for is_found in (False, True):
            with fresh.database.write() as stores:
                for one in factory.changes.list_all():
                    replay(stores, one, fresh.clock(), is_found=is_found)
            rest(fresh)
        return read_in_effect(fresh), list_versions(fresh)


def list_versions(factory: Factory) -> Curves:
    """Read all versions by their ids."""
    with factory.database.read() as stores:
        return {one.id: one for one in stores.versions.search(None, None, "", MOST_VERSIONS)}


def read_in_effect(factory: Factory) -> Curves:
    """Read what is in effect around every date and in every year."""
    probes = [at(f"{year}-{day}") for year in (2014, 2015) for day in ("02-15", "11-15")]
    probes += [at(date) + by * DAY_US // 2 for date in DATES for by in (-1, 1)]
    with factory.database.read() as stores:
        said = stores.ledger.decisive_at([(scope, when) for scope in SCOPES for when in probes])
        names = {place: one.calibration for place, one in said.items() if one is not None and one.calibration}
        versions = stores.versions.get_many(set(names.values()))
    return {f"{scope.key} {format_instant(when)[:13]}": versions[name] for (scope, when), name in names.items()}


def _name(curves: Curves, place: str) -> str:
    return curves[place].id if place in curves else ""


def compare(found: Curves, anew: Curves) -> dict[str, float]:
    """The largest difference of C of any channel, in the smaller statistical error; infinite where one has none."""
    return {place: _shift(found.get(place), anew.get(place)) for place in found.keys() | anew.keys()}


def _shift(one: Version | None, other: Version | None) -> float:
    if one is None or other is None:
        return np.inf
    shifts = [0.0]
    for dipole in {str(curve.dipole) for curve in (*one.curves, *other.curves)}:
        if not (one.serves(dipole) and other.serves(dipole)):
            return np.inf
        own, anew = (through_common_cable(version, dipole) for version in (one, other))
        if own.c is None or anew.c is None:
            shifts.append(0.0 if own.c is anew.c else np.inf)
            continue
        sigmas = (np.asarray(curve.c_sigma_stat) for curve in (own, anew))
        shifts.append(largest_shift(*zip((own.c, anew.c), sigmas, strict=True)))
    return max(shifts)


def judge(rows: Sequence[Row]) -> list[Found]:
    apart = sum(row["farthest_sigma"] > 2.0 * SMALLEST_SHIFT for row in rows)
    undone = sum(bool(row["undone"]) for row in rows)
    within = sum(row["within"] for row in rows), sum(row["compared"] for row in rows)
    unlike = sum(len(row["unlike"]) for row in rows), sum(row["twice"] for row in rows)
    return [
        rate_of("endless", sum(row["endless"] for row in rows), len(rows)),
        rate_of("apart", apart, len(rows)),
        rate_of("undone", undone, len(rows)),
        rate_of("within", *within),
        rate_of("unlike", *unlike),
    ]


PARTS = (Part("station", live, judge, 60),)
