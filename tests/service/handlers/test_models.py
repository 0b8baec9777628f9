from __future__ import annotations

from fastapi.testclient import TestClient

from lbacal_core.causes.model import AdoptedCause, Model
from service.factory import Factory
from service.storage.models import ADOPTED, ModelChange

SWAP = AdoptedCause("dipole_swap", "CS001", "station", 0.3, 0.02, since_unix=1_388_534_400)


def adopt(factory: Factory) -> Model:
    """A model as a ledger has it, after an adoption."""
    model, plain = Model((SWAP,)), Model()
    with factory.database.write() as stores:
        stores.models.put(model, plain)
        stores.models.change(
            ModelChange(
                0, "CS001", ADOPTED, model.id, plain.id, model.id, 1_388_534_400_000_000, None, None, None, None, {},
                (12.0, 3.0), factory.clock(), "somebody", "the cables were exchanged",
            )
        )  # fmt: skip
    return model


def test_a_model_is_listed_and_withdrawn_once(factory: Factory, client: TestClient) -> None:
    assert client.get("/v1/models").json() == {"models": [], "next": None}
    model = adopt(factory)
    (line,) = client.get("/v1/models").json()["models"]
    assert (line["id"], line["station"], line["act"], line["in_effect"]) == (model.id, "CS001", "adopted", True)
    assert (line["promise"], line["by"], line["reason"]) == ([12.0, 3.0], "somebody", "the cables were exchanged")
    assert (line["causes"][0]["cause"], line["causes"][0]["since"]) == ("dipole_swap", "2014-01-01T00:00:00Z")
    route = f"/v1/models/{model.id[:10]}/withdrawal"
    assert client.post(route, json={}).status_code == 422
    gone = client.post(route, json={"reason": "they were right"})
    assert (gone.status_code, gone.json()) == (202, {"model": Model().id, "jobs": []})
    assert client.post(route, json={"reason": "again"}).status_code == 409
    lines = client.get("/v1/models").json()["models"]
    assert [(one["act"], one["in_effect"], len(one["causes"])) for one in lines] == [
        ("withdrawn", True, 0), ("adopted", False, 1),
    ]  # fmt: skip
    page = client.get("/v1/models", params={"limit": 1}).json()
    rest = client.get("/v1/models", params={"cursor": page["next"]}).json()["models"]
    assert [one["act"] for one in rest] == ["adopted"]


def test_who_may_not_promote_may_not_withdraw(factory: Factory, client: TestClient) -> None:
    model = adopt(factory)
    _, runner = factory.keys.create(("refits:run",))
    headers = {"Authorization": f"Bearer {runner}"}
    answer = client.post(f"/v1/models/{model.id}/withdrawal", json={"reason": "x"}, headers=headers)
    assert answer.status_code == 403
    assert client.post(f"/v1/models/{'0' * 64}/withdrawal", json={"reason": "x"}).status_code == 404
    assert client.get("/v1/models").json()["models"][0]["in_effect"]
