from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from alembic import command
from fastapi.testclient import TestClient
from sqlalchemy import inspect, text

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.calibration.own_cable import carry_to_path
from lbacal_core.curves import NOT_IDENTIFIABLE, CalibrationCurve, FitReport
from lbacal_core.instrument import Instrument
from lbacal_core.provenance import canonical_json, hash_content
from lbacal_core.skypower.table import read_sky_power
from lbacal_twin.campaign import Campaign
from service.config import Settings
from service.errors import UnavailableError
from service.factory import Factory
from service.schema.tables import calibration, metadata, promotion
from service.storage.migration import make_config, require_current, upgrade
from service.storage.processes import WORKER
from service.usecases.calibrations import select_paths


def test_the_migrations_make_the_schema_that_the_code_states(factory: Factory) -> None:
    command.check(make_config(factory.database))
    found = inspect(factory.database.engine)  # Alembic compares no keys
    for table in metadata.sorted_tables:
        key = found.get_pk_constraint(table.name)["constrained_columns"]
        assert key == [column.name for column in table.primary_key], table.name


def test_an_upgrade_can_be_run_again(factory: Factory) -> None:
    upgrade(factory.database)
    require_current(factory.database)


def test_an_old_schema_is_refused_with_the_cure(factory: Factory, client: TestClient) -> None:
    with factory.database.write() as stores:
        stores.processes.see("worker", WORKER, None)
    assert client.get("/readyz").status_code == 200
    command.downgrade(make_config(factory.database), "base")
    with pytest.raises(UnavailableError, match="run `lbacal db upgrade`"):
        require_current(factory.database)
    answer = client.get("/readyz", headers={"Authorization": ""})
    assert (answer.status_code, answer.headers["retry-after"]) == (503, "5")


SINCE, UNTIL = 1_388_534_400_000_000, 1_420_070_400_000_000
JUNE = 1_401_580_800_000_000
Fits = dict[str, FitReport]


@pytest.fixture(scope="session")
def fits(three_cables: Campaign, superterp: Instrument, sky_power_file: Path) -> Fits:
    sky = read_sky_power(sky_power_file)
    scopes = ("antenna", "station", "array")
    return {scope: fit_calibration(three_cables.spectra, superterp, sky, scope) for scope in scopes}


def without_flags(curve: CalibrationCurve) -> CalibrationCurve:
    """A curve as the first release gave it: without flags, and none at all where one channel had no value."""
    if curve.has_value.all():
        return replace(curve, flag=None)
    return replace(curve, flag=None, status=NOT_IDENTIFIABLE, c=None, c_sigma_stat=None)


def first_release(report: FitReport, instrument: str, promoted_until: int) -> Iterator[dict[str, Any]]:
    """The rows of versions as the first release wrote them."""
    groups: dict[tuple[Any, ...], list[Any]] = {}
    for curve in report.curves:
        key = (curve.station, curve.antenna, None if curve.antenna is None else curve.dipole)
        groups.setdefault(key, []).append(without_flags(curve).as_dict())
    for (station, antenna, dipole), curves in groups.items():
        scope = "/".join(str(part) for part in (station, antenna, dipole) if part is not None) or "array"
        inputs = {**report.provenance.inputs, "instrument": instrument, "model_version": 1, "scope": scope}
        yield {
            "id": hash_content(inputs), "scope": scope, "station": station, "antenna": antenna, "dipole": dipole,
            "since_us": SINCE, "until_us": promoted_until, "status": "converged", "events": curves[0]["events"],
            "inputs": canonical_json(inputs), "curves": canonical_json(curves), "payload_sha256": hash_content(curves),
            "gate": None, "made_us": UNTIL, "made_by": "first", "reason": "test",
        }  # fmt: skip


@pytest.fixture
def old(database_url: str, sky_power_file: Path, three_cables: Campaign, clock: Any, fits: Fits) -> Iterator[Factory]:
    """A database that the first release filled: spectra, versions of every scope, and the wide ones in effect."""
    made = Factory(Settings(database_url=database_url, sky_power=sky_power_file), clock)
    command.downgrade(make_config(made.database), "0001")
    with made.database.write() as stores:
        stores.spectra.add(three_cables.spectra)
    digest = made.instrument.digest()
    known = [row for scope in ("antenna", "station", "array") for row in first_release(fits[scope], digest, UNTIL)]
    unknown = list(first_release(fits["station"], "0" * 64, UNTIL))
    with made.database.engine.begin() as connection:
        connection.execute(calibration.insert(), [*known, *unknown])
        wide = [(row, SINCE, UNTIL) for row in known if row["antenna"] is None]
        for row, start, end in [*wide, *((row, UNTIL, 2 * UNTIL) for row in unknown)]:
            connection.execute(
                promotion.insert().values(
                    scope=row["scope"], station=row["station"], valid_from_us=start, valid_to_us=end,
                    calibration=row["id"], at_us=UNTIL, by="first", reason="test",
                )
            )  # fmt: skip
    yield made
    made.database.close()


