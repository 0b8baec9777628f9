from __future__ import annotations

import pytest
from alembic import command
from fastapi.testclient import TestClient
from sqlalchemy import inspect, text

from service.errors import UnavailableError
from service.factory import Factory
from service.schema.tables import metadata
from service.storage.migration import make_config, require_current, upgrade
from service.storage.processes import WORKER


def test_the_migrations_make_the_schema_that_the_code_states(factory: Factory) -> None:
    command.check(make_config(factory.database))
    found = inspect(factory.database.engine)  # Alembic compares no keys
    for table in metadata.sorted_tables:
        key = found.get_pk_constraint(table.name)["constrained_columns"]
        assert key == [column.name for column in table.primary_key], table.name


@pytest.mark.long
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


@pytest.mark.parametrize(("revision", "cure"), [("0020", "start a new database"), ("9999", "install the newer one")])
def test_a_schema_that_this_version_does_not_know_is_refused(factory: Factory, revision: str, cure: str) -> None:
    with factory.database.engine.begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = :revision"), {"revision": revision})
    for ask in (upgrade, require_current):
        with pytest.raises(UnavailableError, match=cure):
            ask(factory.database)
