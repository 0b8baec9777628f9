from __future__ import annotations

import itertools
import json
import os
import re
import shutil
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import psycopg
import pytest
import uvicorn
from fastapi.testclient import TestClient

from lbacal_core.curves.curves import CONVERGED, CalibrationCurve
from lbacal_core.curves.validity import Scope
from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.provenance import MODEL_VERSION, Provenance
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import read_sky_power, write_sky_power
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import Campaign, simulate_campaign
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.hardware import GainStep
from lbacal_twin.settings import TwinSettings
from service.app import make_app
from service.config import Settings
from service.factory import Factory
from service.scheduler import look_for_due_work
from service.storage.database import Database
from service.storage.jobs import Job
from service.storage.migration import upgrade
from service.storage.versions import Version
from service.usecases.orders import Inputs
from service.wire.bodies import RefitBody
from service.worker import Worker
from validation.running.postgres import run_postgres


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """What fits a campaign runs on SQLite in the first tier; what does so for long on PostgreSQL in the second.

    Asked for by itself such a test runs on both; one that names its kinds of database runs on these.
    """
    left_out = []
    is_suite = config.option.markexpr == "long"
    for item in items:
        if "make_service" not in getattr(item, "fixturenames", ()):
            continue
        names_kinds = any(mark.args[0] == "database_url" for mark in item.iter_markers("parametrize"))
        if is_suite and item.get_closest_marker("long") and "sqlite" in item.name and not names_kinds:
            left_out.append(item)
        elif "postgresql" in item.name:
            item.add_marker("long")
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if item not in left_out]


CHANNELS = 4
MHZ = [30.0, 45.0, 60.0, 80.0]


def instant(text: str) -> int:
    moment = datetime.fromisoformat(text).replace(tzinfo=UTC)
    return round(moment.timestamp() * 1_000_000)


class Clock:
    """A clock that stands until it is moved; every reading is one microsecond later than the one before."""

    def __init__(self) -> None:
        self.now = instant("2020-01-01")

    def __call__(self) -> int:
        self.now += 1
        return self.now


def work(factory: Factory) -> None:
    Worker(factory, "worker").run(threading.Event(), until_idle=True)


def get_job(factory: Factory, number: int) -> Job:
    return factory.database.look(lambda stores: stores.jobs.get(number))


def get_version(factory: Factory, name: str) -> Version:
    return factory.database.look(lambda stores: stores.versions.get(name))


def night(factory: Factory) -> list[Job]:
    """One night: what it enqueued, done, as jobs."""
    numbers = look_for_due_work(factory)
    work(factory)
    return [get_job(factory, number) for number in numbers]


