"""Questions and promotions against a large ledger, as ratios to a small one.

Run: python -m validation.benchmarks.ledger

The small ledger holds one promotion of each of the 576 paths over a year. The large one holds besides what nights add:
all paths anew over the same year, once a night (174 nights are 100,224 promotions; another number can be given). The
same questions and promotions are put to both in turn, through the use cases and without HTTP, so that other work on the
machine meets both; times are medians.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from lbacal.instants import parse_instant
from lbacal_core.curves.covariance import Budget, BudgetTerm, CurveCovariance
from lbacal_core.curves.curves import CONVERGED, CalibrationCurve, Parameter
from lbacal_core.curves.validity import Promotion, Scope
from lbacal_core.errors import LbacalError
from lbacal_core.instrument.instrument import load_instrument
from service.config import Settings
from service.factory import Factory
from service.storage.migration import upgrade
from service.storage.versions import Version
from service.usecases.calibrations import select_paths
from service.wire.bodies import PromotionBody
from validation.benchmarks.timing import median_times
from validation.running.ledger import write_promotions
from validation.running.postgres import open_databases

TURNS = 9
SINCE, UNTIL = parse_instant("", "2020-01-01"), parse_instant("", "2021-01-01")
GAP, INSIDE = parse_instant("", "2030-06-01"), parse_instant("", "2020-06-01")
INSTRUMENT = load_instrument("lofar-superterp")
PATHS = select_paths(INSTRUMENT, None, None, None)


def make_budget() -> Budget:
    rng = np.random.default_rng(1)
    size = INSTRUMENT.frequency_mhz.size
    vectors = (5, 3, 2, 1, 1)
    return Budget(
        INSTRUMENT.frequency_mhz,
        tuple(
            BudgetTerm(f"term {k}", "benchmark", {dipole: rng.normal(0.0, 0.05, (count, size)) for dipole in "XY"})
            for k, count in enumerate(vectors)
        ),
    )


BUDGET = make_budget()


def make_version(scope: Scope, number: int) -> Version:
    """A version of a scope whose inputs are its number, with all that curves of fits carry and numbers of 17 digits."""
    size = INSTRUMENT.frequency_mhz.size
    rng = np.random.default_rng(number)
    c = np.linspace(1.0e-5, 2.0e-5, size) * (1.0 + number / 1000.0) * rng.normal(1.0, 0.001, size)
    covariance = CurveCovariance(
        rng.normal(0.0, 0.01, (4, size)), np.full(size, 1e-5), BUDGET.digest, rng.normal(0.0, 0.01, (1, size))
    )
    parameters = {name: Parameter(*rng.lognormal(size=2)) for name in ("n_lna", "n_rcu", "n_adc")}
    curves = tuple(
        CalibrationCurve(
            station=scope.station, antenna=scope.antenna, dipole=dipole, status=CONVERGED, events=1000,
            frequency_mhz=INSTRUMENT.frequency_mhz, c=c, c_sigma_stat=0.01 * c, c_sigma_sys=0.13 * c, chi2_per_dof=1.0,
            lst_coverage=1.0, parameters=parameters, flag=("ok",) * size, antenna_gain=INSTRUMENT.antenna_gain,
            chi2_per_dof_profiled=1.0, covariance=covariance,
        )
        for dipole in ([scope.dipole] if scope.dipole else "XY")
    )  # fmt: skip
    return Version(scope, SINCE, UNTIL, {"number": number, "scope": scope.key}, curves, 0, "benchmark", "benchmark")


def fill(factory: Factory, nights: int) -> dict[Scope, list[str]]:
    """Store two versions of each scope and promote those of paths in turn, once a night."""
    versions = {scope: [make_version(scope, k) for k in range(2)] for scope in (*PATHS, Scope("CS002"), Scope())}
    ids = {scope: [version.id for version in of_scope] for scope, of_scope in versions.items()}
    with factory.database.write() as stores:
        stores.budgets.add({BUDGET.digest: BUDGET})
        stores.versions.add([version for of_scope in versions.values() for version in of_scope])
    nightly = (
        Promotion(0, path, SINCE, UNTIL, ids[path][night % 2], SINCE + 1 + night, "benchmark", "night")
        for night in range(-1, nights)
        for path in PATHS
    )
    write_promotions(factory, nightly)
    with factory.database.engine.begin() as connection:
        connection.exec_driver_sql("ANALYZE")
    return ids


def deeds(factory: Factory, ids: dict[Scope, list[str]]) -> dict[str, Callable[[int], object]]:
    path, use = PATHS[0], factory.calibrations

    def ask_gap(paths: list[Scope]) -> None:
        try:
            use.in_effect(GAP, paths)
        except LbacalError:
            return
        raise RuntimeError("there should be a gap")

    def promote(scope: Scope, turn: int) -> None:
        body = PromotionBody(
            calibration=ids[scope][turn % 2], valid_from="2020-01-01", valid_to="2021-01-01", reason="x"
        )
        factory.promotions.promote(factory.promotions.plan(body, "benchmark"), lambda made, _: made)

    return {
        "in a gap, one path": lambda _: ask_gap([path]),
        "in a gap, all paths": lambda _: ask_gap(PATHS),
        "in a gap, all paths held": lambda _: use.in_effect(GAP, PATHS, hold=True),
        "in effect, one path": lambda _: use.in_effect(INSIDE, [path]),
        "in effect, all paths": lambda _: use.in_effect(INSIDE, PATHS),
        "promotion of a path": lambda turn: promote(path, turn),
        "promotion of a station": lambda turn: promote(Scope("CS002"), turn),
        "promotion of the array": lambda turn: promote(Scope(), turn),
    }


def compare(name: str, small_url: str, large_url: str, nights: int) -> None:
    with opened(small_url) as small, opened(large_url) as large:
        both = [deeds(small, fill(small, 0)), deeds(large, fill(large, nights))]
        print(f"{name}: {len(PATHS)} and {len(PATHS) * (1 + nights):,} promotions, medians of {TURNS - 1} turns")
        for what, small_deed in both[0].items():
            before, after = median_times({"small": small_deed, "large": both[1][what]}, TURNS).values()
            print(f"  {what}: {1e3 * before:.1f} ms, {1e3 * after:.1f} ms: {after / before:.2f}")


@contextmanager
def opened(url: str) -> Iterator[Factory]:
    factory = Factory(Settings(database_url=url))
    upgrade(factory.database)
    try:
        yield factory
    finally:
        factory.database.close()


def main(nights: int = 174) -> None:
    for kind in ("sqlite", "postgresql"):
        with open_databases(kind, "small", "large") as urls:
            compare(kind, *urls, nights)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
