from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from fastapi.testclient import TestClient

from lbacal_core.causes.model import AdoptedCause, Model
from service.errors import NotFoundError
from service.factory import Factory
from service.storage.models import ADOPTED, WITHDRAWN, Announced, Gain, ModelChange

YEAR_S = 31_536_000
SECOND = 1_000_000


def make(station: str, cause: str = "lst_offset", since: int | None = 2 * YEAR_S) -> Model:
    """The model of a station with one cause, from an instant on."""
    return Model((AdoptedCause(cause, station, "station", 0.1, 0.01, {}, since_unix=since),))


def line(station: str, model: Model, before: Model, cause: Model, act: str = ADOPTED) -> ModelChange:
    """A line of the ledger whose cause begins with the third year."""
    told = {f"{station} X": Announced(0.02, 0.004)}
    return ModelChange(
        0, station, act, model.id, before.id, cause.id, 2 * YEAR_S * SECOND, None, None, None, None, told, (50.0, 10.0),
        5, "somebody", "test",
    )  # fmt: skip


@pytest.fixture
def adopted(factory: Factory) -> dict[str, Model]:
    """CS001 has one cause, CS002 two; one of another station was withdrawn."""
    plain, one = Model(), make("CS001")
    first, both = make("CS002"), Model((*make("CS002").causes, *make("CS002", "dipole_swap").causes))
    with factory.database.write() as stores:
        stores.models.put(plain, one, first, both, make("CS002", "dipole_swap"), make("CS003"))
        stores.models.change(line("CS001", one, plain, one))
        stores.models.change(line("CS002", first, plain, first))
        stores.models.change(line("CS002", both, first, make("CS002", "dipole_swap")))
        stores.models.change(line("CS003", make("CS003"), plain, make("CS003")))
        stores.models.change(line("CS003", plain, make("CS003"), make("CS003"), WITHDRAWN))
    return {"CS001": one, "CS002": both}


def test_the_model_of_an_array_has_the_causes_of_all_its_stations(factory: Factory, adopted: dict[str, Model]) -> None:
    every = Model((*adopted["CS001"].causes, *adopted["CS002"].causes))
    with factory.database.read() as stores:
        assert stores.models.current() == every
        assert stores.models.during(None, 2 * YEAR_S * SECOND, 3 * YEAR_S * SECOND) == every
        for station, model in adopted.items():
            assert stores.models.during(station, 3 * YEAR_S * SECOND, 4 * YEAR_S * SECOND) == model
        assert stores.models.during("CS003", 0, 2**62).is_plain


def test_a_window_before_a_cause_begins_has_neither_it_nor_its_change(
    factory: Factory, adopted: dict[str, Model]
) -> None:
    del adopted
    with factory.database.read() as stores:
        assert stores.models.during(None, 0, 2 * YEAR_S * SECOND).is_plain
        assert stores.models.last_change("CS002", 0, 2 * YEAR_S * SECOND) is None
        change = stores.models.last_change("CS002", 0, 2 * YEAR_S * SECOND + 1)
        assert change is not None
        assert (change.act, change.promise) == (ADOPTED, (50, 10))
        assert change.announced == {"CS002 X": Announced(0.02, 0.004)}
        last = stores.models.last_change(None, 0, 2**62)
        assert last is not None
        assert (last.station, last.act) == ("CS003", WITHDRAWN)


def test_a_model_is_found_by_its_first_digits(factory: Factory, adopted: dict[str, Model]) -> None:
    with factory.database.read() as stores:
        for model in adopted.values():
            assert stores.models.get(model.id[:8]) == model
        with pytest.raises(NotFoundError, match="no model"):
            stores.models.get("0" * 64)


def test_a_cause_that_stops_paying_is_told_until_later_events_say_otherwise(
    factory: Factory, client: TestClient, adopted: dict[str, Model]
) -> None:
    def told() -> Any:
        return client.get("/v1/status").json()["stopped_paying"]

    gain = Gain(adopted["CS001"].id, "CS001", 2 * YEAR_S * SECOND, 3 * YEAR_S * SECOND, 300, 30.0, 50.0, 10.0, 1)
    with factory.database.write() as stores:
        stores.models.put_gains([gain])
    assert told() == []
    with factory.database.write() as stores:
        stores.models.put_gains([replace(gain, gain=19.0)])
        assert [one.gain for one in stores.models.gains()] == [19.0], "in place of what fewer events said"
    (sentence,) = told()
    assert "In station CS001" in sentence
    assert "it gained 19.0 in log-likelihood, expected 50.0 ± 10.0" in sentence
    assert "No longer pays: In station CS001" in client.get("/").text
    factory.alarms.look()
    (alarm,) = client.get("/v1/alarms", params={"kind": "cause_stopped_paying"}).json()["alarms"]
    assert ("it gained 19.0" in alarm["sentence"], alarm["station"]) == (True, "CS001")
    later = replace(gain, since=gain.until, until=gain.until + YEAR_S * SECOND, gain=48.0)
    with factory.database.write() as stores:
        stores.models.put_gains([later])
    assert told() == []
    factory.alarms.look()
    assert client.get("/v1/alarms", params={"kind": "cause_stopped_paying"}).json()["alarms"] == []
    lines = client.get("/v1/models", params={"limit": 2}).json()
    assert [one["station"] for one in lines["models"]] == ["CS003", "CS003"]
    rest = client.get("/v1/models", params={"cursor": lines["next"]}).json()
    assert [(one["station"], one["in_effect"]) for one in rest["models"]] == [
        ("CS002", True), ("CS002", False), ("CS001", True),
    ]  # fmt: skip
    assert [one["log_likelihood_gain"] for one in rest["models"][-1]["causes"][0]["gains"]] == [19.0, 48.0]
