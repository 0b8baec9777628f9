from __future__ import annotations

import pytest
from alembic import command
from fastapi.testclient import TestClient

from service.errors import UnavailableError
from service.factory import Factory
from service.storage.migration import make_config, require_current, upgrade


def test_the_migrations_make_the_schema_that_the_code_states(factory: Factory) -> None:
    command.check(make_config(factory.database))


def test_an_upgrade_can_be_run_again(factory: Factory) -> None:
    upgrade(factory.database)
    require_current(factory.database)


def test_an_old_schema_is_refused_with_the_cure(factory: Factory, client: TestClient) -> None:
    assert client.get("/readyz").status_code == 200
    command.downgrade(make_config(factory.database), "base")
    with pytest.raises(UnavailableError, match="run `lbacal db upgrade`"):
        require_current(factory.database)
    answer = client.get("/readyz", headers={"Authorization": ""})
    assert (answer.status_code, answer.headers["retry-after"]) == (503, "5")
