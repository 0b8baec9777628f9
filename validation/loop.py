"""The loop: a fault begins in year 2, its investigation names it, and with it adopted C of year 3 is right again.

A service holds three years of a station, simulated by the twin, which shares no code with the finder. From the second
year on one of five faults is there whose effect recurs within a year, at the size at which C of year 3 moves by four of
its statistical errors (of a part of that year where the gain follows temperature); no size is beyond what is physical.
A night calibrates the three years. Year 2 is investigated, its finding is adopted as an admin does it, and withdrawn in
the end. The gain in log-likelihood that the refit of year 3 records, with the size as it was adopted, stands beside the
promise of year 2 for as many events. The watch cuts windows as in every service.
"""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal.instants import format_instant
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.calibration.years import Beside
from lbacal_core.curves.curves import CalibrationCurve, FitReport
from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import write_sky_power
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import Campaign, simulate_campaign
from lbacal_twin.faults.fault import Fault
from lbacal_twin.faults.hardware import GainTemperature
from lbacal_twin.faults.sky import DipoleSwap, IonosphericAbsorption, LstOffset, RfiBroadband
from lbacal_twin.settings import TwinSettings
from service.cli.opening import configure_logs
from service.config import Settings
from service.errors import NotInEffectError
from service.factory import Factory
from service.scheduler import look_for_due_work
from service.storage.migration import upgrade
from service.storage.versions import Version
from service.usecases.calibrations import select_paths
from service.usecases.drift import start_of_year
from service.wire.bodies import AdoptionBody, InvestigationBody, ReasonBody, RefitBody
from service.worker import Worker
from validation.machinery.claims import Found, exactly, mean_of, rate_of, root_mean_of, worst_of
from validation.machinery.parts import Part, Row
from validation.machinery.tables import by
from validation.running.postgres import open_databases
from validation.twin import CHANNELS, planted_curve

STATION = Scope("CS002")
SETTINGS = TwinSettings(stations=("CS002",), antennas=4, events_per_year=900, years=3.0)
SERVICE: dict[str, Any] = {"nightly_investigations": False, "gate_error": 0.5, "log_level": "error"}
FAULTS: dict[str, Fault] = {
    "ionospheric_absorption": IonosphericAbsorption(size=0.45),
    "lst_offset": LstOffset(size=0.45),
    "dipole_swap": DipoleSwap(size=0.2),
    "gain_temperature": GainTemperature(size=0.18),
    "rfi_broadband": RfiBroadband(size=0.08, index=-2.0, hours=(6.0, 18.0)),
}
"""With the sizes that are tried first."""
LARGEST = {"ionospheric_absorption": 1.0, "gain_temperature": 0.25, "dipole_swap": 1.0}
"""Absorption leaves a third of the power at 30 MHz; between -10 and 30 degrees a gain stays within a factor of two."""
FIRST, SECOND, YEAR = ("2014-01-01", "2015-01-01"), ("2015-01-01", "2016-01-01"), ("2016-01-01", "2017-01-01")
WARM = (
    ("2016-04-16", "2016-10-15"),
    ("2016-05-01", "2016-09-01"),
    ("2016-06-01", "2016-10-01"),
    ("2016-05-15", "2016-12-01"),
)
"""Parts of year 3, of which one is calibrated where the gain follows temperature: over a whole year C hardly moves."""
AIMED, TRIES, MOST_STEP = 4.0, 6, 3.0
MOVED = 3.0
REASON = "proof"


@dataclass(frozen=True)
class Years:
    """Three calendar years of a station with a fault in the last two, and the same years without it."""

    sky: Path
    fault: Fault
    settings: TwinSettings
    seed: int
    judged: tuple[str, str] = YEAR
    """The part of year 3 whose C is judged."""

    @cached_property
    def factory(self) -> Factory:
        """Instrument and sky power, as the service has them."""
        return Factory(Settings(sky_power=self.sky))

    @cached_property
    def clean(self) -> Campaign:
        """Without the fault."""
        return self._simulate([])

    @cached_property
    def spectra(self) -> Spectra:
        """With the fault from the second year on."""
        faulty, clean = self._simulate([self.fault]).spectra, self.clean.spectra
        is_first = clean.time_unix < start_of_year(2015) / 1e6
        return replace(faulty, power=np.where(is_first[:, None], clean.power, faulty.power))

    def _simulate(self, faults: Sequence[Fault]) -> Campaign:
        rng = np.random.default_rng([15, self.seed])
        return simulate_campaign(self.settings, self.factory.instrument, self.factory.simulation.sky_power, rng, faults)

    def fit(self, spectra: Spectra, window: tuple[str, str], *others: tuple[str, str]) -> FitReport:
        """C of the station in a window, together with others, fitted to some spectra outside the service."""
        lines = [kept for other in others for kept in self.fit(spectra, other).lines]
        beside = [Beside(kept, np.ones(len(kept.owners), dtype=bool)) for kept in lines]
        return fit_calibration(
            spectra.select(_lies_in(spectra, window)), self.factory.simulation.at_its_word(), "station", beside
        )

    @cached_property
    def moved(self) -> float:
        """By how many statistical errors the fault moves C of the part that is judged, fitted by itself."""
        faulty, clean = (self.fit(one, self.judged).curves for one in (self.spectra, self.clean.spectra))
        return _largest(faulty, clean)