def dump(factory: Factory) -> dict[str, list[dict[str, Any]]]:
    """Every row of every table of the first schema."""
    names = ("api_key", "calibration", "event", "event_flag", "job", "job_part", "path", "promotion", "spectrum")
    with factory.database.engine.begin() as connection:
        return {
            name: [
                {key: value for key, value in row._mapping.items() if key not in ("reference", "anomalies")}
                for row in connection.execute(text(f"SELECT * FROM {name} ORDER BY 1, 2"))  # noqa: S608 - the list above
            ]
            for name in names
        }


def test_the_upgrade_of_the_first_release_loses_nothing(old: Factory) -> None:
    before = dump(old)
    assert len(before["spectrum"]) == 4752
    upgrade(old.database, lambda: old.instrument)
    require_current(old.database)
    assert dump(old) == before
    command.downgrade(make_config(old.database), "0001")
    assert dump(old) == before


def test_versions_of_the_first_release_tell_paths_what_a_fit_of_today_tells_them(old: Factory, fits: Fits) -> None:
    upgrade(old.database, lambda: old.instrument)
    for station, by in (("CS002", "station"), ("CS003", "array")):
        told = old.calibrations.in_effect(JUNE, select_paths(old.instrument, station, None, None)).curves
        assert len(told) == 96
        for answer in told:
            curve, path = answer.told.curve, answer.told.curve
            k = next(k for k, one in enumerate(fits[by].curves) if one.dipole == curve.dipole)
            report, name = fits[by], (str(path.station), int(str(path.antenna)), str(path.dipole))
            today = carry_to_path(report.curves[k], report.chains[k], *name, JUNE / 1e6)
            np.testing.assert_allclose(curve.c, today.curve.c, rtol=1e-12)
            assert (answer.told.flag, answer.told.reason) == (today.flag, today.reason)
            if today.curve.c_sigma_sys is not None:
                # a path that is lost to one bad channel has no stored curve, but the fit knows its other channels: of
                # about six paths a cable one or two are missing
                np.testing.assert_allclose(curve.c_sigma_sys, today.curve.c_sigma_sys, rtol=0.6)


def test_a_version_whose_instrument_nobody_knows_answers_as_it_is_and_says_so(old: Factory) -> None:
    upgrade(old.database)
    (answer,) = old.calibrations.in_effect(UNTIL + 1, select_paths(old.instrument, "CS002", 0, "X")).curves
    assert answer.told.flag == "uncertain"
    assert answer.told.reason == "the cables behind this curve are not known: it is that of a mean of paths"
    assert answer.told.curve.c_sigma_sys is None
    np.testing.assert_array_equal(answer.told.factor, 1.0)


def test_members_that_changed_since_are_doubted(old: Factory, three_cables: Campaign) -> None:
    spectra = three_cables.spectra
    late = spectra.select(spectra.event_id == spectra.event_id[0])
    with old.database.write() as stores:
        stores.spectra.add(replace(late, event_id=np.array([f"late {name}" for name in late.event_id])))
    upgrade(old.database, lambda: old.instrument)
    (answer,) = old.calibrations.in_effect(JUNE, select_paths(old.instrument, "CS002", 0, "X")).curves
    assert answer.told.flag == "uncertain"
    assert answer.told.reason == "its members were counted among 199 events; it was made from 198"


def test_an_instrument_of_ones_own_is_found_by_its_hash(old: Factory, tmp_path: Path) -> None:
    content = old.instrument.as_dict() | {"name": "my own"}
    (tmp_path / "own.json").write_text(json.dumps(content))
    own = Factory(old.settings.model_copy(update={"instrument": str(tmp_path / "own.json")}), old.clock)
    inputs = json.dumps({"instrument": own.instrument.digest()})
    with old.database.engine.begin() as connection:
        connection.execute(calibration.update().where(calibration.c.antenna.is_(None)).values(inputs=inputs))
    upgrade(own.database, lambda: own.instrument)
    (answer,) = own.calibrations.in_effect(JUNE, select_paths(own.instrument, "CS002", 0, "X")).curves
    assert answer.told.cable == "80"
    assert np.all(answer.told.factor != 1.0)
    own.database.close()
