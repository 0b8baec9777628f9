"""A small instance of `./dev prove misfit`."""

from __future__ import annotations

import pytest

from validation.machinery.parts import Row
from validation.machinery.records import verdicts_of
from validation.misfit import ANTENNAS, KINDS, SCOPES, TOLD, fit_clean, fit_pattern, fit_wrong


@pytest.fixture(scope="module")
def clean() -> list[Row]:
    return [fit_clean(seed) for seed in (1, 2)]


def test_clean_curves_of_drawn_worlds_are_no_misfits(clean: list[Row]) -> None:
    assert {row["outside"] for row in clean}.isdisjoint({"lst"})
    for scope in SCOPES:
        assert sum(row[scope]["curves"] for row in clean) >= 12
        assert sum(row[scope]["misfits"] for row in clean) == 0


def test_wrong_inputs_do_not_converge() -> None:
    row = fit_wrong(0)
    assert {kind: row[kind]["converged"] for kind in KINDS} == dict.fromkeys(KINDS, 0)
    assert set(row) == {*KINDS, *TOLD}
    assert verdicts_of("misfit", "wrong", [row] * 30)["X_and_Y_exchanged"] == "shown"


def test_the_error_of_c_covers_another_antenna() -> None:
    row = fit_pattern(0)
    right, other = (row[name] for name in ANTENNAS[:2])
    assert right["misfits"] == 0
    assert right["channels"] > 250
    for told in (right, other):
        assert told["beyond_2"] <= 0.1 * told["channels"]
    assert other["unsaid"] == 0
    assert set(verdicts_of("misfit", "pattern", [row, row])) >= {"short-dipole_unsaid", "quarter-wave_beyond"}


def test_the_judgement_refutes_a_test_that_is_too_strict(clean: list[Row]) -> None:
    strict = [{**row, "station": {**row["station"], "misfits": row["station"]["curves"]}} for row in clean]
    assert verdicts_of("misfit", "clean", strict)["station"] == "refuted"