def draw_years(settings: TwinSettings, sky: Path, seed: int) -> Years:
    """The years of a seed; size and window are set by the twin and plain fits, before anything is searched."""
    name = list(FAULTS)[seed % len(FAULTS)]
    most, found = LARGEST.get(name, np.inf), list[Years]()
    for window in WARM if name == "gain_temperature" else (YEAR,):
        years = Years(sky, FAULTS[name], settings, seed, window)
        for _ in range(TRIES):
            if MOVED + 0.5 < years.moved < AIMED + 1.0:
                return years
            step = np.clip(AIMED / max(years.moved, 1e-3), 1.0 / MOST_STEP, MOST_STEP)
            size = min(float(f"{years.fault.size * step:.3g}"), most)
            if size == years.fault.size:
                break
            years = replace(years, fault=replace(years.fault, size=size))
        found.append(years)
    return max(found, key=lambda one: min(one.moved, AIMED))


@dataclass(frozen=True)
class Service:
    """A service in this process, on a database of its own."""

    factory: Factory

    def work(self) -> None:
        """Do all jobs."""
        Worker(self.factory, "proof").run(threading.Event(), until_idle=True)

    def night(self) -> None:
        """Find what is due, and do it."""
        look_for_due_work(self.factory)
        self.work()

    def investigate(self, since: str, until: str) -> Any:
        """The investigation of a year of the station."""
        body = InvestigationBody(since=since, until=until, station=STATION.station, reason=REASON)
        number = self.factory.investigations.request(body, REASON)
        self.work()
        with self.factory.database.read() as stores:
            return stores.investigations.get(stores.jobs.get(number).results[0]["results"][0])

    def refit(self, since: str, until: str) -> None:
        """Calibrate the station in a window that is no calendar year."""
        body = RefitBody(
            scope="station", station=STATION.station, since=since, until=until, reason=REASON, promote=True
        )
        self.factory.refits.request(body, REASON)
        self.work()

    def version_of(self, since: str, until: str, model: str | None) -> Version:
        """The station's version of a window that was fitted with a model."""
        for version in self.factory.database.look(lambda stores: stores.versions.search(STATION, None, "", 1000)):
            if [format_instant(edge)[:10] for edge in version.window] == [since, until] and version.model == model:
                return version
        raise LookupError(f"no version of {since} to {until} with model {model}")

    def in_effect(self) -> list[Any]:
        """Curves that the station and its paths are served in the middle of every year, or nothing; bit by bit."""
        paths = [STATION, *select_paths(self.factory.instrument, STATION.station, None, None)]
        return [self._told_at((start_of_year(y) + start_of_year(y + 1)) // 2, paths) for y in (2014, 2015, 2016)]

    def _told_at(self, at: Instant, paths: Sequence[Scope]) -> list[Any]:
        try:
            answer = self.factory.calibrations.in_effect(at, paths)
        except NotInEffectError:
            return []
        return [
            (one.promotion.calibration, one.served.curve.c.tobytes() if one.served.curve.c is not None else None)
            for one in answer.curves
        ]


def close_loop(kind: str, settings: TwinSettings, seed: int) -> Row:
    """One fault: found in year 2, adopted, and what that does to year 3."""
    with tempfile.TemporaryDirectory(prefix="lbacal-loop-") as folder, open_databases(kind, "loop") as (url,):
        sky = Path(folder) / "sky_power.json"
        write_sky_power(compute_sky_power(Factory(Settings()).instrument), sky)
        factory = Factory(Settings(database_url=url, sky_power=sky, **SERVICE))
        configure_logs(factory.settings.log_level)
        try:
            return _close(Service(factory), draw_years(settings, sky, seed))
        finally:
            factory.database.close()


def _close(service: Service, years: Years) -> Row:
    factory = service.factory
    upgrade(factory.database)
    with factory.database.write() as stores:
        stores.spectra.add(years.spectra)
    service.night()
    if years.judged != YEAR:
        service.refit(*years.judged)
    plain, before = service.version_of(*years.judged, None), service.in_effect()
    found = service.investigate(*SECOND)
    findings = found.report["findings"]
    names = [[one["cause"], *one["indistinguishable"]] for one in findings]
    name = next(key for key, fault in FAULTS.items() if type(fault) is type(years.fault))
    row: Row = {
        "fault": name, "size": years.fault.size, "moved": round(years.moved, 3), "gate": plain.gate,
        "status": plain.status, "verdict": found.report["verdict"], "named": names,
        "is_named": bool(names) and name in names[0],
    }  # fmt: skip
    if not row["is_named"]:
        return row
    plan = factory.models.plan_adoption(found.id, AdoptionBody(finding=0, reason=REASON, promote=True), REASON)
    factory.models.adopt(plan, promote=True)
    service.work()
    if years.judged != YEAR:
        service.refit(*years.judged)
    version = service.version_of(*years.judged, plan.model.id)
    adopted, clean = service.in_effect(), years.clean.spectra
    first = factory.database.look(lambda stores: stores.versions.get(adopted[0][0][0]))
    (line,) = factory.models.history()
    (gain,) = [one for one in line.gains_of_change if one.since == start_of_year(2016)]
    left = service.investigate(*YEAR)
    promise, of_promise = plan.change.promise or (0.0, 0.0)
    share = gain.events / findings[0]["gain"]["held_out_events"]
    factory.models.withdraw(plan.model.id, ReasonBody(reason=REASON), REASON)
    service.work()
    return row | {
        "adopted": [plan.cause.size, plan.cause.sigma],
        "gated": version.gate,
        "is_in_effect": bool(adopted[2]) and adopted[2][0][0] == version.id,
        "wrong": _largest(version.curves, years.fit(clean, years.judged, SECOND, FIRST).curves),
        "first": _largest(first.curves, years.fit(clean, FIRST, SECOND, YEAR).curves),
        "pulls": _pulls(years, version.curves),
        "gain": [gain.gain, gain.expected, gain.expected_sigma],
        "promise": [promise * share, of_promise * share],
        "left": left.report["verdict"],
        "is_restored": service.in_effect() == before,
    }


def _pulls(years: Years, curves: Sequence[CalibrationCurve]) -> list[list[float]]:
    """Deviation of C from the truth in statistical errors, at three channels of X and of Y; nothing without C."""
    at, pulls = list(CHANNELS.values()), []
    judged = years.clean.spectra.select(_lies_in(years.clean.spectra, years.judged))
    for curve in curves:
        if curve.c is not None and curve.c_sigma_stat is not None:
            truth = planted_curve(Campaign(judged, years.clean.truth), curve)
            pulls.append(np.round(((curve.c - truth) / curve.c_sigma_stat)[at], 3).tolist())
    return pulls


def _lies_in(spectra: Spectra, window: tuple[str, str]) -> NDArray[np.bool_]:
    since, until = (np.datetime64(one).astype("datetime64[s]").astype(float) for one in window)
    return np.asarray((spectra.time_unix >= since) & (spectra.time_unix < until))


def _largest(curves: Sequence[CalibrationCurve], clean: Sequence[CalibrationCurve]) -> float:
    """Largest difference of C at the three channels from that of the data without the fault, in its errors."""
    at = list(CHANNELS.values())
    moved = [
        np.abs((one.c - right.c) / right.c_sigma_stat)[at].max()
        for one, right in zip(curves, clean, strict=True)
        if one.c is not None and right.c is not None and right.c_sigma_stat is not None
    ]
    return float(max(moved))


def judge(rows: Sequence[Row]) -> list[Found]:
    closed = [row for row in rows if row["is_named"]]
    square = np.mean(np.array([row["pulls"] for row in closed]) ** 2, axis=1)
    of_gain = np.array([(g - e) / s for g, e, s in (row["gain"] for row in closed)])
    of_promise = np.array([(row["gain"][0] - row["promise"][0]) / row["promise"][1] for row in closed])

    def count_of(key: str, of: Sequence[Row], test: Any) -> Found:
        return exactly(key, sum(bool(test(row)) for row in of), n=len(of))

    return [
        rate_of("named", len(closed), len(rows)),
        count_of("moved", rows, lambda r: r["moved"] < MOVED),
        worst_of([root_mean_of("pulls", one) for one in square.T], len(closed)),
        mean_of("right", np.array([row["wrong"] for row in closed])),
        count_of("effect", closed, lambda r: not r["is_in_effect"]),
        root_mean_of("gain", of_gain**2),
        root_mean_of("promise", of_promise**2),
        rate_of("left", sum(row["left"] == "consistent" for row in closed), len(closed)),
        mean_of("before", np.array([row["first"] for row in closed])),
        count_of("restored", closed, lambda r: not r["is_restored"]),
    ]


PARTS = (Part("together", partial(close_loop, "postgresql", SETTINGS), judge, 20, by("fault"), ("pulls",)),)
