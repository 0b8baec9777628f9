from __future__ import annotations

import pytest

from validation.cut_off import compare, two_networks
from validation.machinery.records import verdicts_of
from validation.machinery.run import RefusedError


@pytest.mark.long
@pytest.mark.parametrize(("kind", "seed"), [("sqlite", 0), ("postgresql", 1)])
def test_a_night_ends_whole_though_a_dask_worker_is_cut_off_and_killed(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, kind: str, seed: int
) -> None:
    """The suite's small instance of `./dev prove cut_off`: it dies at once, or 20 s later."""
    if kind == "postgresql":
        request.getfixturevalue("needs_postgres")
    try:
        with two_networks():
            pass
    except RefusedError as error:
        pytest.skip(str(error))
    monkeypatch.setattr("validation.cut_off.LATEST", 1)  # on a busy machine the second worker may get no third piece
    row = compare(kind, seed)
    assert (row["broken"], row["differs"] <= 1e-10) == ([], True), row
    assert row["versions"] > row["parts"] > 6


def test_one_night_with_another_number_refutes() -> None:
    same = {"broken": [], "differs": 0.0}
    shown = {"broken": "shown", "differs": "shown"}
    assert verdicts_of("cut_off", "sqlite", [same] * 3) == shown
    assert verdicts_of("cut_off", "sqlite", [same, {**same, "differs": 1e-6}]) == {**shown, "differs": "refuted"}
    assert verdicts_of("cut_off", "sqlite", [same, {**same, "broken": ["a check"]}])["broken"] == "refuted"