def take_another_model(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is made from now on has another version of the model, as after an upgrade."""
    monkeypatch.setattr("service.usecases.fits.MODEL_VERSION", 99)
    for made in (Provenance, Inputs):
        defaults = tuple(99 if value == MODEL_VERSION else value for value in made.__init__.__defaults__)
        monkeypatch.setattr(made.__init__, "__defaults__", defaults)


def refit(factory: Factory, scope: str, **more: Any) -> Job:
    """A refit of 2014 whose versions go into effect, done."""
    asked = {"scope": scope, "since": "2014-01-01", "until": "2015-01-01", "reason": "test", "promote": True, **more}
    number = factory.refits.request(RefitBody.model_validate(asked), "test")
    work(factory)
    return get_job(factory, number)


def add_spectra(factory: Factory, spectra: Spectra) -> None:
    with factory.database.write() as stores:
        stores.spectra.add(spectra)


def flat_spectra(*rows: tuple[str, float, str, int, str]) -> Spectra:
    """Power 1 for every row of event, time (s UTC), station, antenna and dipole."""
    event_id, time_unix, station, antenna, dipole = (np.array(column) for column in zip(*rows, strict=True))
    power, blocks = np.ones((len(rows), CHANNELS)), np.full(len(rows), 100)
    return Spectra(np.array(MHZ), power, event_id, time_unix, station, antenna, dipole, blocks)


def tell_night(factory: Factory) -> dict[str, Any]:
    """What a night left: versions and reports by name, what was promoted, how often each part was begun."""
    with factory.database.engine.connect() as connection:

        def ask(words: str) -> list[Any]:
            return [tuple(row) for row in connection.exec_driver_sql(words)]

        return {
            "versions": ask("SELECT id, curves FROM calibration ORDER BY id"),
            "investigations": [
                (name, json.loads(report)) for name, report in ask("SELECT id, report FROM investigation ORDER BY id")
            ],
            "promotions": ask("SELECT scope, calibration FROM promotion ORDER BY scope, calibration"),
            "months": ask("SELECT station, digest FROM drift_year ORDER BY station"),
            "attempts": [count for (count,) in ask("SELECT attempts FROM job_part")],
        }


def bearer(factory: Factory, *scopes: str) -> dict[str, str]:
    """The header of a new key with some scopes."""
    _, key = factory.keys.create(scopes)
    return {"Authorization": f"Bearer {key}"}


def served(factory: Factory, *scopes: str, **more: Any) -> TestClient:
    """A client of the service with a new key, that of an administrator if nothing is said."""
    return TestClient(make_app(factory), headers=bearer(factory, *(scopes or ("admin",))), **more)


@contextmanager
def like(factory: Factory, **changes: Any) -> Iterator[Factory]:
    """The service with other settings."""
    made = Factory(factory.settings.model_copy(update=changes), factory.clock)
    yield made
    made.database.close()


@pytest.fixture(scope="session")
def instrument_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    content = {
        "name": "two small stations", "latitude_deg": 52.9, "longitude_deg": 6.9, "height_m": 50.0,
        "frequency_mhz": MHZ, "dipoles": {"X": {"azimuth_deg": 45.0}, "Y": {"azimuth_deg": 135.0}},
        "antenna_gain": [0.1] * CHANNELS, "receiver_gain": [1.0] * CHANNELS, "cables": {"80m": [0.5] * CHANNELS},
        "antennas": [{"station": s, "antenna": a, "cable": "80m"} for s in ("CS001", "CS002") for a in range(3)],
    }  # fmt: skip
    path = tmp_path_factory.mktemp("instrument") / "instrument.json"
    path.write_text(json.dumps(content))
    return path


@pytest.fixture(scope="session")
def instrument(instrument_file: Path) -> Instrument:
    return load_instrument(str(instrument_file))


@pytest.fixture(scope="session")
def postgres(request: pytest.FixtureRequest) -> Iterator[str]:
    request.getfixturevalue("needs_postgres")
    with run_postgres() as url:
        yield url


_names = itertools.count()


@pytest.fixture(scope="session")
def sqlite_template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("template") / "lbacal.sqlite"
    database = Database(f"sqlite:///{path}")
    upgrade(database)
    database.close()
    return path


def copy_database(origin: str, copy: str) -> None:
    """Make a database of either kind that is that of another, which nobody uses meanwhile."""
    if "://" not in copy:
        # closing the last connection left all of it in the one file
        shutil.copy(origin, copy)
        return
    drop_database(copy)
    one, other = (name_in_server(url) for url in (copy, origin))
    with psycopg.connect(copy.replace(f"/{one}?", "/postgres?", 1), autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {one} TEMPLATE {other} STRATEGY FILE_COPY")


def drop_database(url: str) -> None:
    """Drop a database of PostgreSQL, whoever uses it."""
    name = name_in_server(url)
    with psycopg.connect(url.replace(f"/{name}?", "/postgres?", 1), autocommit=True) as connection:
        connection.execute(f"DROP DATABASE IF EXISTS {name} WITH (FORCE)")


def name_in_server(url: str) -> str:
    """The name of a database of PostgreSQL."""
    return urlsplit(url).path.removeprefix("/")


@pytest.fixture(scope="session")
def postgres_template(postgres: str) -> str:
    url = postgres.replace("/postgres?", f"/template_{os.getpid()}?", 1)
    with psycopg.connect(postgres, autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {name_in_server(url)}")
    database = Database(Settings(database_url=url).sqlalchemy_url)
    upgrade(database)
    database.close()
    return url


@pytest.fixture(params=["sqlite", "postgresql"])
def database_url(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    """A database of either kind with the schema and nothing in it."""
    if request.param == "sqlite":
        copy_database(request.getfixturevalue("sqlite_template"), str(tmp_path / "lbacal.sqlite"))
        yield str(tmp_path / "lbacal.sqlite")
        return
    template = request.getfixturevalue("postgres_template")
    url = template.replace("/template_", f"/test_{next(_names)}_", 1)
    copy_database(template, url)
    yield url
    drop_database(url)


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def factory(database_url: str, instrument_file: Path, clock: Clock) -> Iterator[Factory]:
    made = Factory(Settings(database_url=database_url, instrument=str(instrument_file)), clock)
    yield made
    made.database.close()


@pytest.fixture
def client(factory: Factory) -> Iterator[TestClient]:
    with served(factory, raise_server_exceptions=False) as made:
        yield made


def _curve(scope: Scope, dipole: str, level: float = 1.0, status: str = CONVERGED) -> CalibrationCurve:
    good = status == CONVERGED
    return CalibrationCurve(
        station=scope.station, antenna=scope.antenna, dipole=dipole, status=status, events=100,
        frequency_mhz=np.array(MHZ), c=level * np.array([1.0, 2.0, 3.0, 4.0]) if good else None,
        c_sigma_stat=np.full(CHANNELS, 0.01) if good else None, c_sigma_sys=None, chi2_per_dof=1.0 if good else None,
        lst_coverage=1.0, parameters={},
    )  # fmt: skip


def new_version(scope: Scope, name: str, level: float = 1.0, status: str = CONVERGED, **more: Any) -> Version:
    """A version whose inputs are just its name."""
    dipoles = [scope.dipole] if scope.dipole else ["X", "Y"]
    content = {
        "since": instant("2014-01-01"), "until": instant("2015-01-01"), "made": instant("2019-12-31"),
        "made_by": "test", "reason": "test", **more,
    }  # fmt: skip
    curves = tuple(_curve(scope, dipole, level, status) for dipole in dipoles)
    return Version(scope=scope, inputs={"name": name}, curves=curves, **content)


@pytest.fixture
def stored(factory: Factory) -> dict[str, Version]:
    """One version for the array, one station and one path, none promoted."""
    versions = {
        "array": new_version(Scope(), "array", 1.0),
        "station": new_version(Scope("CS001"), "station", 1.1),
        "path": new_version(Scope("CS001", 0, "X"), "path", 1.2),
        "other": new_version(Scope("CS001", 0, "X"), "other", 1.3),
        "failed": new_version(Scope("CS001", 0, "X"), "failed", status="too_few_events"),
    }
    with factory.database.write() as stores:
        stores.versions.add(list(versions.values()))
    return versions


STEP = GainStep(size=0.15, date="2015-04-11", where=Where(antennas=(2,), dipoles=("Y",)))


@pytest.fixture(scope="session")
def superterp() -> Instrument:
    return load_instrument("lofar-superterp")


@pytest.fixture(scope="session")
def sky_power_file(superterp: Instrument, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sky") / "sky_power.json"
    write_sky_power(compute_sky_power(superterp, lst_hours=np.arange(24.0)), path)
    return path


@pytest.fixture(scope="session")
def campaign(superterp: Instrument, sky_power_file: Path) -> Spectra:
    """The years 2014 and 2015 of four antennas of CS002, 400 events each, with `STEP` in one path."""
    settings = TwinSettings(stations=("CS002",), antennas=4, years=1.99, events_per_year=400)
    sky = read_sky_power(sky_power_file)
    return simulate_campaign(settings, superterp, sky, np.random.default_rng(2014), [STEP]).spectra


@pytest.fixture(scope="session")
def three_cables(superterp: Instrument, sky_power_file: Path) -> Campaign:
    """A year of the first twelve antennas of CS002, which have cables of 50, 80 and 115 m."""
    settings = TwinSettings(stations=("CS002",), antennas=12, years=0.99, events_per_year=200)
    return simulate_campaign(settings, superterp, read_sky_power(sky_power_file), np.random.default_rng(3))


@pytest.fixture(scope="session")
def simulations() -> dict[tuple[str, Any], Simulation]:
    """By what they predict and their own causes: what they remember of the campaign is computed once."""
    return {}


@pytest.fixture
def make_service(
    database_url: str, sky_power_file: Path, clock: Clock, simulations: dict[tuple[str, Any], Simulation]
) -> Iterator[Callable[..., Factory]]:
    """Makes services of one database and one sky power, which hold spectra and are closed in the end."""
    made: list[Factory] = []

    def make(spectra: Spectra | None = None, **more: Any) -> Factory:
        # an investigation of a year takes seconds: usecases/test_investigations.py looks at the nightly ones
        quick = {"poll_s": 0.01, "nightly_investigations": False, "sky_power": sky_power_file, **more}
        made.append(Factory(Settings(**{"database_url": database_url} | quick), clock))
        key = made[-1].simulation.digest, made[-1].settings.causes
        made[-1].simulation = simulations.setdefault(key, replace(made[-1].simulation, most_remembered=64))
        if spectra is not None:
            add_spectra(made[-1], spectra)
        return made[-1]

    yield make
    for factory in made:
        factory.database.close()


@pytest.fixture
def station(make_service: Callable[..., Factory], campaign: Spectra) -> Factory:
    """A service that holds the campaign."""
    return make_service(campaign, lease_s=5.0, cut_windows=False)


@dataclass
class Kept:
    """A database that several tests begin with: where it was copied, and the instant then."""

    url: str
    now: int


@pytest.fixture(scope="session")
def kept() -> dict[tuple[str, str, str], Kept]:
    """By what was done, the spectra and the kind of database."""
    return {}


@pytest.fixture
def begin_with(
    station: Factory, campaign: Spectra, clock: Clock, kept: dict[tuple[str, str, str], Kept],
    tmp_path_factory: pytest.TempPathFactory,
) -> Callable[[str, Callable[[], object]], None]:  # fmt: skip
    """Brings the database of the station into a state: what makes it is done once a kind, then the result is copied."""

    def begin(name: str, make: Callable[[], object]) -> None:
        own, kind = station.settings.database_url, station.database.engine.dialect.name
        key = name, campaign.digest(), kind
        if key in kept:
            station.database.close()
            copy_database(kept[key].url, own)
            clock.now = kept[key].now
            return
        make()
        folder, number = tmp_path_factory.mktemp("kept"), next(_names)
        url = str(folder / "kept.sqlite") if kind == "sqlite" else re.sub("/test_", f"/kept_{number}_", own, count=1)
        station.database.close()
        copy_database(own, url)
        kept[key] = Kept(url, clock.now)

    return begin


@pytest.fixture
def after_night(station: Factory, begin_with: Callable[[str, Callable[[], object]], None]) -> Factory:
    """The service of the campaign after its first night, whose versions are in effect; keys are made after it."""
    begin_with("night", lambda: night(station))
    return station


@pytest.fixture
def http(station: Factory) -> Iterator[TestClient]:
    """An administrator's client of the station's service."""
    with served(station) as made:
        yield made


def promote(client: TestClient, version: Version | None, start: str, end: str | None = None, **scope: Any) -> Any:
    """Promote a version over HTTP; without one, withdraw what is in effect."""
    body = {"calibration": version and version.id, "valid_from": start, "valid_to": end, "reason": "test", **scope}
    answer = client.post("/v1/promotions", json=body)
    assert answer.status_code == 201, answer.text
    return answer.json()


@contextmanager
def listening(factory: Factory) -> Iterator[str]:
    """A real server on a port of its own."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        server = uvicorn.Server(uvicorn.Config(make_app(factory), log_config=None, access_log=False))
        thread = threading.Thread(target=server.run, args=([taken],))
        thread.start()
        while not server.started:
            time.sleep(0.01)
        try:
            yield f"http://127.0.0.1:{taken.getsockname()[1]}"
        finally:  # a failing test would wait for it for ever
            server.should_exit = True
            thread.join()
