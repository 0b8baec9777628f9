from __future__ import annotations

from typing import Any

import pytest

from lbacal_core.errors import BadInputError
from service.errors import ForbiddenError, NotFoundError, UnauthenticatedError
from service.factory import Factory
from service.usecases.keys import Keys


def test_a_key_expires(factory: Factory, clock: Any) -> None:
    _, key = factory.keys.create(("spectra:write",), days=1.0)
    assert factory.keys.require(f"Bearer {key}", "spectra:write", "read").name == "key 1"
    clock.now += 86_400_000_000
    with pytest.raises(UnauthenticatedError):
        factory.keys.require(f"Bearer {key}", "spectra:write")


def test_a_key_is_not_in_the_database(factory: Factory) -> None:
    _, key = factory.keys.create(("admin",))
    with factory.database.engine.connect() as connection:
        rows = connection.exec_driver_sql("SELECT * FROM api_key").all()
    assert key.removeprefix("lbacal_") not in str(rows)


def test_admin_may_everything_and_others_what_they_were_given(factory: Factory) -> None:
    _, admin = factory.keys.create(("admin",))
    _, other = factory.keys.create(("refits:run",))
    factory.keys.require(f"Bearer {admin}", "calibrations:promote")
    with pytest.raises(ForbiddenError):
        factory.keys.require(f"Bearer {other}", "refits:run", "calibrations:promote")


def test_reads_can_be_closed(factory: Factory, clock: Any) -> None:
    factory.keys.require(None, "read")
    closed = Keys(factory.database, clock, open_reads=False)
    with pytest.raises(UnauthenticatedError):
        closed.require(None, "read")
    _, key = closed.create(("read",))
    closed.require(f"Bearer {key}", "read")


@pytest.mark.parametrize("header", ["", "Bearer", "Bearer x", "Basic eDp5", "lbacal_x"])
def test_a_wrong_header_is_refused_also_for_reads(factory: Factory, header: str) -> None:
    with pytest.raises(UnauthenticatedError):
        factory.keys.require(header, "read")


def test_a_key_was_a_number_without_a_name(factory: Factory) -> None:
    _, key = factory.keys.create(("read",), name="pipeline of CS002")
    assert factory.keys.require(f"Bearer {key}", "read").name == "key 1 (pipeline of CS002)"
    assert [kept.name for kept in factory.database.look(lambda stores: stores.keys.all())] == ["pipeline of CS002"]


@pytest.mark.parametrize("name", ["", " ", "a\nb", "x" * 61])
def test_a_name_of_a_key_is_a_short_line(factory: Factory, name: str) -> None:
    with pytest.raises(BadInputError, match="name"):
        factory.keys.create(("read",), name=name)


def test_a_key_is_revoked_once(factory: Factory) -> None:
    number, _ = factory.keys.create(("read",))
    factory.keys.revoke(number)
    with pytest.raises(NotFoundError):
        factory.keys.revoke(number)


@pytest.mark.parametrize(("scopes", "days"), [((), None), (("write",), None), (("read",), -1.0), (("read",), 0.0)])
def test_a_key_needs_known_scopes_and_a_future(factory: Factory, scopes: tuple[str, ...], days: float | None) -> None:
    with pytest.raises(BadInputError):
        factory.keys.create(scopes, days)
