"""What ten years of nights do to the service: every question, page and promotion against those of the first year.

Two databases with the whole Superterp, written through the stores: one holds a year, the other ten. In the first half
of the years each night brings an event of one station, in the second half of all six. The nights leave what retention
keeps of them (docs/decisions/retention.md), jobs, monthly ratios of every path, and events with few spectra. The same
requests are put to both in turn, through the whole application; a ratio is that of the medians of nine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from fastapi.testclient import TestClient

from lbacal_core.curves.curves import CONVERGED, CalibrationCurve
from lbacal_core.curves.validity import Promotion, Scope
from lbacal_core.drift.follow import FEWEST_YEARS
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.spectra.spectra import Spectra
from service.app import make_app
from service.cli.opening import configure_logs
from service.factory import Factory
from service.schema.tables import job, job_part
from service.storage.drift import NUMBERS, PathMonths
from service.storage.versions import Version
from service.usecases.calibrations import select_paths
from service.usecases.drift import keep_months, start_of_year
from service.wire.bodies import TagBody
from validation.benchmarks.timing import median_times
from validation.machinery.claims import Found, exactly
from validation.machinery.parts import Part, Row
from validation.running.ledger import open_factory, write_promotions
from validation.running.postgres import open_databases

FIRST, YEARS = 2016, 10
KEPT = 40
"""Versions of a path that a year of nights leaves: each 5 % more events than the one before, from 120 to 900."""
TURNS = 9
NIGHTS = 365
PARTS_A_NIGHT = 19
STEPS_A_YEAR = 4
BATCH = 2000
INSTRUMENT = load_instrument("lofar-superterp")
PATHS = select_paths(INSTRUMENT, None, None, None)
STATIONS = sorted({str(path.station) for path in PATHS})
HALF = YEARS // 2


def make_version(scope: Scope, year: int, number: int, rng: np.random.Generator) -> Version:
    """One version of a year of a scope."""
    size = INSTRUMENT.frequency_mhz.size
    curves = tuple(
        CalibrationCurve(
            station=scope.station, antenna=scope.antenna, dipole=dipole, status=CONVERGED, events=120 + 20 * number,
            frequency_mhz=INSTRUMENT.frequency_mhz, c=rng.normal(2e-5, 2e-7, size), c_sigma_stat=np.full(size, 2e-7),
            c_sigma_sys=None, chi2_per_dof=1.0, lst_coverage=0.9, parameters={},
        )
        for dipole in ([scope.dipole] if scope.dipole else "XY")
    )  # fmt: skip
    since, until = start_of_year(year), start_of_year(year + 1)
    inputs = {"scope": scope.key, "year": year, "number": number}
    return Version(scope, since, until, inputs, curves, since + number, "scheduler", "night")


def fill(factory: Factory, years: int, kept: int) -> None:
    rng = np.random.default_rng(years)
    scopes = [*PATHS, *(Scope(station) for station in STATIONS), Scope()]
    promotions: list[Promotion] = []
    for year in range(FIRST, FIRST + years):
        since, until = start_of_year(year), start_of_year(year + 1)
        night_us = (until - since) // kept
        made = (make_version(scope, year, k, rng) for k in range(kept) for scope in scopes)
        while some := list(islice(made, BATCH)):
            with factory.database.write() as stores:
                stores.versions.add(some)
            promotions += [
                Promotion(0, v.scope, since, until, v.id, since + (v.made - since) * night_us, "scheduler", "night")
                for v in some
            ]
        _fill_events(factory, year, rng)
        _fill_months(factory, year, rng)
        _fill_jobs(factory, year)
    write_promotions(factory, promotions)
    with factory.database.write() as stores:
        stores.drift.keep_report("proof", make_report(years, rng), start_of_year(FIRST + years))
    factory.tags.put("growth", TagBody(reason="proof"), "proof")
    with factory.database.engine.begin() as connection:
        connection.exec_driver_sql("ANALYZE")


def _fill_events(factory: Factory, year: int, rng: np.random.Generator) -> None:
    """One event a night, with two paths of the station of the night, or of all stations; the first has all paths."""
    of_night = [[STATIONS[k % 6]] if year < FIRST + HALF else STATIONS for k in range(NIGHTS)]
    rows = [(0, path) for path in PATHS]
    rows += [(k, Scope(s, 0, d)) for k, stations in enumerate(of_night[1:], 1) for s in stations for d in "XY"]
    nights = np.array([k for k, _ in rows])
    with factory.database.write() as stores:
        stores.spectra.add(
            Spectra(
                frequency_mhz=INSTRUMENT.frequency_mhz,
                power=rng.lognormal(0.0, 0.1, (len(rows), INSTRUMENT.frequency_mhz.size)),
                event_id=np.array([f"{year}-{k}" for k in nights]),
                time_unix=start_of_year(year) / 1e6 + 86_400.0 * nights + 3600.0,
                station=np.array([path.station for _, path in rows]),
                antenna=np.array([path.antenna for _, path in rows]),
                dipole=np.array([path.dipole for _, path in rows]),
                blocks=np.full(len(rows), 100),
            )
        )


def _fill_months(factory: Factory, year: int, rng: np.random.Generator) -> None:
    """Twelve monthly ratios of every path."""
    since = start_of_year(year)
    months = np.arange(f"{year}-01", f"{year + 1}-01", dtype="datetime64[M]").astype("datetime64[us]").astype(np.int64)
    with factory.database.write() as stores:
        for station in STATIONS:
            paths = [path for path in PATHS if path.station == station]
            ratios = np.full((len(paths), months.size, len(NUMBERS)), (1.0, 0.006, 0.0, 0.0, 30.0))
            ratios[..., 0] = rng.normal(1.0, 0.01, ratios.shape[:2])
            keep_months(stores, station, since, PathMonths(paths, months, ratios))


def make_report(years: int, rng: np.random.Generator) -> dict[str, Any]:
    """Make the report of a watch: steps of single paths every year, a slope of every path, trends from year three."""
    shape = {name: {"value": 0.0, "sigma": 0.001} for name in ("tilt", "curvature")}
    changes = []
    for k in range(STEPS_A_YEAR * years):
        path, date = PATHS[int(rng.integers(len(PATHS)))], start_of_year(FIRST) / 1e6 + 7e6 * k
        size = {"size": 0.03, "sigma": 0.002, "significance": 12.0}
        changes.append(
            {
                "station": path.station, "members": [{"antenna": path.antenna, "dipole": path.dipole, **size}],
                "date_unix": date, "date_sigma_days": 1.0, "earliest_unix": date - 2e5, "latest_unix": date + 2e5,
                "shape": shape, "is_known": False, **size,
            }
        )  # fmt: skip
    slopes = [
        {
            "station": path.station, "antenna": path.antenna, "dipole": path.dipole, "slope": 0.0, "sigma": 1e-4,
            "shape": shape, "significance": 1.0, "is_found": False, "season": 0.01,
        }
        for path in PATHS
    ]  # fmt: skip
    zeros = [0.0] * INSTRUMENT.frequency_mhz.size
    trend = {
        "slope": 0.0, "sigma": 0.01, "limit_95": 0.02, "scatter": 0.05, "years": years, "p_value": 0.5,
        "middle_unix": start_of_year(FIRST) / 1e6 + 1.6e7 * years, "season": [0.01, 0.0, 0.0, 0.0],
        "frequency": {"mhz": INSTRUMENT.frequency_mhz.tolist(), "slope": zeros, "sigma": zeros},
    }  # fmt: skip
    names = ["array", *STATIONS] if years >= FEWEST_YEARS else []
    return {"threshold_sigma": 5.2, "changes": changes, "slopes": slopes, "trends": dict.fromkeys(names, trend)}


def _fill_jobs(factory: Factory, year: int) -> None:
    """The jobs of every night, done."""
    window = {"since": start_of_year(year), "until": start_of_year(year + 1)}
    with factory.database.engine.begin() as connection:
        first = connection.exec_driver_sql("SELECT coalesce(max(id), 0) FROM job").scalar_one() + 1
        numbers = range(first, first + NIGHTS * PARTS_A_NIGHT)
        request = f'{{"scope":"antenna","since":{window["since"]},"station":"CS002","until":{window["until"]}}}'
        jobs = [
            {
                "id": k, "kind": "refit", "request": request, "reason": "night", "by": "scheduler", "created_us": k,
                "due_name": f"night {k}", "due_key": f"night {k}", "is_cancelled": False,
            }
            for k in numbers
        ]  # fmt: skip
        result = '{"calibrations":[],"examined":96,"gated":{},"promoted":[]}'
        parts = [
            {"job": k, "request": request, "state": "done", "attempts": 1, "result": result, "ended_us": k}
            for k in numbers
        ]
        connection.execute(job.insert(), jobs)
        connection.execute(job_part.insert(), parts)


def requests(years: int, kept: int) -> dict[str, Callable[[TestClient, int], Any]]:
    """The requests by name; each takes the client and the number of the turn."""
    path: dict[str, Any] = {"station": "CS002", "antenna": 17, "dipole": "X"}
    newest = make_version(Scope("CS002", 17, "X"), FIRST + years - 1, 0, np.random.default_rng(0)).id
    older = make_version(Scope("CS002", 17, "X"), FIRST, 0, np.random.default_rng(0)).id
    inside, gap = "2016-06-01", "2035-06-01"
    since = f"{FIRST + years - 1}-12-01"
    effective = "/v1/calibrations/effective"

    def ask(url: str, status: int = 200, **params: Any) -> Callable[[TestClient, int], Any]:
        def get(client: TestClient, _: int) -> Any:
            answer = client.get(url, params=params)
            if answer.status_code != status:
                raise RuntimeError(f"{url}: {answer.status_code} {answer.text[:200]}")
            return answer

        return get

    def promote(station: str | None, antenna: int | None) -> Callable[[TestClient, int], Any]:
        scope = Scope(station, antenna, None if antenna is None else "X")

        def post(client: TestClient, turn: int) -> Any:
            version = make_version(scope, FIRST, turn % kept, np.random.default_rng(0)).id
            body = {"calibration": version, "valid_from": "2016-01-01", "valid_to": "2017-01-01", "reason": "proof"}
            return client.post("/v1/promotions", json=body).raise_for_status()

        return post

    return {
        "effective, one path": ask(effective, at=inside, **path),
        "effective, one path, by tag": ask(effective, at=inside, tag="growth", **path),
        "effective, a station": ask(effective, at=inside, station="CS002"),
        "effective, all paths": ask(effective, at=inside),
        "gap, one path": ask(effective, 404, at=gap, **path),
        "gap, all paths": ask(effective, 404, at=gap),
        "gap, one path held": ask(effective, at=gap, gap="hold", **path),
        "edges": ask("/v1/calibrations/edges", as_of="2026-01-01"),
        "versions": ask("/v1/calibrations", limit=100),
        "versions of a path": ask("/v1/calibrations", limit=20, **path),
        "a version": ask(f"/v1/calibrations/{newest}"),
        "two versions": ask(f"/v1/calibrations/{older}/diff/{newest}"),
        "events": ask("/v1/events", limit=100),
        "events of a month": ask("/v1/events", limit=100, since=since),
        "jobs": ask("/v1/jobs", limit=100),
        "tags": ask("/v1/tags"),
        "status": ask("/v1/status"),
        "drift of a path": ask("/v1/drift", **path | {"antenna": 0}),
        "drift of a station": ask("/v1/drift", station="CS002"),
        "drift": ask("/v1/drift"),
        "page: overview": ask("/"),
        "page: drift": ask("/drift"),
        "page: a station": ask("/stations/CS002"),
        "page: a version": ask(f"/calibrations/{newest}"),
        "page: jobs": ask("/jobs"),
        "promotion of a path": promote("CS002", 17),
        "promotion of a station": promote("CS002", None),
        "promotion of the array": promote(None, None),
    }


def compare(kind: str, seed: int, years: int = YEARS, kept: int = KEPT, turns: int = TURNS) -> Row:
    """Put the same requests to a service of one year and to one of many."""
    del seed  # one fixed case
    configure_logs("warning")
    with (
        open_databases(kind, "small", "large") as urls,
        _service(urls[0], 1, kept) as small,
        _service(urls[1], years, kept) as large,
    ):
        of_large = requests(years, kept)
        found = {}
        for name, ask in requests(1, kept).items():
            works = {"small": partial(ask, small), "large": partial(of_large[name], large)}
            found[name] = [round(1e3 * median, 2) for median in median_times(works, turns + 1).values()]
        sizes = [_size(client) for client in (small, large)]
    return {"years": years, "kept": kept, "turns": turns, "ms": found, "megabytes": sizes}


def _size(client: TestClient) -> int:
    factory = client.app.state.factory  # type: ignore[attr-defined] # starlette's application has it
    if factory.settings.is_sqlite:
        return round(Path(factory.database.engine.url.database).stat().st_size / 1e6)
    with factory.database.engine.connect() as connection:
        found = connection.exec_driver_sql("SELECT pg_database_size(current_database())").scalar_one()
    return round(int(found) / 1e6)


@contextmanager
def _service(url: str, years: int, kept: int) -> Iterator[TestClient]:
    with open_factory(url) as factory:
        fill(factory, years, kept)
        _, key = factory.keys.create(("admin",))
        with TestClient(make_app(factory), headers={"Authorization": f"Bearer {key}"}) as client:
            yield client


def judge(rows: Sequence[Row]) -> list[Found]:
    (row,) = rows
    after = {name: ms[1] for name, ms in row["ms"].items()}
    found = (
        ("ratio", max(later / before for before, later in row["ms"].values()), ""),
        ("gap", max(after["gap, one path"], after["gap, all paths"]), "ms"),
        ("promotion", after["promotion of a path"], "ms"),
        ("array", after["promotion of the array"], "ms"),
    )
    return [exactly(key, value, unit, row["turns"]) for key, value, unit in found]


PARTS = tuple(
    Part(
        kind,
        partial(compare, kind),
        judge,
        1,
        headlines=("ratio",) if kind == "postgresql" else (),
        has_chance=False,
        is_parallel=False,
    )
    for kind in ("sqlite", "postgresql")
)
