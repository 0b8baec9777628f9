"""`GET /v1/predictions` by what is in effect."""

from __future__ import annotations

import json
from typing import Self

import numpy as np
import pytest
from fastapi.testclient import TestClient

import lbacal
from lbacal.analysis import predict
from service.factory import Factory
from tests.service.conftest import refit, served

PATH = {"station": "CS002", "antenna": 1, "dipole": "X"}
AT = "2014-06-01T12:00:00Z"


@pytest.fixture
def http(station: Factory) -> TestClient:
    refit(station, "station", station="CS002")
    return served(station, "read")


def test_a_path_is_predicted_by_what_is_in_effect(http: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    found = http.get("/v1/predictions", params={**PATH, "at": AT})
    assert found.status_code == 200, found.text
    content = found.json()
    assert content["answered_by"] == "station"
    assert np.shape(content["covariance"]) == (len(content["power"]),) * 2
    assert content["noise"]["source"].startswith("gain of an event 5%")
    monkeypatch.setattr(predict, "Client", lambda: _Answering(content))
    told = lbacal.predict(at=AT, **PATH)
    np.testing.assert_array_equal(told.power, content["power"])
    assert "the ADC shows" in told.notes[0]


class _Answering:
    def __init__(self, content: dict[str, object]) -> None:
        self.content = content

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...

    def get(self, path: str, **params: object) -> object:
        assert (path, params["at"], params["temperature_c"]) == ("/v1/predictions", AT, None)
        return json.loads(json.dumps(self.content))


@pytest.mark.parametrize(
    ("changed", "status"),
    [({"antenna": 99}, 422), ({"dipole": "Q"}, 422), ({"at": "2014"}, 422), ({"at": "2012-01-01"}, 404)],
)
def test_what_cannot_be_predicted_is_refused(http: TestClient, changed: dict[str, object], status: int) -> None:
    assert http.get("/v1/predictions", params={**PATH, "at": AT, **changed}).status_code == status
