"""What the benchmark compares has the same minimum; the speeds themselves are no test."""

from __future__ import annotations

import asyncio
import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import psycopg
import pytest
from fastapi import FastAPI
from sqlalchemy import NullPool, create_engine, func, select

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.curves.validity import Scope
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.blocks import split_into_blocks
from service.app import make_app
from service.factory import Factory
from service.schema.tables import spectrum
from validation.benchmarks.fit import OnePath, farthest, make_scene, make_spectra
from validation.benchmarks.ingest import BulkPostgres, BulkSqlite
from validation.benchmarks.partitions import event_of, load, part_by_year
from validation.benchmarks.partitions import fill as fill_years
from validation.benchmarks.reads import ALL, ONE, add_same, compare_a_year, fill, get
from validation.fit import Scene
from validation.growth import PATHS
from validation.running.ledger import open_factory
from validation.running.postgres import open_databases


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene(stations=1, antennas=2)


@pytest.fixture(scope="module")
def path(scene: Scene) -> OnePath:
    block = split_into_blocks(make_spectra(scene, 300, np.random.default_rng(1)))[0]
    lst = local_sidereal_time(block.time_unix, scene.instrument.longitude_deg)
    return OnePath(scene, block.power[0], scene.sky_power.at(block.dipole, lst))


def test_the_fit_finds_the_minimum_that_scipy_finds_with_all_spectra(scene: Scene, path: OnePath):
    spectra = make_spectra(scene, 300, np.random.default_rng(1))
    report = fit_calibration(spectra, Simulation(scene.instrument, scene.sky_power))
    # SciPy stops when chi^2 changes by 1e-8 of itself, 1e-4 in chi^2 = 0.01 sigma
    assert farthest(report, scene, path.minimise(path.jacobian), path) < 0.01


def test_the_analytic_derivatives_are_those_of_finite_differences(path: OnePath):
    at = np.random.default_rng(2).uniform(0.8, 1.2, path.start.size)
    step = 1e-6
    for k in (0, 25, 51, 52, 53):
        shift = np.zeros_like(at)
        shift[k] = step
        slope = (path.residual(at + shift) - path.residual(at - shift)) / (2 * step)
        np.testing.assert_allclose(path.jacobian(at)[:, k], slope, rtol=1e-6, atol=1e-6)


def count(factory: Factory) -> int:
    """Rows of spectra: what drivers write directly has no counts of events."""
    engine = create_engine(factory.settings.sqlalchemy_url, poolclass=NullPool)
    with engine.connect() as connection:
        return int(connection.execute(select(func.count()).select_from(spectrum)).scalar_one())


@pytest.mark.parametrize(("kind", "make"), [("sqlite", BulkSqlite), ("postgresql", BulkPostgres)])
def test_a_bulk_load_stores_each_spectrum_once(kind: str, make: type, request: pytest.FixtureRequest) -> None:
    if kind == "postgresql":
        request.getfixturevalue("needs_postgres")
    with open_databases(kind, "bulk") as (url,), open_factory(url) as factory:
        bulk = make(url)
        bulk.add_keys(3, 2)
        for events in (1, 2, 2):
            bulk.load([(path, event, 0, 100, bytes(8)) for event in range(events) for path in range(3)])
            assert count(factory) == 3 * events
        bulk.close()


@pytest.mark.usefixtures("needs_postgres")
def test_spectra_in_one_table_are_those_by_year() -> None:
    found = []
    with open_databases("postgresql", "whole", "parted") as urls:
        for url in urls:
            with open_factory(url) as factory:
                if found:
                    with psycopg.connect(url, autocommit=True) as connection:
                        part_by_year(connection)
                fill_years(url, 1, 2)
                with factory.database.write() as stores:
                    assert stores.spectra.add(event_of("S1", 1, 0)) == 96
                    assert stores.spectra.add(event_of("S1", 1, 0)) == 0
                spectra = load(factory.database, Scope("S1"))
                assert spectra is not None
                found.append((len(spectra), spectra.digest()))
    assert found[0] == found[1] == (3 * 96, found[0][1])


def read(app: FastAPI, address: str) -> bytes:
    """Ask in a thread of its own: in this one a browser of other tests may run its loop."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(asyncio.run, get(app, address)).result()


def test_each_path_is_answered_and_a_path_s_year_is_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with open_factory(str(tmp_path / "lbacal.sqlite")) as factory:
        fill(factory, 30)
        app = make_app(factory)
        assert len(json.loads(read(app, ALL))["curves"]) == len(PATHS)
        add_same(app, json.loads(read(app, ONE)))
        assert read(app, "/same") == read(app, ONE)
        compare_a_year(factory)
    assert "a path's year, " in capsys.readouterr().out
