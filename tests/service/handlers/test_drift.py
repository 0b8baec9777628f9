from __future__ import annotations

from typing import Any

import pytest
from fastapi.testclient import TestClient

from service.factory import Factory

STEP: dict[str, Any] = {
    "station": "CS001", "is_known": False, "date_unix": 1.4e9, "date_sigma_days": 1.0, "earliest_unix": 1.39e9,
    "latest_unix": 1.41e9, "size": 0.05, "sigma": 0.01, "shape": {}, "significance": 5.0,
    "members": [{"antenna": 1, "dipole": "X"}],
}  # fmt: skip


def test_a_step_is_told_of_its_path_its_station_and_the_array_alone(factory: Factory, client: TestClient) -> None:
    with factory.database.write() as stores:
        report = {"changes": [STEP], "slopes": [], "trends": {}, "threshold_sigma": 4.5}
        stores.drift.keep_report("x", report, factory.clock())

    def steps(**asked: Any) -> int:
        told = client.get("/v1/drift", params=asked).json()
        assert told["threshold_sigma"] == 4.5
        assert (told["versions"], told["months"], told["slope"]) == ([], [], None)
        return len(told["steps"])

    assert [steps(), steps(station="CS001"), steps(station="CS002")] == [1, 1, 0]
    assert steps(station="CS001", antenna=1, dipole="X") == 1
    assert steps(station="CS001", antenna=1, dipole="Y") == steps(station="CS001", antenna=2, dipole="X") == 0
    (step,) = client.get("/v1/drift").json()["steps"]
    assert (step["station"], step["antenna"], step["dipole"], step["date"]) == ("CS001", 1, "X", "2014-05-13")
    assert (step["known"], step["calibration"], step["size"]) == (False, None, 0.05)


@pytest.mark.parametrize(
    ("asked", "sentence"),
    [
        ({"station": "CS999"}, "CS001, CS002"),
        ({"antenna": 1}, "a station beside it"),
        ({"station": "CS001", "antenna": 1}, "antenna and dipole together, or neither"),
        ({"station": "CS001", "antenna": 1, "dipole": "Z"}, "one of X, Y"),
        ({"stations": "CS001"}, "stations"),
    ],
)
def test_who_is_not_there_has_no_drift(client: TestClient, asked: dict[str, Any], sentence: str) -> None:
    answer = client.get("/v1/drift", params=asked)
    assert (answer.status_code, sentence in answer.json()["detail"]) == (422, True)
